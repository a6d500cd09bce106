/* The plan moves by one interval: x_k <- x_{k+1}, u_k <- u_{k+1}, the last control is repeated and the tail integrated
 * (x_N stays if that overflows); multipliers and the working set move with it. */
static void shift_plan(solver_t *s)
{
    real_t tail[NX];
    shift_by_one(s);
    interval_value(s, N - 1, tail);
    if (all_finite(tail, NX)) {
        memcpy(s->x[N], tail, sizeof tail);
    }
}
