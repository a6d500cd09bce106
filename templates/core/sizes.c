/* This part defines scales, and tolerances relative to scales. The scales of states, controls and rows, of the cost and
 * of its gradient follow from declared data, never from the data of a sample, because in a plant at rest the data may
 * be rounding errors. A magnitude is at least its scale, and a residual near the rounding error of its scale counts as
 * zero, even if its terms are smaller. */

/* Returns the number of components of (x, u) at node k. */
static inline int nz_at(int k)
{
    return (k < N) ? NZ : NX;
}

/* Returns the first component of (x, u) that may be idle. */
static inline int first_idle(void)
{
    if (IDLE_STATES) {
        return 0;
    }
    return NX;
}

/* Returns a size found in data, or the scale where that size is a zero. */
static inline real_t size_or(real_t size, real_t scale)
{
    return (size > TOL_ZERO * scale) ? size : scale;
}

/* Returns a value of component i of (x, u), or 0 if it is far below all rounding errors of its scale. In a plant at
 * rest, values would otherwise decay to denormal numbers, which are slow and have no relative accuracy. NaN stays. */
static inline real_t or_zero(real_t value, int i)
{
    return (FABS(value) <= TOL_UNIT * TOL_UNIT * z_scale[i]) ? R(0) : value;
}

/* Returns the least size in which a cost is measured: that of variables at the zero tolerance. */
static inline real_t least_cost(void)
{
    return TOL_ZERO * TOL_ZERO * cost_size[0];
}

/* Raises the units of variables i and j where |Q_ij| > sqrt(unit_i unit_j), both by the ratio of the two. Q: the lower
 * triangle of n rows with ld entries each. */
static void extend_units(const real_t *Q, int ld, int n, real_t *unit)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < i; j++) {
            const real_t a = FABS(Q[i * ld + j]), both = SQRT(unit[i]) * SQRT(unit[j]);
            if (a > both) {
                unit[i] *= a / both;
                unit[j] *= a / both;
            }
        }
    }
}
