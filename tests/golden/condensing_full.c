/* ==== condensing: full ==================================================================================== */

/* Seam "condensing", contract:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: everything that needs neither xhat nor the final bounds, the QP's factorisation included
 *   condense_gradient  gradients of the nodes have changed, nothing else
 *   condense_rows      gaps b and values of the rows have changed, no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_shift     the predicted working set moves by one interval (its own template: for plans that do)
 * Here: dx_k = G_k (dx_0, du_0, ..., du_{N-1}) + c_k, all states but dx_0 eliminated in O(N^2). Variables of the QP are
 * du_0 .. du_{N-1}, the free components of dx_0, and a slack sigma for every row with a quadratic penalty:
 * lower <= row - sigma <= upper, cost l2/2 sigma^2, sigma = 0 elastic with penalty l1. */

/* Products with the columns of G_k; how W is kept is theirs. */

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

static void qp_init(golden_qp_t *q);
static golden_status_t qp_factorize(golden_qp_t *q);
static golden_status_t qp_solve(golden_qp_t *q);

static void condense_init(golden_solver_t *s)
{
    int i;
    qp_init(&s->qp);
    for (i = 0; i < GOLDEN_NX; i++) {
        s->condensed.G[0][i][i] = 1.0;
    }
}

/* The block row k of T goes to the condensed Hessian (lower triangle, plus R_k) and to its coupling to dx_0. */
static void condense_store_rows(golden_solver_t *s, golden_real (*Q)[GOLDEN_NZ], int k)
{
    int i, j;
    for (j = 0; j < GOLDEN_NU; j++) {
        const int row = k * GOLDEN_NU + j;
        const golden_real *t = s->condensed.T[j];
        for (i = 0; i < GOLDEN_NX; i++) {
            s->condensed.Hx[row][i] = t[i];
        }
        for (i = 0; i < k * GOLDEN_NU; i++) {
            s->qp.H[row][i] = t[GOLDEN_NX + i];
        }
        for (i = 0; i <= j; i++) {
            s->qp.H[row][k * GOLDEN_NU + i] = t[GOLDEN_NX + k * GOLDEN_NU + i] + Q[GOLDEN_NX + j][GOLDEN_NX + i];
        }
    }
}

/* Rows of the free components of dx_0, from W_0 = d2 cost / d(dx_0)^2 and the coupling of the controls. */
static void condense_store_free(golden_solver_t *s)
{
    int f, e, i;
    for (f = 0; f < GOLDEN_NF; f++) {
        const int row = GOLDEN_N * GOLDEN_NU + f;
        const golden_real *w = s->condensed.W[0][free_state[f]];
        for (i = 0; i < GOLDEN_NX; i++) {
            s->condensed.Hx[row][i] = w[i];
        }
        for (i = 0; i < GOLDEN_N * GOLDEN_NU; i++) {
            s->qp.H[row][i] = s->condensed.Hx[i][free_state[f]];
        }
        for (e = 0; e <= f; e++) {
            s->qp.H[row][GOLDEN_N * GOLDEN_NU + e] = w[free_state[e]];
        }
    }
}

/* Hessian rows of the slacks: l2 on the diagonal. */
static void condense_store_slacks(golden_solver_t *s)
{
    int m, i;
    for (m = 0; m < GOLDEN_NG; m++) {
        const int row = row_slack[m];
        for (i = 0; row >= 0 && i <= row; i++) {
            s->qp.H[row][i] = (i == row) ? row_curvature(m) : 0.0;
        }
    }
}

