/* ==== condensing: full ==================================================================================== */

/* Seam "condensing", contract:
 *   condense_init      once: constant parts
 *   condense_hessian   preparation: G_k, condensed Hessian (lower triangle) into qp.H, its coupling Hx to dx_0
 *   condense_gradient  preparation, again after a change of reference: c_k, condensed gradient g
 *   condense_rows      preparation: rows of the QP into qp.A, their values v and coupling Ax to dx_0
 *   condense_embed     feedback: gradient and bounds of the QP for the measured dx_0
 *   condense_expand    feedback: dx_k from dx_0 and du (in qp.z)
 * Here: dx_k = G_k (dx_0, du_0, ..., du_{N-1}) + c_k, all states but dx_0 eliminated in O(N^2). Variables of the QP are
 * du_0 .. du_{N-1}, then the free components of dx_0. */

static void condense_init(golden_solver_t *s)
{
    int i;
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

/* Rows of the QP: A = J_x G_k + J_u at du_k, value v = row + J_x c_k; a state row is J_x = e_i. */
static void condense_rows(golden_solver_t *s)
{
    golden_condensed_t *d = &s->condensed;
    int m, i, j;
    for (m = 0; m < GOLDEN_NG; m++) {
        const int k = row_node[m];
        golden_real J[GOLDEN_NZ];
        golden_real value = row_gradient(s, m, J);
        golden_real *a = s->qp.A[m];
        for (j = 0; j < GOLDEN_NX; j++) {
            d->Ax[m][j] = 0.0;
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
                value += J[i] * d->c[k][i];
            }
        }
        for (j = 0; k < GOLDEN_N && j < GOLDEN_NU; j++) {
            a[k * GOLDEN_NU + j] = J[GOLDEN_NX + j];
        }
        for (j = 0; j < GOLDEN_NF; j++) {
            a[GOLDEN_N * GOLDEN_NU + j] = d->Ax[m][free_state[j]];
        }
        d->v[m] = value;
    }
}

/* g = g(0) + Hx dx_0, free components of dx_0 apart;  bounds of du and of the rows relative to the present iterate. */
static void condense_embed(golden_solver_t *s)
{
    golden_condensed_t *d = &s->condensed;
    golden_real dx0[GOLDEN_NX];
    int k, j, m, i;
    for (i = 0; i < GOLDEN_NX; i++) {
        dx0[i] = d->dx[0][i];
    }
    for (j = 0; j < GOLDEN_NF; j++) {
        const int row = GOLDEN_N * GOLDEN_NU + j;
        dx0[free_state[j]] = 0.0;
        s->qp.lower[row] = -(golden_real)INFINITY;
        s->qp.upper[row] = (golden_real)INFINITY;
    }
    for (j = 0; j < GOLDEN_NF; j++) {
        const int row = GOLDEN_N * GOLDEN_NU + j;
        s->qp.g[row] = d->g[row];
        for (i = 0; i < GOLDEN_NX; i++) {
            s->qp.g[row] += d->Hx[row][i] * dx0[i];
        }
    }
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

/* dx_{k+1} = A_k dx_k + B_k du_k + b_k. */
static void condense_expand(golden_solver_t *s)
{
    golden_condensed_t *d = &s->condensed;
    int k;
    for (k = 0; k < GOLDEN_NF; k++) {
        d->dx[0][free_state[k]] = s->qp.z[GOLDEN_N * GOLDEN_NU + k];
    }
    for (k = 0; k < GOLDEN_N; k++) {
        state_step(&s->node[k], d->dx[k], &s->qp.z[k * GOLDEN_NU], d->dx[k + 1]);
    }
}
