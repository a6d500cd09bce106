/* x = 2^e (1 + f),  1 + f between sqrt(1/2) and sqrt(2). Returns f; any value if x is not positive and finite. */
static inline real_t own_split(real_t x, real_t *e)
{
#if SINGLE
    const real_t least = own_all(1.17549435e-38F), root = own_all(0.707106781186547524F);
    const real_t scale = own_all(33554432.0F), digits = own_all(25.0F);
#else
    const real_t least = own_all(2.2250738585072014e-308), root = own_all(0.707106781186547524);
    const real_t scale = own_all(18014398509481984.0), digits = own_all(54.0);
#endif
    const truth_t small = x < least;
    const bits_t y = own_bits(own_select(small, x * scale, x)), one = own_bits(own_all(R(1)));
    const bits_t biased = (y + (one - own_bits(root))) >> MANTISSA;
    *e = own_number(biased + (own_bits(own_all(ROUNDER)) - BIAS)) - ROUNDER;
    *e = own_select(small, *e - digits, *e);
    return own_number(y - ((biased - BIAS) << MANTISSA)) - R(1);
}

/* R with log(1 + f) = 2 s + s R,  s = f / (2 + f), z = s^2: a minimax polynomial. */
static inline real_t own_log_short(real_t z)
{
#if SINGLE
    const real_t z2 = z * z;
    return (z * 0.39977536985809753F + 0.6666677641506696F) + z2 * 0.29871862126332954F;
#else
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 =
        (z * 0.399999999994143 + 0.6666666666666734) + z2 * (z * 0.22222198563110704 + 0.28571428742479177);
    const real_t p1 = (z * 0.15314035421076824 + 0.18183564884108305) + z2 * 0.14796109390386278;
    return p0 + z4 * p1;
#endif
}

/* log(x) + c for a c that is small beside it:  log(x) = e log(2) + log(1 + f); with s = f / (2 + f),
 * log(1 + f) = 2 s + s R(s^2), where R is a minimax polynomial. */
static inline real_t own_log_sum(real_t x, real_t c)
{
    real_t e, value, special;
    const real_t f = own_split(x, &e), s = f / (f + R(2)), z = s * s, half = (f * f) * R(0.5), q = z * own_log_short(z);
    const real_t infinite = own_all(INF), not_a_number = own_all(NOT_A_NUMBER);
    value = e * LN_2_HIGH - ((half - (s * (half + q) + (e * LN_2_LOW + c))) - f);
    special = own_select(x < R(0), not_a_number, own_select(x <= R(0), -infinite, x));
    return own_select((x > R(0)) & (x < infinite), value, special);
}

static real_t own_log(real_t x)
{
    return own_log_sum(x, own_all(R(0)));
}

/* log(1 + x + y) for a y that is small beside x: log(u) + c / u, where u = 1 + x rounded and c is its rounding
 * error. */
static inline real_t own_log1p_sum(real_t x, real_t y)
{
    const real_t u = x + R(1), back = u - R(1), c = ((R(1) - (u - back)) + (x - back)) + y;
    return own_select(own_fabs(x) < TINY_ARGUMENT * TINY_ARGUMENT, x, own_log_sum(u, c / u));
}

static real_t own_log1p(real_t x)
{
    return own_log1p_sum(x, own_all(R(0)));
}