/* Forward: G_{k+1} = [A_k G_k, B_k at du_k]. Backward: block rows of the condensed Hessian from the last to the first. */
static void condense_hessian(golden_solver_t *s)
{
    golden_condensed_t *d = &s->condensed;
    int k, i, j;
    for (k = 0; k < GOLDEN_N; k++) {
        const int width = GOLDEN_NX + k * GOLDEN_NU;
        condense_forward_columns(d, &s->node[k], k, width);
        for (i = 0; i < GOLDEN_NX; i++) {
            for (j = 0; j < GOLDEN_NU; j++) {
                d->G[k + 1][i][width + j] = s->node[k].S[i][GOLDEN_NX + j];
            }
        }
    }
    condense_terminal_columns(d, s->hessian.Q_N, GOLDEN_NX + GOLDEN_N * GOLDEN_NU);
    for (k = GOLDEN_N - 1; k >= 0; k--) {
        golden_real (*Q)[GOLDEN_NZ] = s->hessian.Q[GOLDEN_NQ == 1 ? 0 : k];
        condense_backward_columns(d, &s->node[k], Q, k, GOLDEN_NX + (k + 1) * GOLDEN_NU);
        condense_store_rows(s, Q, k);
    }
    condense_store_free(s);
    condense_store_slacks(s);
}

/* c_0 = 0, c_{k+1} = A_k c_k + b_k;  w_N = q_N + Q_N c_N;  g_k = r_k + S_k c_k + B_k' w_{k+1};
 * w_k = q_k + Q_k c_k + A_k' w_{k+1}. */
static void condense_gradient(golden_solver_t *s)
{
    golden_condensed_t *d = &s->condensed;
    const golden_real du[GOLDEN_NU] = {0};
    golden_real w[GOLDEN_NZ];
    int k, j;
    for (k = 0; k < GOLDEN_N; k++) {
        state_step(&s->node[k], d->c[k], du, d->c[k + 1]);
    }
    terminal_adjoint(&s->terminal, s->hessian.Q_N, d->c[GOLDEN_N], w);
    for (k = GOLDEN_N - 1; k >= 0; k--) {
        adjoint_step(&s->node[k], s->hessian.Q[GOLDEN_NQ == 1 ? 0 : k], d->c[k], du, w);
        for (j = 0; j < GOLDEN_NU; j++) {
            d->g[k * GOLDEN_NU + j] = w[GOLDEN_NX + j];
        }
    }
    for (j = 0; j < GOLDEN_NF; j++) {
        d->g[GOLDEN_N * GOLDEN_NU + j] = w[free_state[j]];
    }
}

/* Row m of the QP: A = J_x G_k + J_u at du_k, value v = row + J_x c_k; a state row is J_x = e_i, a coupled row has
 * J_0 dx_0 besides. */
static void condense_row(golden_solver_t *s, int m)
{
    golden_condensed_t *d = &s->condensed;
    const int k = row_node[m];
    golden_real J[GOLDEN_NZ];
    golden_real *a = s->qp.A[m];
    int i, j;
    d->v[m] = row_gradient(s, m, J);
    for (j = 0; j < GOLDEN_NX; j++) {
        d->Ax[m][j] = (row_kind[m] == 2) ? s->coupled.J_0[row_index[m]][j] : 0.0;
    }
    for (j = 0; j < GOLDEN_NV; j++) {
        a[j] = 0.0;
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        if (J[i] != 0.0) {
            const golden_real *g = d->G[k][i];
            for (j = 0; j < GOLDEN_NX; j++) {
                d->Ax[m][j] += J[i] * g[j];
            }
            for (j = 0; j < k * GOLDEN_NU; j++) {
                a[j] += J[i] * g[GOLDEN_NX + j];
            }
            d->v[m] += J[i] * d->c[k][i];
        }
    }
    for (j = 0; k < GOLDEN_N && j < GOLDEN_NU; j++) {
        a[k * GOLDEN_NU + j] = J[GOLDEN_NX + j];
    }
    for (j = 0; j < GOLDEN_NF; j++) {
        a[GOLDEN_N * GOLDEN_NU + j] = d->Ax[m][free_state[j]];
    }
    if (row_slack[m] >= 0) {
        a[row_slack[m]] = -1.0;
    }
}

