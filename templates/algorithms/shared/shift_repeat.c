/* Moves the plan by one interval: x_k <- x_{k+1}, u_k <- u_{k+1}; the last control is repeated and the last interval
 * integrated (x_N is kept if that overflows). Multipliers and working set move as well. */
static void shift_plan(solver_t *s)
{
    real_t tail[NX];
    shift_by_one(s);
    if (IDLE_END && N > 1) {
        interval_value(s, N - 2, tail);
        if (all_finite(tail, NX)) {
            (void)memcpy(s->x[N - 1], tail, sizeof tail);
        }
    }
    interval_value(s, N - 1, tail);
    if (all_finite(tail, NX)) {
        (void)memcpy(s->x[N], tail, sizeof tail);
    }
}
