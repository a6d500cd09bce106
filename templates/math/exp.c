/* Returns 2^n for the exponents of normal numbers. */
static inline real_t own_power_of_two(bits_t n)
{
    return own_number((n + BIAS) << MANTISSA);
}

/* x 2^n without overflow or underflow of 2^n, so that results beyond the range of normal numbers are rounded only
 * once. */
static inline real_t own_scale(real_t x, real_t rest, bits_t n)
{
    const bits_t half = ((n + 4096) >> 1) - 2048;
    const real_t factor = own_power_of_two(half);
    return (factor * x + factor * rest) * own_power_of_two(n - half);
}

/* q with exp(r) = 1 + r + r^2 q,  |r| <= ln(2) / 2: a minimax polynomial. */
static inline real_t own_exp_curve(real_t r)
{
#if SINGLE
    const real_t z2 = r * r, z4 = z2 * z2;
    const real_t p0 = (r * 0.16666520571107343F + 0.5F) + z2 * (r * 0.008368730931899675F + 0.04166638740777905F);
    return p0 + z4 * 0.0013941969632439298F;
#else
    const real_t z2 = r * r, z4 = z2 * z2;
    const real_t p0 = (r * 0.16666666666666666 + 0.5) + z2 * (r * 0.008333333333333338 + 0.041666666666666685);
    const real_t p1 =
        (r * 0.000198412698412438 + 0.0013888888888873461) + z2 * (r * 2.755731928036814e-06 + 2.480158734879537e-05);
    const real_t p2 =
        (r * 2.5052045607703142e-08 + 2.755725220476531e-07) + z2 * (r * 1.609389994430103e-10 + 2.092164097367003e-09);
    return p0 + z4 * (p1 + z4 * p2);
#endif
}

/* exp(x + y) / 2^less for a y that is small beside 1:  x + y = n ln(2) + r. */
static inline real_t own_exp_sum(real_t x, real_t y, int less)
{
    real_t shifted, n, r;
    x = own_select(x < LEAST_EXPONENT, own_all(LEAST_EXPONENT), x);
    x = own_select(x > LARGEST_EXPONENT, own_all(LARGEST_EXPONENT), x);
    shifted = x * LOG2_E + ROUNDER;
    n = shifted - ROUNDER;
    r = (x - n * LN_2_HIGH) - (n * LN_2_LOW - y);
    r = r + (r * r) * own_exp_curve(r);
    return own_scale(own_all(R(1)), r, own_bits(shifted) - own_bits(own_all(ROUNDER)) - (unsigned)less);
}

static real_t own_exp(real_t x)
{
    return own_exp_sum(x, own_all(R(0)), 0);
}

/* (exp(x) - 1) / 2 = the value + rest  for -40 <= x <= 64. */
static inline real_t own_expm1_half(real_t x, real_t *rest)
{
    const real_t shifted = x * LOG2_E + ROUNDER, n = shifted - ROUNDER;
    const real_t factor = own_power_of_two(own_bits(shifted) - own_bits(own_all(ROUNDER)) - 1);
    const real_t high = x - n * LN_2_HIGH, low = n * LN_2_LOW, r = high - low;
    const real_t curve = (r * r) * own_exp_curve(r) + ((high - r) - low);
    const real_t first = factor - R(0.5), lost = (factor - first) - R(0.5), second = factor * r, sum = first + second;
    const real_t more = ((first - sum) + second) + (lost + factor * curve), value = sum + more;
    *rest = (sum - value) + more;
    return value;
}

/* Returns exp(x) - 1; for small x the argument itself. */
static real_t own_expm1(real_t x)
{
    const real_t least = own_all(R(-40)), most = own_all(R(60));
    real_t rest, value, y = own_select(x < least, least, x);
    y = own_select(y > most, most, y);
    value = own_expm1_half(y, &rest);
    value = R(2) * (value + rest);
    value = own_select(x > most, own_exp(x), value);
    return own_select(own_fabs(x) < TINY_ARGUMENT * TINY_ARGUMENT, x, value);
}
