/* A periodic plan moves by one interval: its first control becomes its last one, and the states are integrated anew. */
static void shift_plan(solver_t *s)
{
    real_t first[NU];
    int k, i;
    memcpy(first, s->u[0], sizeof first);
    shift_by_one(s);
    for (i = 0; i < NU; i++) {
        s->u[N - 1][i] = clip(first[i], control_lower(s, N - 1, i), control_upper(s, N - 1, i));
    }
    for (i = 0; i < NX; i++) {
        s->x[0][i] = is_accumulator[i] ? R(0) : s->x[0][i];
    }
    for (k = 0; k < N; k++) {
        interval_value(s->x[k], s->u[k], PARAM(s, k), interval_length[k], s->x[k + 1]);
    }
}
