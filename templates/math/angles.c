/* r = x - n pi / 2,  |r| <= pi / 4, and its rest. The first differences are exact except for the error in `lost`. */
static inline real_t own_reduce_moderate(real_t x, real_t *rest, bits_t *quadrant)
{
    const real_t shifted = x * TWO_OVER_PI + ROUNDER, n = shifted - ROUNDER;
    const real_t first = x - n * HALF_PI_1, second = first - n * HALF_PI_2, third = second - n * HALF_PI_3;
    const real_t lost = ((first - second) - n * HALF_PI_2) + ((second - third) - n * HALF_PI_3);
    const real_t last = lost - n * HALF_PI_4;
    const real_t r = third + last;
    *rest = (third - r) + last;
    *quadrant = own_bits(shifted);
    return r;
}

/* sin(r) = r + r z p(z),  z = r^2,  |r| <= pi / 4. */
static inline real_t own_sine_curve(real_t z)
{
#if SINGLE
    const real_t z2 = z * z;
    return (z * 0.008332177682538163F - 0.1666665493658634F) + z2 * -0.00019517234307729104F;
#else
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 =
        (z * 0.008333333333333323 - 0.16666666666666666) + z2 * (z * 2.755731921421913e-06 - 0.0001984126984125512);
    const real_t p1 = (z * 1.605836762035876e-10 - 2.505210491922711e-08) + z2 * -7.578748013313224e-13;
    return p0 + z4 * p1;
#endif
}

/* cos(r) = 1 - z / 2 + z^2 p(z),  z = r^2,  |r| <= pi / 4. */
static inline real_t own_cosine_curve(real_t z)
{
#if SINGLE
    const real_t z2 = z * z;
    return (z * -0.001388736691376387F + 0.041666646854705607F) + z2 * 2.4438379805370933e-05F;
#else
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 =
        (z * -0.0013888888888874125 + 0.0416666666666666) + z2 * (z * -2.755731435231188e-07 + 2.4801587289482103e-05);
    const real_t p1 = (z * -1.1359647679898899e-11 + 2.087572327065409e-09);
    return p0 + z4 * p1;
#endif
}

static inline real_t own_sine(real_t r)
{
    const real_t z = r * r;
    return r + (r * z) * own_sine_curve(z);
}

static inline real_t own_cosine(real_t r)
{
    const real_t z = r * r, half = z * R(0.5), rest = R(1) - half;
    return rest + (((R(1) - rest) - half) + (z * z) * own_cosine_curve(z));
}

/* sin(r + quadrant pi / 2). */
static inline real_t own_turn(real_t r, bits_t quadrant)
{
    const real_t value = own_select((quadrant & 1) != 0, own_cosine(r), own_sine(r));
    return own_number(own_bits(value) ^ ((quadrant >> 1) << SIGN_SHIFT));
}

static real_t own_sin(real_t x)
{
    bits_t quadrant;
    real_t rest;
    const real_t r = own_reduce(x, &rest, &quadrant);
    return own_select(own_fabs(x) < TINY_ARGUMENT, x, own_turn(r, quadrant));
}

static real_t own_cos(real_t x)
{
    bits_t quadrant;
    real_t rest;
    const real_t r = own_reduce(x, &rest, &quadrant);
    return own_turn(r, quadrant + 1);
}

/* Computes sin / cos or -cos / sin of the reduced angle, both as a number and a rest. */
static real_t own_tan(real_t x)
{
    bits_t quadrant;
    real_t low;
    const real_t r = own_reduce(x, &low, &quadrant), z = r * r, half = z * R(0.5), rest = R(1) - half;
    const truth_t odd = (quadrant & 1) != 0;
    const real_t s_more = (r * z) * own_sine_curve(z) + low, s = r + s_more, s_rest = (r - s) + s_more;
    const real_t c_more = ((R(1) - rest) - half) + ((z * z) * own_cosine_curve(z) - r * low);
    const real_t c = rest + c_more, c_rest = (rest - c) + c_more;
    const real_t above = own_select(odd, -c, s), above_rest = own_select(odd, -c_rest, s_rest);
    const real_t below = own_select(odd, s, c), below_rest = own_select(odd, s_rest, c_rest);
    const real_t quotient = above / below, value = quotient + (above_rest - quotient * below_rest) / below;
    return own_select(own_fabs(x) < TINY_ARGUMENT, x, value);
}
