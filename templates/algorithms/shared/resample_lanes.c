#include "generated/lane_shift.c"

static void resample_states(solver_t *s, const real_t *last)
{
    int n = 0;
    for (int k = 0; k <= N; k += VECTOR_LANES) {
        n = integrate_lanes(s, k, n, last);
    }
}
