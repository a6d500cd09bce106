/* ==== stage products ===================================================================================== */

/* Products with the stage matrices S = [A B] and Q (lower triangle): written out over the structural nonzeros. */

/* y = b + A dx + B du: 2 add, 2 mul */
static inline void state_step(const node_t *node, const real_t *dx, const real_t *du, real_t *y)
{
    const real_t y_0 = node->b[0] + node->S[0][1] * du[0] + node->S[0][0] * dx[0];
    y[0] = y_0;
}

/* w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ: 4 add, 4 mul */
static inline void adjoint_step(const node_t *node, real_t (*Q)[NZ], const real_t *dx, const real_t *du, real_t *w)
{
    const real_t w_0 = node->g[0] + Q[0][0] * dx[0] + node->S[0][0] * w[0];
    const real_t w_1 = node->g[1] + Q[1][1] * du[0] + node->S[0][1] * w[0];
    w[0] = w_0;
    w[1] = w_1;
}

/* w = g_N + Q_N dx: 1 add, 1 mul */
static inline void terminal_adjoint(const terminal_t *terminal, real_t (*Q)[NX], const real_t *dx, real_t *w)
{
    w[0] = terminal->g[0] + Q[0][0] * dx[0];
}
