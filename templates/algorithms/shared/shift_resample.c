/* Evaluates the old plan one sampling time later, on any grid: states by integration from the preceding node, controls
 * as their mean over the moved interval (the last control is held beyond the end), multipliers by linear interpolation.
 * The working set is kept. In place: new node k depends only on old nodes with an index of at least k, which are not
 * overwritten yet, except that the last one depends on node N - 1, which is therefore saved first. */

#include "algorithms/shared/mean_control.c"

/* Returns the interval of the plan that contains the time t, from interval n on. */
static inline int interval_at(real_t t, int n)
{
    while (n + 1 < N && node_time[n + 1] <= t) { /* at most N + N passes in shift_plan */
        n++;
    }
    return n;
}

#if LANE_SHIFT
#include "algorithms/shared/resample_lanes.c"
#else
static void resample_states(solver_t *s, const real_t *last)
{
    int n = 0;
    for (int k = 0; k <= N; k++) {
        const real_t t = node_time[k] + sampling_time[0];
        n = interval_at(t, n);
        integrate_plan(s, n, (n < N - 1) ? s->x[n] : last, t - node_time[n], s->x[k]);
    }
}
#endif

static void shift_plan(solver_t *s)
{
    real_t last[NX];
    int n = 0;
    (void)memcpy(last, s->x[N - 1], sizeof last);
    resample_states(s, last);
    for (int k = 0; k <= N; k++) {
        const real_t t = node_time[k] + sampling_time[0];
        n = interval_at(t, n);
        const real_t part = clip((t - node_time[n]) / interval_length[n], R(0), R(1));
        for (int i = 0; i < NX; i++) {
            s->lam[k][i] = s->lam[n][i] + part * (s->lam[n + 1][i] - s->lam[n][i]);
        }
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = mean_control(s, k, j, node_time[k] + sampling_time[0], node_time[k + 1] + sampling_time[0]);
            s->u[k][j] = safe_value(s, k, j);
        }
    }
}
