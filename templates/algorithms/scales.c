/* A scale of 0 is unknown and counts as 1. */
static inline real_t scale_of(real_t scale)
{
    return (scale > R(0)) ? scale : R(1);
}

/* largest = max(largest, |value|) of a finite value. */
static inline void enlarge_if_finite(real_t *largest, real_t value)
{
    if (FABS(value) < INF) {
        enlarge(largest, value);
    }
}

/* Scales of the states. */
static void state_scales(const solver_t *s, real_t *size)
{
    for (int i = 0; i < NX; i++) {
        size[i] = R(0);
        for (int k = 0; k <= N; k++) {
            enlarge(&size[i], s->x[k][i]);
        }
    }
#if STATE_ROWS
    for (int m = 0; m < NG; m++) {
#if GENERAL_ROWS || NE
        if (row_kind[m] != ROW_STATE) {
            continue;
        }
#endif
        enlarge_if_finite(&size[row_index[m]], R(0.5) * ROW_UPPER(s, m) - R(0.5) * ROW_LOWER(s, m));
    }
#endif
    for (int i = 0; i < NX; i++) {
        size[i] = scale_of(size[i]);
    }
}

/* Returns 1 if a residual is above the tolerance. */
static inline int is_far(real_t residual)
{
    return !(residual <= residual_tolerance[0]);
}
