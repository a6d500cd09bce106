/* Returns the digits of a positive number without its exponent; the first digit has the index MANTISSA. */
static bits_t own_digits(bits_t bits, int *exponent)
{
    const bits_t unit = (bits_t)1 << MANTISSA;
    *exponent = (int)(bits >> MANTISSA);
    if (*exponent > 0) {
        return (bits & (unit - 1)) | unit;
    }
    *exponent = 1;
    while (bits < unit) {
        /* at most MANTISSA passes */
        bits <<= 1;
        *exponent -= 1;
    }
    return bits;
}

/* x - n y with the sign of x, n = x / y rounded towards zero: exact, by long division. */
static real_t own_fmod(real_t x, real_t y)
{
    const bits_t unit = (bits_t)1 << MANTISSA, sign = own_bits(x) & SIGN_BIT;
    bits_t a, b;
    int exponent, least;
    if (!(FABS(x) < INF) || !(FABS(y) > R(0))) {
        return NOT_A_NUMBER;
    }
    if (FABS(x) < FABS(y)) {
        return x;
    }
    a = own_digits(own_bits(x) & ~SIGN_BIT, &exponent);
    b = own_digits(own_bits(y) & ~SIGN_BIT, &least);
    for (; exponent > least; exponent--) {
        a = ((a >= b) ? a - b : a) << 1;
    }
    a = (a >= b) ? a - b : a;
    for (; a > 0 && a < unit && exponent > 1; exponent--) {
        a <<= 1;
    }
    if (exponent < 1) {
        a >>= 1 - exponent;
        exponent = 1;
    }
    a = (a < unit) ? a : ((a & (unit - 1)) | ((bits_t)exponent << MANTISSA));
    return own_number(a | sign);
}