/* Gradient and bounds of the free components of dx_0 and of the slacks; dx0 has zeros at free components. */
static void condense_embed_others(golden_solver_t *s, const golden_real *dx0)
{
    int j, i, m;
    for (j = 0; j < GOLDEN_NF; j++) {
        const int row = GOLDEN_N * GOLDEN_NU + j;
        s->qp.g[row] = s->condensed.g[row];
        for (i = 0; i < GOLDEN_NX; i++) {
            s->qp.g[row] += s->condensed.Hx[row][i] * dx0[i];
        }
        s->qp.lower[row] = -(golden_real)INFINITY;
        s->qp.upper[row] = (golden_real)INFINITY;
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        const int slack = row_slack[m];
        const golden_real l1 = row_penalty(s, m);
        s->qp.penalty[GOLDEN_NV + m] = (slack < 0) ? l1 : (golden_real)INFINITY;
        if (slack >= 0) {
            s->qp.g[slack] = s->qp.lower[slack] = s->qp.upper[slack] = 0.0;
            s->qp.penalty[slack] = l1;
        }
    }
}

/* g = g(0) + Hx dx_0, free components of dx_0 apart;  bounds of du and of the rows relative to the present iterate. */
static void condense_embed(golden_solver_t *s)
{
    golden_condensed_t *d = &s->condensed;
    golden_real dx0[GOLDEN_NX];
    int k, j, m, i;
    for (i = 0; i < GOLDEN_NX; i++) {
        dx0[i] = s->step.dx[0][i];
    }
    for (j = 0; j < GOLDEN_NF; j++) {
        dx0[free_state[j]] = 0.0;
    }
    condense_embed_others(s, dx0);
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            const int row = k * GOLDEN_NU + j;
            golden_real sum = d->g[row];
            for (i = 0; i < GOLDEN_NX; i++) {
                sum += d->Hx[row][i] * dx0[i];
            }
            s->qp.g[row] = sum;
            s->qp.lower[row] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[row] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        golden_real value = d->v[m];
        for (i = 0; i < GOLDEN_NX; i++) {
            value += d->Ax[m][i] * dx0[i];
        }
        s->qp.lower[GOLDEN_NV + m] = row_lower(s, m) - value;
        s->qp.upper[GOLDEN_NV + m] = row_upper(s, m) - value;
    }
}

static void condense_rows(golden_solver_t *s)
{
    int m;
    condense_gradient(s);
    for (m = 0; m < GOLDEN_NG; m++) {
        condense_row(s, m);
    }
}

/* A condensed Hessian that is not positive definite stays as it is. */
static golden_status_t condense_factorize(golden_solver_t *s)
{
    return qp_factorize(&s->qp);
}

static golden_status_t condense_prepare(golden_solver_t *s)
{
    condense_hessian(s);
    condense_rows(s);
    memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return condense_factorize(s);
}

/* du and multipliers from the QP;  dx_{k+1} = A_k dx_k + B_k du_k + b_k. */
static void condense_expand(golden_solver_t *s)
{
    golden_step_t *d = &s->step;
    int k, j;
    for (j = 0; j < GOLDEN_NF; j++) {
        d->dx[0][free_state[j]] = s->qp.z[GOLDEN_N * GOLDEN_NU + j];
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            d->du[k][j] = s->qp.z[k * GOLDEN_NU + j];
            d->mult_u[k][j] = s->qp.mult[k * GOLDEN_NU + j];
        }
        state_step(&s->node[k], d->dx[k], d->du[k], d->dx[k + 1]);
    }
    for (j = 0; j < GOLDEN_NG; j++) {
        d->mult[j] = s->qp.mult[GOLDEN_NV + j];
    }
}

static golden_status_t condense_solve(golden_solver_t *s)
{
    golden_status_t status;
    condense_embed(s);
    status = qp_solve(&s->qp);
    condense_expand(s);
    return status;
}
