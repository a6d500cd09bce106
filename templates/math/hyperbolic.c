/* Limits an argument of own_expm1_half(); larger ones give the same results. */
static inline real_t own_at_most(real_t x, real_t most)
{
    return own_select(x > most, most, x);
}

/* With m = (exp(|x|) - 1) / 2,  sinh(|x|) = m + m / (1 + 2 m). */
static real_t own_sinh(real_t x)
{
    const real_t size = own_fabs(x);
    real_t rest, m, below, value;
    m = own_expm1_half(own_at_most(size, own_all(R(32))), &rest);
    below = R(1) + R(2) * m;
    value = (m + m / below) + (rest + rest / (below * below));
    value = own_select(size > R(24), own_exp_sum(size, own_all(R(0)), 1), value);
    return own_select(size < TINY_ARGUMENT, x, own_copysign(value, x));
}

/* cosh(x) = e + 1 / (4 e),  e = exp(|x|) / 2. */
static real_t own_cosh(real_t x)
{
    const real_t e = own_exp_sum(own_fabs(x), own_all(R(0)), 1);
    return e + R(0.25) / e;
}

/* With m = (exp(2 |x|) - 1) / 2,  tanh(|x|) = m / (1 + m). */
static real_t own_tanh(real_t x)
{
    const real_t size = own_fabs(x);
    real_t rest, m, below, lost, quotient;
    m = own_expm1_half(own_at_most(R(2) * size, own_all(R(60))), &rest);
    below = m + R(1);
    lost = own_select(m > R(1), (m - below) + R(1), (R(1) - below) + m);
    quotient = m / below;
    quotient = quotient + (rest - quotient * (lost + rest)) / below;
    return own_select(size < TINY_ARGUMENT, x, own_copysign(quotient, x));
}

/* asinh(x) = sign(x) log1p(|x| + x^2 / (1 + sqrt(1 + x^2))). */
static real_t own_asinh(real_t x)
{
    const real_t size = own_fabs(x), z = x * x, more = z / (R(1) + own_sqrt(R(1) + z));
    const real_t value = own_log1p(size + more);
    const truth_t large = size > R(1) / TINY_ARGUMENT;
    const real_t far = own_log(own_select(large, size, own_all(R(1)))) + (LN_2_HIGH + LN_2_LOW);
    return own_select(size < TINY_ARGUMENT, x, own_copysign(own_select(large, far, value), x));
}

/* acosh(x) = log1p(t + root),  t = x - 1, root = sqrt(2 t + t^2) as a number and a rest. */
static real_t own_acosh(real_t x)
{
    const real_t t = x - R(1), square = R(2) * t + t * t, whole = own_sqrt(square), root = own_upper(whole);
    const real_t lost = (square - root * root) / own_select(whole > R(0), root + whole, own_all(R(1)));
    const real_t sum = root + t, value = own_log1p_sum(sum, ((root - sum) + t) + lost);
    const truth_t large = x > R(1) / TINY_ARGUMENT;
    const real_t far = own_log(own_select(large, x, own_all(R(1)))) + (LN_2_HIGH + LN_2_LOW);
    return own_select(x < R(1), own_all(NOT_A_NUMBER), own_select(large, far, value));
}

/* atanh(x) = sign(x) log1p(2 |x| + 2 x^2 / (1 - |x|)) / 2. */
static real_t own_atanh(real_t x)
{
    const real_t size = own_fabs(x), twice = R(2) * size;
    const real_t value = R(0.5) * own_log1p(twice + twice * size / (R(1) - size));
    const real_t inside = own_select(size > R(1), own_all(NOT_A_NUMBER), own_copysign(value, x));
    return own_select(size < TINY_ARGUMENT, x, inside);
}
