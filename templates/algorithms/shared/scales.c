/* largest = max(largest, |value|) of a finite value. */
static inline void enlarge_if_finite(real_t *largest, real_t value)
{
    if (FABS(value) < INF) {
        enlarge(largest, value);
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

/* Computes the sizes in which gaps of the states are measured: magnitudes of the plan, the measured state, half the
 * width of bounds. They are at least a fraction of the scales, so that a plan at rest is not measured in rounding
 * errors. A plan that diverges is measured in the sizes of the last plan that was OK. */
static void state_scales(const solver_t *s, real_t *size)
{
    (void)memset(size, 0, NX * sizeof *size);
    for (int k = 0; k <= N; k++) {
        enlarge_all(size, s->x[k], NX);
    }
    for (int i = 0; i < NX; i++) {
        const real_t least = FACTOR_SCALE_LITTLE_OF_STATE * z_scale[i];
        const real_t most = FACTOR_SCALE_STATE_GROWTH * ((s->state_size[i] > least) ? s->state_size[i] : least);
        size[i] = clip(size[i], least, most);
    }
    enlarge_all(size, s->xhat, NX);
    enlarge_by_bounds(s, 1, size);
    enlarge_by_bounds(s, N, size);
}

/* Learns sizes from the plan of a sample with status OK. */
static void learn_sizes(solver_t *s, status_t status)
{
    if (status == OK) {
        (void)memset(s->state_size, 0, sizeof s->state_size);
        for (int k = 0; k <= N; k++) {
            enlarge_all(s->state_size, s->x[k], NX);
        }
    }
}

/* Computes the sizes of the controls: largest magnitudes in the plan, or half the width of their bounds. */
static void control_sizes(const solver_t *s, real_t *size)
{
    for (int j = 0; j < NU; j++) {
        size[j] = R(0);
        for (int k = 0; k < N; k++) {
            enlarge(&size[j], s->u[k][j]);
            enlarge_if_finite(&size[j], R(0.5) * control_upper(s, k, j) - R(0.5) * control_lower(s, k, j));
        }
        size[j] = size_or(size[j], z_scale[NX + j]);
    }
}

#include "algorithms/shared/judge.c"
