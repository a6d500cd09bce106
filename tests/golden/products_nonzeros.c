/* ==== stage products ===================================================================================== */

/* Products with the stage matrices S = [A B] and Q (lower triangle), z = (x, u):
 *   state_step        y = b + A dx + B du
 *   adjoint_step      w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ
 *   terminal_adjoint  w = g_N + Q_N dx
 *   condense_..._columns  the same with the columns of G_k; how W is kept is theirs */
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

/* G_{k+1} = A_k G_k on the first `width` columns, rounded up to PANEL. */
static void condense_forward_columns(golden_condensed_t *d, const golden_node_t *node, int k, int width)
{
    int c, l;
    const golden_real s_0_0 = node->S[0][0];
    for (c = 0; c < width; c += GOLDEN_PANEL) {
        for (l = c; l < c + GOLDEN_PANEL; l++) {
            const golden_real g_0 = d->G[k][0][l];
            d->G[k + 1][0][l] = s_0_0 * g_0;
        }
    }
    (void)node;
}

/* W_N = Q_N G_N on the first `width` columns, rounded up to PANEL. */
static void condense_terminal_columns(golden_condensed_t *d, golden_real (*Q)[GOLDEN_NX], int width)
{
    int c, l;
    for (c = 0; c < width; c += GOLDEN_PANEL) {
        for (l = c; l < c + GOLDEN_PANEL; l++) {
            d->W[0][0][l] = Q[0][0] * d->G[GOLDEN_N][0][l];
        }
    }
    (void)Q;
}

/* T = B_k' W_{k+1} + S_k G_k and, in place, W_k = A_k' W_{k+1} + Q_k G_k on the first `width` columns, rounded up to PANEL. */
static void condense_backward_columns(golden_condensed_t *d, const golden_node_t *node, golden_real (*Q)[GOLDEN_NZ], int k, int width)
{
    int c, l;
    const golden_real s_0_0 = node->S[0][0];
    const golden_real s_0_1 = node->S[0][1];
    const golden_real q_0_0 = Q[0][0];
    for (c = 0; c < width; c += GOLDEN_PANEL) {
        for (l = c; l < c + GOLDEN_PANEL; l++) {
            const golden_real w_0 = d->W[0][0][l];
            const golden_real g_0 = d->G[k][0][l];
            d->W[0][0][l] = s_0_0 * w_0 + q_0_0 * g_0;
            d->T[0][l] = s_0_1 * w_0;
        }
    }
    (void)node;
    (void)Q;
}
