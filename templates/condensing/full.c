/* Seam "condensing", contract:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: everything that needs neither xhat nor the final bounds, the QP's factorisation included
 *   condense_gradient  gradients of the nodes have changed, nothing else
 *   condense_rows      gaps b and values of the rows have changed, no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_shift     the predicted working set moves by one interval
 * Here: dx_k = G_k (dx_0, du_0, ..., du_{N-1}) + c_k, all states but dx_0 eliminated in O(N^2). Variables of the QP are
 * du_0 .. du_{N-1}, the free components of dx_0, and a slack sigma for every row with a quadratic penalty:
 * lower <= row - sigma <= upper, cost l2/2 sigma^2, sigma = 0 elastic with penalty l1. */

#include "generated/product_columns.c"

static void qp_init(qp_t *q);
static status_t qp_factorize(qp_t *q);
static status_t qp_solve(qp_t *q);

static void condense_init(solver_t *s)
{
    int i;
    qp_init(&s->qp);
    for (i = 0; i < NX; i++) {
        s->condensed.G[0][i][i] = R(1);
    }
}

/* The block row k of T goes to the condensed Hessian (lower triangle, plus R_k) and to its coupling to dx_0. */
static void condense_store_rows(solver_t *s, real_t (*Q)[NZ], int k)
{
    int i, j;
    for (j = 0; j < NU; j++) {
        const int row = k * NU + j;
        const real_t *t = s->condensed.T[j];
        for (i = 0; i < NX; i++) {
            s->condensed.Hx[row][i] = t[i];
        }
        for (i = 0; i < k * NU; i++) {
            s->qp.H[row][i] = t[NX + i];
        }
        for (i = 0; i <= j; i++) {
            s->qp.H[row][k * NU + i] = t[NX + k * NU + i] + Q[NX + j][NX + i];
        }
    }
}

/* Rows of the free components of dx_0, from W_0 = d2 cost / d(dx_0)^2 and the coupling of the controls. */
static void condense_store_free(solver_t *s)
{
    int f, e, i;
    for (f = 0; f < NF; f++) {
        const int row = N * NU + f;
        const real_t *w = s->condensed.W[0][free_state[f]];
        for (i = 0; i < NX; i++) {
            s->condensed.Hx[row][i] = w[i];
        }
        for (i = 0; i < N * NU; i++) {
            s->qp.H[row][i] = s->condensed.Hx[i][free_state[f]];
        }
        for (e = 0; e <= f; e++) {
            s->qp.H[row][N * NU + e] = w[free_state[e]];
        }
    }
}

/* Hessian rows of the slacks: l2 on the diagonal. */
static void condense_store_slacks(solver_t *s)
{
    int m, i;
    for (m = 0; m < NG; m++) {
        const int row = row_slack[m];
        for (i = 0; row >= 0 && i <= row; i++) {
            s->qp.H[row][i] = (i == row) ? ROW_CURVATURE(m) : R(0);
        }
    }
}

/* Forward: G_{k+1} = [A_k G_k, B_k at du_k]. Backward: block rows of the condensed Hessian from the last to the first. */
static void condense_hessian(solver_t *s)
{
    condensed_t *d = &s->condensed;
    int k, i, j;
    for (k = 0; k < N; k++) {
        const int width = NX + k * NU;
        condense_forward_columns(d, &s->node[k], k, width);
        for (i = 0; i < NX; i++) {
            for (j = 0; j < NU; j++) {
                d->G[k + 1][i][width + j] = s->node[k].S[i][NX + j];
            }
        }
    }
    condense_terminal_columns(d, s->hessian.Q_N, NX + N * NU);
    for (k = N - 1; k >= 0; k--) {
        real_t (*Q)[NZ] = s->hessian.Q[NQ == 1 ? 0 : k];
        condense_backward_columns(d, &s->node[k], Q, k, NX + (k + 1) * NU);
        condense_store_rows(s, Q, k);
    }
    condense_store_free(s);
    condense_store_slacks(s);
}

/* c_0 = 0, c_{k+1} = A_k c_k + b_k;  w_N = q_N + Q_N c_N;  g_k = r_k + S_k c_k + B_k' w_{k+1};
 * w_k = q_k + Q_k c_k + A_k' w_{k+1}. */
static void condense_gradient(solver_t *s)
{
    condensed_t *d = &s->condensed;
    const real_t du[NU] = {0};
    real_t w[NZ];
    int k, j;
    for (k = 0; k < N; k++) {
        state_step(&s->node[k], d->c[k], du, d->c[k + 1]);
    }
    terminal_adjoint(&s->terminal, s->hessian.Q_N, d->c[N], w);
    for (k = N - 1; k >= 0; k--) {
        adjoint_step(&s->node[k], s->hessian.Q[NQ == 1 ? 0 : k], d->c[k], du, w);
        for (j = 0; j < NU; j++) {
            d->g[k * NU + j] = w[NX + j];
        }
    }
    for (j = 0; j < NF; j++) {
        d->g[N * NU + j] = w[free_state[j]];
    }
}

#if NG
/* Row m of the QP: A = J_x G_k + J_u at du_k, value v = row + J_x c_k; a state row is J_x = e_i, a coupled row has
 * J_0 dx_0 besides. */
