/* ==== stage products ===================================================================================== */

/* Products with the stage matrices S = [A B] and Q (lower triangle), z = (x, u):
 *   state_step        y = b + A dx + B du
 *   adjoint_step      w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ
 *   terminal_adjoint  w = g_N + Q_N dx
 *   condense_..._panel  the same with PANEL columns of G_k at once */
/* Here: dense loops. */

static void state_step(const golden_node_t *node, const golden_real *dx, const golden_real *du, golden_real *y)
{
    int i, j;
    for (i = 0; i < GOLDEN_NX; i++) {
        golden_real sum = node->b[i];
        for (j = 0; j < GOLDEN_NX; j++) {
            sum += node->S[i][j] * dx[j];
        }
        for (j = 0; j < GOLDEN_NU; j++) {
            sum += node->S[i][GOLDEN_NX + j] * du[j];
        }
        y[i] = sum;
    }
}

static void adjoint_step(const golden_node_t *node, golden_real (*Q)[GOLDEN_NZ], const golden_real *dx, const golden_real *du, golden_real *w)
{
    golden_real z[GOLDEN_NZ];
    golden_real r[GOLDEN_NZ];
    int i, j;
    for (i = 0; i < GOLDEN_NZ; i++) {
        z[i] = (i < GOLDEN_NX) ? dx[i] : du[i - GOLDEN_NX];
        r[i] = node->g[i];
    }
    for (j = 0; j < GOLDEN_NX; j++) {
        for (i = 0; i < GOLDEN_NZ; i++) {
            r[i] += node->S[j][i] * w[j];
        }
    }
    for (j = 0; j < GOLDEN_NZ; j++) {
        for (i = 0; i < j; i++) {
            r[i] += Q[j][i] * z[j];
            r[j] += Q[j][i] * z[i];
        }
        r[j] += Q[j][j] * z[j];
    }
    memcpy(w, r, sizeof r);
}

static void terminal_adjoint(const golden_terminal_t *terminal, golden_real (*Q)[GOLDEN_NX], const golden_real *dx, golden_real *w)
{
    int i, j;
    for (i = 0; i < GOLDEN_NX; i++) {
        golden_real sum = terminal->g[i];
        for (j = 0; j < GOLDEN_NX; j++) {
            sum += ((j <= i) ? Q[i][j] : Q[j][i]) * dx[j];
        }
        w[i] = sum;
    }
}

/* G_{k+1} = A_k G_k on the columns c .. c + PANEL - 1. */
static void condense_forward_panel(golden_condensed_t *d, const golden_node_t *node, int k, int c)
{
    golden_real in[GOLDEN_NX][GOLDEN_PANEL];
    int i, j, l;
    for (i = 0; i < GOLDEN_NX; i++) {
        for (l = 0; l < GOLDEN_PANEL; l++) {
            in[i][l] = d->G[k][i][c + l];
        }
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        golden_real sum[GOLDEN_PANEL] = {0};
        for (j = 0; j < GOLDEN_NX; j++) {
            const golden_real a = node->S[i][j];
            for (l = 0; l < GOLDEN_PANEL; l++) {
                sum[l] += a * in[j][l];
            }
        }
        for (l = 0; l < GOLDEN_PANEL; l++) {
            d->G[k + 1][i][c + l] = sum[l];
        }
    }
}

/* W = Q_N G_N on the columns c .. c + PANEL - 1. */
static void condense_terminal_panel(golden_condensed_t *d, golden_real (*Q)[GOLDEN_NX], int c)
{
    int i, j, l;
    for (i = 0; i < GOLDEN_NX; i++) {
        golden_real sum[GOLDEN_PANEL] = {0};
        for (j = 0; j < GOLDEN_NX; j++) {
            const golden_real q = (j <= i) ? Q[i][j] : Q[j][i];
            for (l = 0; l < GOLDEN_PANEL; l++) {
                sum[l] += q * d->G[GOLDEN_N][j][c + l];
            }
        }
        for (l = 0; l < GOLDEN_PANEL; l++) {
            d->W[i][c + l] = sum[l];
        }
    }
}

/* out = S'w + Q (g, 0) on one panel: rows i < NX are the new W, the others a block row T of the condensed Hessian. */
static void condense_backward_row(golden_real *out, const golden_node_t *node, golden_real (*Q)[GOLDEN_NZ], int i,
    golden_real (*w)[GOLDEN_PANEL], golden_real (*g)[GOLDEN_PANEL])
{
    golden_real sum[GOLDEN_PANEL] = {0};
    int j, l;
    for (j = 0; j < GOLDEN_NX; j++) {
        const golden_real a = node->S[j][i];
        const golden_real q = (j <= i) ? Q[i][j] : Q[j][i];
        for (l = 0; l < GOLDEN_PANEL; l++) {
            sum[l] += a * w[j][l];
            sum[l] += q * g[j][l];
        }
    }
    for (l = 0; l < GOLDEN_PANEL; l++) {
        out[l] = sum[l];
    }
}

/* T = B_k' W + S_k G_k and W <- A_k' W + Q_k G_k on the columns c .. c + PANEL - 1. */
static void condense_backward_panel(golden_condensed_t *d, const golden_node_t *node, golden_real (*Q)[GOLDEN_NZ], int k, int c)
{
    golden_real w[GOLDEN_NX][GOLDEN_PANEL];
    golden_real g[GOLDEN_NX][GOLDEN_PANEL];
    int i, l;
    for (i = 0; i < GOLDEN_NX; i++) {
        for (l = 0; l < GOLDEN_PANEL; l++) {
            w[i][l] = d->W[i][c + l];
            g[i][l] = d->G[k][i][c + l];
        }
    }
    for (i = 0; i < GOLDEN_NU; i++) {
        condense_backward_row(&d->T[i][c], node, Q, GOLDEN_NX + i, w, g);
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        condense_backward_row(&d->W[i][c], node, Q, i, w, g);
    }
}
