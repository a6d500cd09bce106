/* The type of a condition: 1 where it holds. */
typedef int truth_t;

static inline bits_t own_bits(real_t x)
{
    bits_t bits;
    (void)memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline real_t own_number(bits_t bits)
{
    real_t x;
    (void)memcpy(&x, &bits, sizeof x);
    return x;
}

static inline real_t own_all(real_t value)
{
    return value;
}

/* Computes only the number that is chosen. */
#define own_select(where, a, b) ((where) ? (a) : (b))

static inline bits_t own_pick(truth_t where, bits_t a, bits_t b)
{
    return where ? a : b;
}

static inline real_t own_sqrt(real_t x)
{
    return SQRT(x);
}

/* r = x - n pi / 2,  |r| <= pi / 4, its rest, and n in the lowest bits. For the smallest angles the general formula
 * gives the argument itself. */
static inline real_t own_reduce_moderate(real_t x, real_t *rest, bits_t *quadrant);
static inline real_t own_reduce(real_t x, real_t *rest, bits_t *n)
{
    if (FABS(x) < R(0.75)) {
        *rest = R(0);
        *n = 0;
        return x;
    }
    return (FABS(x) <= LARGEST_ANGLE) ? own_reduce_moderate(x, rest, n) : large_angle(x, rest, n);
}
