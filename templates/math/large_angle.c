/* Binary digits of 2 / pi, 32 in an element; the first element is the integer part. */
#if SINGLE
static const uint32_t two_over_pi[11] = {0x00000000U, 0xA2F9836EU, 0x4E441529U, 0xFC2757D1U, 0xF534DDC0U, 0xDB629599U,
    0x3C439041U, 0xFE5163ABU, 0xDEBBC561U, 0xB7246E3AU, 0x424DD2E0U};
#else
static const uint32_t two_over_pi[38] = {0x00000000U, 0xA2F9836EU, 0x4E441529U, 0xFC2757D1U, 0xF534DDC0U, 0xDB629599U,
    0x3C439041U, 0xFE5163ABU, 0xDEBBC561U, 0xB7246E3AU, 0x424DD2E0U, 0x06492EEAU, 0x09D1921CU, 0xFE1DEB1CU, 0xB129A73EU,
    0xE88235F5U, 0x2EBB4484U, 0xE99C7026U, 0xB45F7E41U, 0x3991D639U, 0x835339F4U, 0x9C845F8BU, 0xBDF9283BU, 0x1FF897FFU,
    0xDE05980FU, 0xEF2F118BU, 0x5A0A6D1FU, 0x6D367ECFU, 0x27CB09B7U, 0x4F463F66U, 0x9E5FEA2DU, 0x7527BAC7U, 0xEBE5F17BU,
    0x3D0739F7U, 0x8A5292EAU, 0x6BFB5FB1U, 0x1F8D5D08U, 0x56033046U};
#endif

/* Computes y, 4 numbers of 32 digits, = mantissa 2^exponent 2 / pi modulo 4; its first two digits are the integer part.
 * Elements of 2 / pi whose products are multiples of 4 are left out, and so are those far beyond the digits that
 * matter. */
static void large_product(uint64_t mantissa, int exponent, uint32_t *y)
{
    const int first = (exponent + 30) / 32, shift = 62 + exponent - 32 * first;
    const uint64_t low = mantissa & 0xFFFFFFFFU, high = mantissa >> 32;
    uint32_t product[9] = {0};
    uint64_t carry = 0;
    for (int i = 0; i < 7; i++) {
        carry += low * two_over_pi[first + 6 - i];
        product[i] = (uint32_t)(carry & 0xFFFFFFFFU);
        carry >>= 32;
    }
    product[7] = (uint32_t)carry;
    carry = 0;
    for (int i = 0; i < 7; i++) {
        carry += high * two_over_pi[first + 6 - i] + product[i + 1];
        product[i + 1] = (uint32_t)(carry & 0xFFFFFFFFU);
        carry >>= 32;
    }
    for (int i = 0; i < 4; i++) {
        const int from = 7 - shift / 32 - i;
        const uint64_t pair = ((uint64_t)product[from] << 32) | product[from - 1];
        y[i] = (uint32_t)((pair >> (32 - shift % 32)) & 0xFFFFFFFFU);
    }
}

/* Returns the upper half of a product, less at most 2. */
static uint64_t upper_product(uint64_t a, uint64_t b)
{
    const uint64_t a_low = a & 0xFFFFFFFFU, a_high = a >> 32, b_low = b & 0xFFFFFFFFU, b_high = b >> 32;
    return a_high * b_high + ((a_high * b_low) >> 32) + ((a_low * b_high) >> 32);
}

/* Reduces a large angle, r = x - n pi / 2, with a negligible error by the digits of 2 / pi (Payne and Hanek): n is the
 * integer part and f the fraction of x 2 / pi, r = f pi / 2. Returns r and its rest; NaN if x is not finite. */
static real_t large_angle(real_t x, real_t *rest, bits_t *n)
{
    bits_t bits, scale_bits;
    real_t scale, high, low;
    uint64_t f, tail;
    uint32_t y[4];
    int zeros = 0, negative;
    (void)memcpy(&bits, &x, sizeof bits);
    *n = 0;
    *rest = R(0);
    if (!(FABS(x) < INF)) {
        return x - x;
    }
    negative = (bits >> SIGN_SHIFT) != 0;
    large_product((bits & (((bits_t)1 << MANTISSA) - 1)) | ((bits_t)1 << MANTISSA),
        (int)((bits & ~SIGN_BIT) >> MANTISSA) - BIAS - MANTISSA, y);
    *n = y[0] >> 30;
    f = ((uint64_t)y[0] << 34) | ((uint64_t)y[1] << 2) | (y[2] >> 30);
    tail = ((uint64_t)y[2] << 34) | ((uint64_t)y[3] << 2);
    if ((f >> 63) != 0) {
        *n += 1;
        f = ~f;
        tail = ~tail;
        negative = !negative;
    }
    *n = ((bits >> SIGN_SHIFT) != 0) ? 0 - *n : *n;
    while ((f >> 63) == 0 && zeros < 64) {
        /* at most 64 passes */
        f = (f << 1) | (tail >> 63);
        tail <<= 1;
        zeros++;
    }
    f = upper_product(f, 0xC90FDAA22168C235U);
    scale_bits = (bits_t)(BIAS - 63 - zeros) << MANTISSA;
    (void)memcpy(&scale, &scale_bits, sizeof scale);
    high = (real_t)(f >> (63 - MANTISSA)) * (real_t)((uint64_t)1 << (63 - MANTISSA));
    low = (real_t)(f & (((uint64_t)1 << (63 - MANTISSA)) - 1));
    scale = negative ? -scale : scale;
    *rest = ((high - (high + low)) + low) * scale;
    return (high + low) * scale;
}
