/* Returns the upper half of the digits. */
static inline real_t own_upper(real_t x)
{
    return own_number(own_bits(x) & UPPER_HALF);
}

/* P with log(1 + f) = 2 s + s (2/3 z + z^2 P(z)),  s = f / (2 + f), z = s^2. */
static inline real_t own_log_curve(real_t z)
{
#if SINGLE
    const real_t z2 = z * z;
    return (z * 0.2856224F + 0.40000015F) + z2 * 0.23048154F;
#else
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 = (z * 0.28571428571429364 + 0.4) + z2 * (z * 0.18181818335314404 + 0.22222222221656232);
    const real_t p1 =
        (z * 0.13334804238225345 + 0.15384594970895457) + z2 * (z * 0.11723051028097753 + 0.11706248540922386);
    return p0 + z4 * p1;
#endif
}

/* log(x) = the value + rest, with ten bits more than a number has. Upper halves carry what must not be rounded. */
static inline real_t own_log_pair(real_t x, real_t *rest)
{
#if SINGLE
    const real_t two_thirds = own_all(0.66650390625F), two_thirds_rest = own_all(0.00016276042F);
#else
    const real_t two_thirds = own_all(0.6666666567325592), two_thirds_rest = own_all(9.934107462565104e-09);
#endif
    real_t e, sum, sum_rest, value;
    const real_t f = own_split(x, &e), d = own_upper(f + R(2)), d_rest = f - (d - R(2));
    const real_t s = own_upper(f / (f + R(2))), s_rest = ((f - s * d) - s * d_rest) / (f + R(2));
    const real_t z = own_upper(s * s), z_rest = (s * s - z) + s_rest * (s + (s + s_rest)), whole = z + z_rest;
    const real_t tail = (two_thirds * z_rest + two_thirds_rest * whole) + (whole * whole) * own_log_curve(whole);
    const real_t w = own_upper(two_thirds * z + tail), w_rest = (two_thirds * z - w) + tail;
    const real_t last = s_rest * (R(2) + (w + w_rest)) + s * w_rest;
    sum = e * LN_2_HIGH + R(2) * s;
    sum_rest = (e * LN_2_HIGH - sum) + R(2) * s;
    value = sum + s * w;
    *rest = ((sum - value) + s * w) + (sum_rest + (last + e * LN_2_LOW));
    return value;
}

/* x^y for x >= 0 and y other than 0. Exponents beyond the limit to which y is clipped give the same results. */
static inline real_t own_pow_magnitude(real_t x, real_t y)
{
    const real_t infinite = own_all(INF), zero = own_all(R(0));
#if SINGLE
    const real_t most = own_all(1.0995116e12F), least = own_all(9.094947e-13F);
#else
    const real_t most = own_all(1.1805916207174113e21), least = own_all(8.470329472543003e-22);
#endif
    truth_t inside;
    real_t rest, product, product_rest, total, logarithm = own_log_pair(x, &rest), head, y_head;
    logarithm = own_select((x > R(0)) & (x < infinite), logarithm, own_select(x <= R(0), -infinite, x));
    y = own_select(y > most, most, own_select(y < -most, -most, y));
    y = own_select(own_fabs(y) < least, own_copysign(least, y), y);
    y_head = own_upper(y);
    head = own_upper(logarithm);
    product = y_head * head;
    product_rest = (y - y_head) * head + y * ((logarithm - head) + rest);
    inside = (product > LEAST_EXPONENT) & (product < LARGEST_EXPONENT);
    product_rest = own_select(inside, product_rest, zero);
    total = product + product_rest;
    return own_exp_sum(total, own_select(inside, (product - total) + product_rest, zero), 0);
}

/* x^y with the special cases of math.h: 1 for y = 0 or x = 1, NaN for x < 0 unless y is an integer. */
static real_t own_pow(real_t x, real_t y)
{
    const real_t size = own_fabs(y), moved = size + FIRST_INTEGER, not_a_number = own_all(NOT_A_NUMBER);
    const real_t whole = moved - FIRST_INTEGER, base = own_fabs(x);
    const truth_t fraction = (size < FIRST_INTEGER) & ((whole < size) | (whole > size));
    const bits_t zero = own_bits(own_all(R(0)));
    const bits_t large = own_pick(size < R(2) * FIRST_INTEGER, own_bits(size), zero);
    const bits_t integer = own_pick(fraction, zero, own_pick(size < FIRST_INTEGER, own_bits(moved), large));
    const bits_t sign = own_bits(x) & ((integer & 1) << SIGN_SHIFT);
    const real_t value = own_number(own_bits(own_pow_magnitude(base, y)) ^ sign);
    const truth_t none = (x < R(0)) & (base < INF) & fraction;
    const truth_t one = (size <= R(0)) | ((x >= R(1)) & (x <= R(1)));
    return own_select(one, own_all(R(1)), own_select(none, not_a_number, value));
}
