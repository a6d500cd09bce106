/* Contract of this part: shift_plan() moves controls, states and row multipliers to the next sample. */

/* Moves the multiplier of each row from node k + 1 to node k, if the row is imposed at both. */
static void shift_rows(solver_t *s)
{
    for (int m = 0; m < NG; m++) {
        int source = m;
        for (int next = m + 1; next < NG && row_node(next) <= row_node(m) + 1; next++) {
            if (row_node(next) > row_node(m) && row_id(next) == row_id(m)) {
                source = next;
            }
        }
        s->row[m] = s->row[source];
    }
}

#if SHIFT_RESAMPLE
#include "algorithms/shared/mean_control.c"

/* Evaluates the old plan one sampling time later: x_0 by integration, controls as means of the old controls over the
 * new intervals, the other states by simulation. Multipliers are kept. */
static void shift_plan(solver_t *s)
{
    real_t first[NX];
    int n = 0;
    for (int k = 0; k + 1 < N; k++) {
        n += node_time[k + 1] <= sampling_time[0];
    }
    integrate_plan(s, n, s->x[n], sampling_time[0] - node_time[n], first);
    (void)memcpy(s->x[0], first, sizeof first);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = mean_control(s, k, j, node_time[k] + sampling_time[0], node_time[k + 1] + sampling_time[0]);
            s->u[k][j] = safe_value(s, k, j);
        }
    }
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
}
#else
/* Moves the data of node k + 1 to node k. The last control is repeated, or replaced by the first one if the plan is
 * periodic; the last interval is integrated. */
static void shift_plan(solver_t *s)
{
    real_t first[NU];
    (void)memcpy(first, s->u[0], sizeof first);
    for (int k = 0; k < N; k++) {
        (void)memcpy(s->x[k], s->x[k + 1], sizeof s->x[k]);
        for (int j = 0; j < NU; j++) {
            if (SHIFT_PERIODIC) {
                s->u[k][j] = (k + 1 < N) ? s->u[k + 1][j] : first[j];
            } else {
                s->u[k][j] = (k + 1 < N) ? s->u[k + 1][j] : s->u[k][j];
            }
            s->u[k][j] = safe_value(s, k, j);
        }
    }
    interval_value(s, N - 1, s->x[N]);
    if (ROWS_MOVE) {
        shift_rows(s);
    }
}
#endif

status_t API(shift)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    shift_plan(s);
    s->solved = 0;
    return OK;
}
