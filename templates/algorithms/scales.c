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

/* largest = max(largest, |v|) by states; numbers that are not finite show in the QP. */
static inline void largest_of(real_t *largest, const real_t *v)
{
    for (int i = 0; i < NX; i++) {
        const real_t a = FABS(v[i]);
        largest[i] = (a > largest[i]) ? a : largest[i];
    }
}

/* size = max(size, half the width of the bounds of the states at node k). */
static void enlarge_by_bounds(const solver_t *s, int k, real_t *size)
{
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (row_is_state(m)) {
            enlarge_if_finite(&size[row_index(m)], R(0.5) * row_upper(s, m) - R(0.5) * row_lower(s, m));
        }
    }
}

/* Scales of the states: their largest magnitudes in the plan, half the width of their bounds at the first and last node. */
static void state_scales(const solver_t *s, real_t *size)
{
    memset(size, 0, NX * sizeof *size);
    for (int k = 0; k <= N; k++) {
        largest_of(size, s->x[k]);
    }
    enlarge_by_bounds(s, 1, size);
    enlarge_by_bounds(s, N, size);
    for (int i = 0; i < NX; i++) {
        size[i] = scale_of(size[i]);
    }
}

/* Sizes of the controls: largest magnitudes in the plan, or half the width of their bounds. */
static void control_sizes(const solver_t *s, real_t *size)
{
    for (int j = 0; j < NU; j++) {
        size[j] = R(0);
        for (int k = 0; k < N; k++) {
            enlarge(&size[j], s->u[k][j]);
            enlarge_if_finite(&size[j], R(0.5) * control_upper(s, k, j) - R(0.5) * control_lower(s, k, j));
        }
        size[j] = scale_of(size[j]);
    }
}

#include "algorithms/judged.c"
