/* Moves a periodic plan by one interval: the first control becomes the last one, and the states are integrated
 * again. */
static void shift_plan(solver_t *s)
{
    real_t first[NU];
    (void)memcpy(first, s->u[0], sizeof first);
    shift_by_one(s);
    for (int j = 0; j < NU; j++) {
        s->u[N - 1][j] = clip(first[j], control_lower(s, N - 1, j), control_upper(s, N - 1, j));
    }
    if (ACCUMULATORS) {
        for (int i = 0; i < NX; i++) {
            s->x[0][i] = is_accumulator[i] ? R(0) : s->x[0][i];
        }
    }
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
}
