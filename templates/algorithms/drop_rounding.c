/* Components of a plan that are zeros become 0: in a plant at rest they would decay to denormal numbers. */
static void drop_rounding(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] = or_zero(s->x[k][i], i, TOL_ZERO);
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->u[k][j] = clip(or_zero(s->u[k][j], NX + j, TOL_ZERO), control_lower(s, k, j), control_upper(s, k, j));
        }
    }
}
