/* The bits of a number as an unsigned integer. */
#if SINGLE
typedef uint32_t bits_t;
#else
typedef uint64_t bits_t;
#endif

/* Adding ROUNDER rounds to an integer, which then stands in the lowest bits. */
#if SINGLE
#define ROUNDER 12582912.0F
#define MANTISSA 23
#define BIAS 127
#define SIGN_SHIFT 31
#else
#define ROUNDER 6755399441055744.0
#define MANTISSA 52
#define BIAS 1023
#define SIGN_SHIFT 63
#endif

#if SINGLE
#define SIGN_BIT 0x80000000U
#else
#define SIGN_BIT 0x8000000000000000U
#endif

/* Mask of all bits except the lower half of the digits: products of two masked numbers are exact. */
#if SINGLE
#define UPPER_HALF 0xFFFFF000U
#else
#define UPPER_HALF 0xFFFFFFFFF8000000U
#endif

/* All numbers from this magnitude on are integers. */
#if SINGLE
#define FIRST_INTEGER 8388608.0F
#else
#define FIRST_INTEGER 4503599627370496.0
#endif

/* ln 2 is the sum of a number and a rest. The number has so few digits that its products with the integers that occur
 * are exact. */
#if SINGLE
#define LOG2_E 1.442695040888963407F
#define LN_2_HIGH 0.693115234375F
#define LN_2_LOW 3.1946184945309415e-05F
#else
#define LOG2_E 1.442695040888963407
#define LN_2_HIGH 0.6931471803691238
#define LN_2_LOW 1.9082149292705877e-10
#endif

/* Larger arguments give the same results: zero, infinity. */
#if SINGLE
#define LEAST_EXPONENT (-104.0F)
#define LARGEST_EXPONENT 91.0F
#else
#define LEAST_EXPONENT (-746.0)
#define LARGEST_EXPONENT 712.0
#endif

/* pi / 2 in parts of few digits, for angles up to LARGEST_ANGLE. */
#if SINGLE
#define TWO_OVER_PI 0.636619772367581343F
#define HALF_PI_1 1.5703125F
#define HALF_PI_2 0.0004837512969970703F
#define HALF_PI_3 7.549533620476723e-08F
#define HALF_PI_4 2.5633440682570896e-12F
#define LARGEST_ANGLE 3000.0F
#else
#define TWO_OVER_PI 0.636619772367581343
#define HALF_PI_1 1.5707963267341256
#define HALF_PI_2 6.077100506303966e-11
#define HALF_PI_3 2.0222662487111665e-21
#define HALF_PI_4 8.4784276603689e-32
#define LARGEST_ANGLE 1.5e6
#endif

/* Below this magnitude an odd function equals its argument. */
#if SINGLE
#define TINY_ARGUMENT 0.0001220703125F
#else
#define TINY_ARGUMENT 3.725290298461914e-09
#endif

/* pi / 2 as a number and the rest. */
#if SINGLE
#define HALF_PI 1.57079637F
#define HALF_PI_REST -4.37113883e-08F
#else
#define HALF_PI 1.5707963267948966
#define HALF_PI_REST 6.123233995736766e-17
#endif

#define NOT_A_NUMBER ((real_t)NAN)
