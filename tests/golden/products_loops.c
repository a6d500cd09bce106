/* ==== stage products ===================================================================================== */

/* Products with the stage matrices S = [A B] and Q (lower triangle), z = (x, u):
 *   state_step        y = b + A dx + B du
 *   adjoint_step      w <- g + Q (dx, du) + S' w, from the first NX entries of w to all NZ
 *   terminal_adjoint  w = g_N + Q_N dx
 *   condense_..._columns  the same with the columns of G_k; how W is kept is theirs */
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

/* out[c] = sum_j a[j stride] rows[j][c] over NX rows, 0 <= c < width rounded up to PANEL. */
static void combine_rows(golden_real *out, const golden_real *a, int stride, const golden_real *rows, int width)
{
    int c, j, l;
    for (c = 0; c < width; c += GOLDEN_PANEL) {
        const golden_real *r = rows + c;
        golden_real sum[GOLDEN_PANEL] = {0};
        for (j = 0; j + 4 <= GOLDEN_NX; j += 4) {
            const golden_real a0 = a[j * stride], a1 = a[(j + 1) * stride], a2 = a[(j + 2) * stride], a3 = a[(j + 3) * stride];
            for (l = 0; l < GOLDEN_PANEL; l++) {
                sum[l] += (a0 * r[l] + a1 * r[GOLDEN_LDG + l]) + (a2 * r[2 * GOLDEN_LDG + l] + a3 * r[3 * GOLDEN_LDG + l]);
            }
            r += 4 * GOLDEN_LDG;
        }
        for (; j < GOLDEN_NX; j++) {
            const golden_real a0 = a[j * stride];
            for (l = 0; l < GOLDEN_PANEL; l++) {
                sum[l] += a0 * r[l];
            }
            r += GOLDEN_LDG;
        }
        for (l = 0; l < GOLDEN_PANEL; l++) {
            out[c + l] = sum[l];
        }
    }
}

/* out[c] += a row[c]. */
static void add_row(golden_real *out, golden_real a, const golden_real *row, int width)
{
    int c, l;
    for (c = 0; c < width; c += GOLDEN_PANEL) {
        golden_real sum[GOLDEN_PANEL];
        for (l = 0; l < GOLDEN_PANEL; l++) {
            sum[l] = out[c + l] + a * row[c + l];
        }
        for (l = 0; l < GOLDEN_PANEL; l++) {
            out[c + l] = sum[l];
        }
    }
}

/* G_{k+1} = A_k G_k on the first `width` columns. */
static void condense_forward_columns(golden_condensed_t *d, const golden_node_t *node, int k, int width)
{
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        combine_rows(d->G[k + 1][i], node->S[i], 1, &d->G[k][0][0], width);
    }
}

/* Structural nonzeros (row, column) of the lower triangles Q and Q_N. */
static const int Q_row[2] = { 0, 1 };
static const int Q_column[2] = { 0, 1 };
static const int Q_N_row[1] = { 0 };
static const int Q_N_column[1] = { 0 };

/* W_N = Q_N G_N on the first `width` columns, rounded up to PANEL. */
static void condense_terminal_columns(golden_condensed_t *d, golden_real (*Q)[GOLDEN_NX], int width)
{
    golden_real (*W)[GOLDEN_LDG] = d->W[GOLDEN_N & 1];
    int n;
    memset(W, 0, sizeof d->W[0]);
    for (n = 0; n < 1; n++) {
        const int r = Q_N_row[n], c = Q_N_column[n];
        add_row(W[r], Q[r][c], d->G[GOLDEN_N][c], width);
        if (r != c) {
            add_row(W[c], Q[r][c], d->G[GOLDEN_N][r], width);
        }
    }
}

/* T = B_k' W_{k+1} + S_k G_k and W_k = A_k' W_{k+1} + Q_k G_k on the first `width` columns. */
static void condense_backward_columns(golden_condensed_t *d, const golden_node_t *node, golden_real (*Q)[GOLDEN_NZ], int k, int width)
{
    const golden_real *later = &d->W[(k + 1) & 1][0][0];
    golden_real (*W)[GOLDEN_LDG] = d->W[k & 1];
    int i, n;
    for (i = 0; i < GOLDEN_NX; i++) {
        combine_rows(W[i], &node->S[0][i], GOLDEN_NZ, later, width);
    }
    for (i = 0; i < GOLDEN_NU; i++) {
        combine_rows(d->T[i], &node->S[0][GOLDEN_NX + i], GOLDEN_NZ, later, width);
    }
    for (n = 0; n < 2; n++) {
        const int r = Q_row[n], c = Q_column[n];
        if (c < GOLDEN_NX) {
            add_row((r < GOLDEN_NX) ? W[r] : d->T[r - GOLDEN_NX], Q[r][c], d->G[k][c], width);
        }
        if (r < GOLDEN_NX && r != c) {
            add_row(W[c], Q[r][c], d->G[k][r], width);
        }
    }
}
