/* ==== stage products ===================================================================================== */

/* Products with the stage matrices S = [A B] and Q (lower triangle), z = (x, u):
 *   state_step        y = b + A dx + B du
 *   adjoint_step      w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ
 *   terminal_adjoint  w = g_N + Q_N dx */
/* Here: dense loops. */

/* Structural nonzeros (row, column) of the lower triangles Q and Q_N. */
static const int Q_row[2] = { 0, 1 };
static const int Q_column[2] = { 0, 1 };
static const int Q_N_row[1] = { 0 };
static const int Q_N_column[1] = { 0 };

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
    for (i = 0; i < 2; i++) {
        const int a = Q_row[i], b = Q_column[i];
        r[a] += Q[a][b] * z[b];
        if (a != b) {
            r[b] += Q[a][b] * z[a];
        }
    }
    memcpy(w, r, sizeof r);
}

static void terminal_adjoint(const golden_terminal_t *terminal, golden_real (*Q)[GOLDEN_NX], const golden_real *dx, golden_real *w)
{
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        w[i] = terminal->g[i];
    }
    for (i = 0; i < 1; i++) {
        const int a = Q_N_row[i], b = Q_N_column[i];
        w[a] += Q[a][b] * dx[b];
        if (a != b) {
            w[b] += Q[a][b] * dx[a];
        }
    }
}