static void condense_row(solver_t *s, int m)
{
    condensed_t *d = &s->condensed;
    const int k = row_node[m];
    real_t J[NZ];
    real_t *a = s->qp.A[m];
    int i, j;
    d->v[m] = row_gradient(s, m, J);
    for (j = 0; j < NX; j++) {
#if NE
        d->Ax[m][j] = IS_COUPLED(m) ? s->coupled.J_0[row_index[m]][j] : R(0);
#else
        d->Ax[m][j] = R(0);
#endif
    }
    for (j = 0; j < NV; j++) {
        a[j] = R(0);
    }
    for (i = 0; i < NX; i++) {
        if (J[i] != R(0)) {
            const real_t *g = d->G[k][i];
            for (j = 0; j < NX; j++) {
                d->Ax[m][j] += J[i] * g[j];
            }
            for (j = 0; j < k * NU; j++) {
                a[j] += J[i] * g[NX + j];
            }
            d->v[m] += J[i] * d->c[k][i];
        }
    }
    for (j = 0; k < N && j < NU; j++) {
        a[k * NU + j] = J[NX + j];
    }
    for (j = 0; j < NF; j++) {
        a[N * NU + j] = d->Ax[m][free_state[j]];
    }
    if (row_slack[m] >= 0) {
        a[row_slack[m]] = -R(1);
    }
}
#endif

/* Gradient and bounds of the free components of dx_0 and of the slacks; dx0 has zeros at free components. */
static void condense_embed_others(solver_t *s, const real_t *dx0)
{
    int j, i;
    for (j = 0; j < NF; j++) {
        const int row = N * NU + j;
        s->qp.g[row] = s->condensed.g[row];
        for (i = 0; i < NX; i++) {
            s->qp.g[row] += s->condensed.Hx[row][i] * dx0[i];
        }
        s->qp.lower[row] = -(real_t)INFINITY;
        s->qp.upper[row] = (real_t)INFINITY;
    }
#if NG
    for (int m = 0; m < NG; m++) {
        const int slack = row_slack[m];
        const real_t l1 = ROW_PENALTY(s, m);
        s->qp.penalty[NV + m] = (slack < 0) ? l1 : (real_t)INFINITY;
        if (slack >= 0) {
            s->qp.g[slack] = s->qp.lower[slack] = s->qp.upper[slack] = R(0);
            s->qp.penalty[slack] = l1;
        }
    }
#endif
}

/* g = g(0) + Hx dx_0, free components of dx_0 apart;  bounds of du and of the rows relative to the present iterate. */
static void condense_embed(solver_t *s)
{
    condensed_t *d = &s->condensed;
    real_t dx0[NX];
    int k, j, i;
    for (i = 0; i < NX; i++) {
        dx0[i] = s->step.dx[0][i];
    }
    for (j = 0; j < NF; j++) {
        dx0[free_state[j]] = R(0);
    }
    condense_embed_others(s, dx0);
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            const int row = k * NU + j;
            real_t sum = d->g[row];
            for (i = 0; i < NX; i++) {
                sum += d->Hx[row][i] * dx0[i];
            }
            s->qp.g[row] = sum;
            s->qp.lower[row] = CONTROL_LOWER(s, k, j) - s->u[k][j];
            s->qp.upper[row] = CONTROL_UPPER(s, k, j) - s->u[k][j];
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        real_t value = d->v[m];
        for (i = 0; i < NX; i++) {
            value += d->Ax[m][i] * dx0[i];
        }
        s->qp.lower[NV + m] = ROW_LOWER(s, m) - value;
        s->qp.upper[NV + m] = ROW_UPPER(s, m) - value;
    }
#endif
}

static void condense_rows(solver_t *s)
{
    condense_gradient(s);
#if NG
    for (int m = 0; m < NG; m++) {
        condense_row(s, m);
    }
#endif
}

#if REGULARIZE_REDUCED
#include "hessians/regularize_reduced.c"
#else
#include "hessians/regularize_nothing.c"
#endif

static status_t condense_prepare(solver_t *s)
{
    condense_hessian(s);
    condense_rows(s);
    memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return condense_factorize(s);
}

/* du and multipliers from the QP;  dx_{k+1} = A_k dx_k + B_k du_k + b_k. */
static void condense_expand(solver_t *s)
{
    step_t *d = &s->step;
    int k, j;
    for (j = 0; j < NF; j++) {
        d->dx[0][free_state[j]] = s->qp.z[N * NU + j];
    }
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            d->du[k][j] = s->qp.z[k * NU + j];
            d->mult_u[k][j] = s->qp.mult[k * NU + j];
        }
        state_step(&s->node[k], d->dx[k], d->du[k], d->dx[k + 1]);
    }
#if NG
    for (j = 0; j < NG; j++) {
        d->mult[j] = s->qp.mult[NV + j];
    }
#endif
}

static status_t condense_solve(solver_t *s)
{
    status_t status;
    condense_embed(s);
    status = qp_solve(&s->qp);
    condense_expand(s);
    return status;
}

#if !SHIFT_RESAMPLE
static void qp_shift_working_set(qp_t *q, int n, const int *source);

#include "condensing/shift_condensed.c"
#endif
