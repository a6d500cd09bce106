/* sin(x) and cos(x) from r = x - n pi / 2,  |r| <= pi / 4, by minimax polynomials in r^2. math.h serves arguments so large
 * that products with n would be rounded. */
#if SINGLE
#define LARGEST_ANGLE 300.0F
#else
#define LARGEST_ANGLE 1.5e6
#endif

/* r, and n in the lowest bits of shifted. The rounding error of the first differences is added to the last one. */
LANES_INLINE lanes_t lanes_reduce(lanes_t x, lanes_t *shifted)
{
    lanes_t n, first, second, rest;
    *shifted = x * TWO_OVER_PI + ROUNDER;
    n = *shifted - ROUNDER;
    first = x - n * HALF_PI_1;
    second = first - n * HALF_PI_2;
    rest = (first - second) - n * HALF_PI_2;
#if SINGLE
    return second + ((rest - n * HALF_PI_3) - n * HALF_PI_4);
#else
    return second + (rest - n * HALF_PI_3);
#endif
}

/* sin(r + quadrant pi / 2). */
LANES_INLINE lanes_t lanes_sine(lanes_t r, mask_t quadrant)
{
    const lanes_t z = r * r, half = z * R(0.5), rest = R(1) - half;
    const mask_t one = (mask_t)lanes_all(R(0)) + 1, odd = -(quadrant & one);
    lanes_t s, c, value;
#if SINGLE
    s = z * -0.00019517234307729104F + 0.008332177682538163F;
    s = s * z - 0.1666665493658634F;
    c = z * 2.4438379805370933e-05F - 0.001388736691376387F;
    c = c * z + 0.041666646854705607F;
#else
    s = z * -7.578748013313224e-13 + 1.605836762035876e-10;
    s = s * z - 2.505210491922711e-08;
    s = s * z + 2.755731921421913e-06;
    s = s * z - 0.0001984126984125512;
    s = s * z + 0.008333333333333323;
    s = s * z - 0.16666666666666666;
    c = z * -1.1359647679898899e-11 + 2.087572327065409e-09;
    c = c * z - 2.755731435231188e-07;
    c = c * z + 2.4801587289482103e-05;
    c = c * z - 0.0013888888888874125;
    c = c * z + 0.0416666666666666;
#endif
    s = r + (r * z) * s;
    c = rest + (((R(1) - rest) - half) + (z * z) * c);
    value = lanes_select(odd, c, s);
    return (lanes_t)((mask_t)value ^ ((quadrant >> 1) << (8 * (int)sizeof(real_t) - 1)));
}

/* The lanes of value with large arguments by math.h. */
static __attribute__((noinline)) void lanes_sin_large(const lanes_t *x, lanes_t *value)
{
    for (int l = 0; l < HOST_LANES; l++) {
        if (!(FABS((*x)[l]) <= LARGEST_ANGLE)) {
            (*value)[l] = SIN((*x)[l]);
        }
    }
}

LANES_INLINE lanes_t lanes_sin(lanes_t x)
{
    lanes_t shifted, value;
    const lanes_t r = lanes_reduce(x, &shifted);
    value = lanes_sine(r, (mask_t)shifted);
    if (lanes_any((mask_t)(lanes_fabs(x) > LARGEST_ANGLE))) {
        const lanes_t large = x;
        lanes_t exact = value;
        lanes_sin_large(&large, &exact);
        return exact;
    }
    return value;
}

/* The lanes of value with large arguments by math.h. */
static __attribute__((noinline)) void lanes_cos_large(const lanes_t *x, lanes_t *value)
{
    for (int l = 0; l < HOST_LANES; l++) {
        if (!(FABS((*x)[l]) <= LARGEST_ANGLE)) {
            (*value)[l] = COS((*x)[l]);
        }
    }
}

LANES_INLINE lanes_t lanes_cos(lanes_t x)
{
    lanes_t shifted, value;
    const lanes_t r = lanes_reduce(x, &shifted);
    value = lanes_sine(r, (mask_t)shifted + 1);
    if (lanes_any((mask_t)(lanes_fabs(x) > LARGEST_ANGLE))) {
        const lanes_t large = x;
        lanes_t exact = value;
        lanes_cos_large(&large, &exact);
        return exact;
    }
    return value;
}
