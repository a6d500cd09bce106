/* exp(x) = 2^n exp(r),  |r| <= ln(2) / 2; a minimax polynomial in r. The power is applied in two factors, so that results
 * beyond the range of normal numbers are rounded only once. */
LANES_INLINE lanes_t lanes_exp(lanes_t x)
{
#if SINGLE
    const lanes_t low = lanes_all(-104.0F), high = lanes_all(89.0F);
#else
    const lanes_t low = lanes_all(-746.0), high = lanes_all(710.0);
#endif
    lanes_t shifted, n, r, q;
    mask_t k, half;
    x = lanes_select((mask_t)(x < low), low, x);
    x = lanes_select((mask_t)(x > high), high, x);
    shifted = x * LOG2_E + ROUNDER;
    n = shifted - ROUNDER;
    r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    k = (mask_t)shifted - (mask_t)lanes_all(ROUNDER);
    half = k >> 1;
#if SINGLE
    q = r * 0.0013941969632439298F + 0.008368730931899675F;
    q = q * r + 0.04166638740777905F;
    q = q * r + 0.16666520571107343F;
#else
    q = r * 1.609389994430103e-10 + 2.092164097367003e-09;
    q = q * r + 2.5052045607703142e-08;
    q = q * r + 2.755725220476531e-07;
    q = q * r + 2.755731928036814e-06;
    q = q * r + 2.480158734879537e-05;
    q = q * r + 0.000198412698412438;
    q = q * r + 0.0013888888888873461;
    q = q * r + 0.008333333333333338;
    q = q * r + 0.041666666666666685;
    q = q * r + 0.16666666666666666;
#endif
    q = q * r + R(0.5);
    r = r + (r * r) * q;
    return (lanes_power_of_two(half) + lanes_power_of_two(half) * r) * lanes_power_of_two(k - half);
}
