/* Q_0 += second derivatives of the cost of x_0, lower triangles. */
static void add_start_hessian(solver_t *s)
{
    real_t Q[NX][NX] = {{R(0)}};
    START_HESSIAN(s, Q);
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j <= i; j++) {
            s->hessian.Q[0][i][j] += Q[i][j];
        }
    }
}
