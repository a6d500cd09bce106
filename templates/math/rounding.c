static inline real_t own_fabs(real_t x)
{
    return own_number(own_bits(x) & ~SIGN_BIT);
}

static inline real_t own_copysign(real_t x, real_t sign)
{
    return own_number((own_bits(x) & ~SIGN_BIT) | (own_bits(sign) & SIGN_BIT));
}

/* Returns the nearest integer of a number smaller than FIRST_INTEGER. */
static inline real_t own_nearest(real_t x)
{
    return own_copysign((own_fabs(x) + FIRST_INTEGER) - FIRST_INTEGER, x);
}

static real_t own_floor(real_t x)
{
    const real_t whole = own_nearest(x);
    return own_select(own_fabs(x) < FIRST_INTEGER, own_select(whole > x, whole - R(1), whole), x);
}

static real_t own_ceil(real_t x)
{
    const real_t whole = own_nearest(x);
    const real_t up = own_copysign(own_select(whole < x, whole + R(1), whole), x);
    return own_select(own_fabs(x) < FIRST_INTEGER, up, x);
}

/* Returns the other operand if one is NaN, as in math.h. */
static real_t own_fmin(real_t a, real_t b)
{
    return own_select(a < b, a, own_select(b <= b, b, a));
}

/* Returns the other operand if one is NaN, as in math.h. */
static real_t own_fmax(real_t a, real_t b)
{
    return own_select(a > b, a, own_select(b <= b, b, a));
}

/* sqrt(x^2 + y^2), scaled by a power of two where squares overflow or underflow; infinite if one operand is, even
 * beside NaN. */
static real_t own_hypot(real_t x, real_t y)
{
#if SINGLE
    const real_t large = own_all(9.223372036854776e+18F), small = own_all(8.881784197001252e-16F),
                 up = own_all(1.2379400392853803e+27F), down = own_all(8.077935669463161e-28F);
#else
    const real_t large = own_all(6.703903964971299e+153), small = own_all(3.4395525670743494e-136);
    const real_t up = own_all(5.260135901548374e+210), down = own_all(1.90109156629516e-211);
#endif
    const real_t a = own_fabs(x), b = own_fabs(y), one = own_all(R(1)), most = own_select(a > b, a, b);
    const real_t factor = own_select(most > large, down, own_select(most < small, up, one));
    const real_t back = own_select(most > large, up, own_select(most < small, down, one));
    const real_t p = a * factor, q = b * factor, value = own_sqrt(p * p + q * q) * back;
    return own_select((a >= INF) | (b >= INF), own_all(INF), value);
}
