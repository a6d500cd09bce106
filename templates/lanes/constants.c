/* Adding ROUNDER rounds to an integer, which then stands in the lowest bits. ln 2 and pi / 2 are sums of numbers with so
 * few digits that their products with the integers that occur are exact, and a small rest. */
#if SINGLE
#define ROUNDER 12582912.0F
#define LOG2_E 1.442695040888963407F
#define LN_2_HIGH 0.693115234375F
#define LN_2_LOW 3.1946184945309415e-05F
#define TWO_OVER_PI 0.636619772367581343F
#define HALF_PI_1 1.5703125F
#define HALF_PI_2 0.0004837512969970703F
#define HALF_PI_3 7.549533620476723e-08F
#define HALF_PI_4 2.563344151594519e-12F
#define MANTISSA 23
#define BIAS 127
#else
#define ROUNDER 6755399441055744.0
#define LOG2_E 1.442695040888963407
#define LN_2_HIGH 0.6931471803691238
#define LN_2_LOW 1.9082149292705877e-10
#define TWO_OVER_PI 0.636619772367581343
#define HALF_PI_1 1.5707963267341256
#define HALF_PI_2 6.077100506303966e-11
#define HALF_PI_3 2.0222662487959506e-21
#define MANTISSA 52
#define BIAS 1023
#endif

/* 2^n for the exponents of normal numbers. */
LANES_INLINE lanes_t lanes_power_of_two(mask_t n)
{
    return (lanes_t)((n + BIAS) << MANTISSA);
}
