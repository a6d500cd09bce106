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

/* Scales in which gaps of the states are measured: those that are declared, the measured state and the plans of samples
 * that were OK; before the first one, the present plan. Bounds that are set at run time count like declared ones. */
static void state_scales(const solver_t *s, real_t *size)
{
    for (int i = 0; i < NX; i++) {
        size[i] = (z_scale[i] > s->state_size[i]) ? z_scale[i] : s->state_size[i];
        for (int k = 0; k <= N && !(s->state_size[i] > R(0)); k++) {
            const real_t a = FABS(s->x[k][i]);
            size[i] = (a > size[i]) ? a : size[i];
        }
    }
    largest_of(size, s->xhat);
    if (SET_BOUNDS) {
        enlarge_by_bounds(s, 1, size);
        enlarge_by_bounds(s, N, size);
    }
}

/* At the end of a sample: what the plan of a sample that was OK says of sizes. What is beyond a scale is forgotten by one
 * half in every sample, so that a spike does not blunt tolerances for long. */
static void learn_sizes(solver_t *s, status_t status)
{
    for (int i = 0; i < NX; i++) {
        s->state_size[i] *= (s->state_size[i] > z_scale[i]) ? R(0.5) : R(1);
    }
    for (int k = 0; k <= N && status == OK; k++) {
        largest_of(s->state_size, s->x[k]);
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
        size[j] = size_or(size[j], z_scale[NX + j]);
    }
}

#include "algorithms/judged.c"
