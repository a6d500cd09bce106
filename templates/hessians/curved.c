/* In a search, s->curved holds the Hessian as full symmetric blocks and s->hessian is zero; the dense products below
 * are added to products with the nonzeros of s->hessian. */

/* w += Q_k (dx, du). */
static void add_curvature(const solver_t *s, int k, const real_t *dx, const real_t *du, real_t *w)
{
    for (int i = 0; i < NZ; i++) {
        for (int j = 0; j < NX; j++) {
            w[i] += s->curved.Q[k][i][j] * dx[j];
        }
        for (int j = 0; j < NU; j++) {
            w[i] += s->curved.Q[k][i][NX + j] * du[j];
        }
    }
}

/* w += Q_N dx. */
static void add_terminal_curvature(const solver_t *s, const real_t *dx, real_t *w)
{
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            w[i] += s->curved.Q_N[i][j] * dx[j];
        }
    }
}

/* W += Q G for n rows of Q with `ld` entries each, and a panel of columns G. */
static void add_curved_panel(real_t (*W)[COLUMNS], const real_t *Q, int ld, int n, real_t (*G)[COLUMNS])
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < NX; j++) {
            for (int l = 0; l < COLUMNS; l++) {
                W[i][l] += Q[i * ld + j] * G[j][l];
            }
        }
    }
}
