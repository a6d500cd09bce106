/* log(x) = e log(2) + log(1 + f),  1 + f between sqrt(1/2) and sqrt(2); with s = f / (2 + f), log(1 + f) = 2 s + s R(s^2),
 * where R is a minimax polynomial. */
LANES_INLINE lanes_t lanes_log(lanes_t x)
{
#if SINGLE
    const lanes_t least = lanes_all(1.17549435e-38F), root = lanes_all(0.707106781186547524F);
    const real_t scale = 33554432.0F, digits = 25.0F;
#else
    const lanes_t least = lanes_all(2.2250738585072014e-308), root = lanes_all(0.707106781186547524);
    const real_t scale = 18014398509481984.0, digits = 54.0;
#endif
    const lanes_t zero = lanes_all(R(0)), infinite = lanes_all((real_t)INFINITY);
    const mask_t small = (mask_t)(x < least), regular = (mask_t)(x > R(0)) & (mask_t)(x < infinite);
    const lanes_t y = lanes_select(small, x * scale, x);
    const mask_t k = ((mask_t)y - (mask_t)root) >> MANTISSA;
    const lanes_t f = (lanes_t)((mask_t)y - (k << MANTISSA)) - R(1);
    const lanes_t e = ((lanes_t)(k + (mask_t)lanes_all(ROUNDER)) - ROUNDER) - lanes_select(small, zero + digits, zero);
    const lanes_t s = f / (f + R(2)), z = s * s, half = (f * f) * R(0.5);
    lanes_t q, value, special;
#if SINGLE
    q = z * 0.29871862126332954F + 0.39977536985809753F;
    q = q * z + 0.6666677641506696F;
#else
    q = z * 0.14796109390386278 + 0.15314035421076824;
    q = q * z + 0.18183564884108305;
    q = q * z + 0.22222198563110704;
    q = q * z + 0.28571428742479177;
    q = q * z + 0.399999999994143;
    q = q * z + 0.6666666666666734;
#endif
    q = q * z;
    value = e * LN_2_HIGH - ((half - (s * (half + q) + e * LN_2_LOW)) - f);
    special = lanes_select((mask_t)(x == R(0)), -infinite, lanes_select((mask_t)(x < R(0)), zero / zero, x));
    return lanes_select(regular, value, special);
}
