/* ==== stage products ===================================================================================== */

/* Products with the stage matrices S = [A B] and Q (lower triangle), z = (x, u):
 *   state_step        y = b + A dx + B du
 *   adjoint_step      w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ
 *   terminal_adjoint  w = g_N + Q_N dx */
/* Here: written out over the structural nonzeros. */

static inline void state_step(const golden_node_t *node, const golden_real *dx, const golden_real *du, golden_real *y)
{
    const golden_real y_0 = node->b[0] + node->S[0][0] * dx[0] + node->S[0][1] * du[0];
    y[0] = y_0;
}

static inline void adjoint_step(const golden_node_t *node, golden_real (*Q)[GOLDEN_NZ], const golden_real *dx, const golden_real *du, golden_real *w)
{
    const golden_real w_0 = node->g[0] + Q[0][0] * dx[0] + node->S[0][0] * w[0];
    const golden_real w_1 = node->g[1] + Q[1][1] * du[0] + node->S[0][1] * w[0];
    w[0] = w_0;
    w[1] = w_1;
    (void)Q;
    (void)dx;
    (void)du;
}

static inline void terminal_adjoint(const golden_terminal_t *terminal, golden_real (*Q)[GOLDEN_NX], const golden_real *dx, golden_real *w)
{
    w[0] = terminal->g[0] + Q[0][0] * dx[0];
    (void)Q;
    (void)dx;
}
