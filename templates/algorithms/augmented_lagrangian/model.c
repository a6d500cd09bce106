/* This part is the quadratic model of the augmented Lagrangian at the plan, over steps d = (dx_k, du_k) of N + 1 nodes
 * with LDZ entries; those of the controls at node N and those after NZ are 0. Its Hessian is
 *
 *     sum_k d_k'Q_k d_k + (S_k d_k - dx_{k+1})' rho (S_k d_k - dx_{k+1}) + dx_0' rho dx_0,
 *     Q_k = Hessian of the stage + sum of psi_m'' J_m' J_m over the relaxed rows of node k,
 *
 * a block tridiagonal matrix with H_k = Q_k + S_k' rho S_k + rho on the diagonal and B_k = -rho S_k between x_{k+1} and
 * node k. LDZ is NZ rounded up to a multiple of 4, as products are computed in blocks of four rows and columns. */

#if SCALAR
#include "riccati/blocks_scalar.c"

#include "riccati/dot_scalar.c"
#else
#include "riccati/blocks.c"

#include "riccati/dot.c"
#endif

/* y += sum_{l<n} c[l] A[l], rows of LDZ entries, four at a time. */
static void add_panels(real_t *y, const real_t *c, const real_t *A, int n)
{
    const int panel = 4 * LDZ;
    int l;
    for (l = 0; l + 4 <= n; l += 4) {
        const real_t c0 = c[l], c1 = c[l + 1], c2 = c[l + 2], c3 = c[l + 3];
        for (int j = 0; j < LDZ; j += 4) {
            real_t t[4];
            for (int i = 0; i < 4; i++) {
                t[i] = y[j + i] +
                    ((c0 * A[j + i] + c1 * A[LDZ + j + i]) + (c2 * A[2 * LDZ + j + i] + c3 * A[3 * LDZ + j + i]));
            }
            for (int i = 0; i < 4; i++) {
                y[j + i] = t[i];
            }
        }
        A += panel;
    }
    for (; l < n; l++) { /* at most 3 passes */
        riccati_add(y, c[l], A, LDZ);
        A += LDZ;
    }
}

/* sum_i a_i b_i over all variables. */
static real_t inner(real_t (*a)[LDZ], real_t (*b)[LDZ])
{
    return riccati_dot(a[0], b[0], VARIABLES);
}

/* y += factor x */
static void add_multiple(real_t (*y)[LDZ], real_t factor, real_t (*x)[LDZ])
{
    riccati_add(y[0], factor, x[0], VARIABLES);
}

/* Returns rho_i at node 0; unmeasured states have no gap, and 0. */
static inline real_t start_weight(const solver_t *s, int i)
{
    return s->auglag.penalty * initial_weight[i];
}

/* g_k += slope J_m, (H d)_k += force J_m, H_k += curvature J_m' J_m. */
static void change_row(solver_t *s, int m, real_t slope, real_t force, real_t curvature)
{
    auglag_t *a = &s->auglag;
    const int k = row_node(m);
    if (row_is_state(m)) {
        const int i = row_index(m);
        a->g[k][i] += slope;
        a->Hd[k][i] += force;
        a->H[k][i][i] += curvature;
        return;
    }
    const real_t *J = row_gradient(s, m);
    const int n = nz_at(k);
    for (int i = 0; i < n; i++) {
        a->g[k][i] += slope * J[i];
        a->Hd[k][i] += force * J[i];
        for (int j = 0; j < n; j++) {
            a->H[k][i][j] += curvature * J[i] * J[j];
        }
    }
}

/* Computes B_k, g_k and the lower triangle of S_k' rho S_k of a path node; W_k serves as a copy of -S_k. The padding is
 * written again, so that numbers that are not finite do not remain in it. */
static void assemble_dynamics(solver_t *s, int k)
{
    auglag_t *a = &s->auglag;
    const node_t *node = &s->node[k];
    real_t force[NX];
    (void)memset(a->g[k], 0, sizeof a->g[k]);
    (void)memset(a->B[k], 0, sizeof a->B[k]);
    (void)memset(a->W[k], 0, sizeof a->W[k]);
    (void)memset(a->H[k], 0, sizeof a->H[k]);
    for (int l = 0; l < NX; l++) {
        const real_t weight = gap_weight(s, l);
        for (int j = 0; j < NZ; j++) {
            a->W[k][l][j] = -node->S[l][j];
            a->B[k][l][j] = -weight * node->S[l][j];
        }
        force[l] = -s->lam[k + 1][l];
    }
    for (int j = 0; j < NZ; j++) {
        a->g[k][j] = node->g[j] - ((j < NX) ? s->lam[k][j] : R(0));
    }
    add_panels(a->g[k], force, a->W[k][0], NX);
    for (int i = 0; i < LDZ; i += 4) {
        riccati_rows(a->H[k][i], LDZ, a->B[k][0] + i, LDZ, a->W[k][0], LDZ, NX, i + 4);
    }
}

/* Computes gradient and Hessian from the linearisation and the estimates of the multipliers. */
static void assemble(solver_t *s)
{
    auglag_t *a = &s->auglag;
    a->bend = R(0);
    for (int k = 0; k < N; k++) {
        assemble_dynamics(s, k);
        for (int i = 0; i < NZ; i++) {
            const real_t bend = FABS(HESSIAN(s, k)[i][i]) * variable_scale[i] * variable_scale[i];
            a->bend = (bend > a->bend) ? bend : a->bend;
            for (int j = 0; j <= i; j++) {
                a->H[k][i][j] += HESSIAN(s, k)[i][j];
                a->H[k][j][i] = a->H[k][i][j];
            }
        }
    }
    (void)memset(a->g[N], 0, sizeof a->g[N]);
    (void)memset(a->H[N], 0, sizeof a->H[N]);
    for (int i = 0; i < NX; i++) {
        a->g[N][i] = s->terminal.g[i] - s->lam[N][i];
        for (int j = 0; j <= i; j++) {
            a->H[N][j][i] = s->hessian.Q_N[i][j];
            a->H[N][i][j] = a->H[N][j][i];
        }
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            a->H[k][i][i] += (k > 0) ? gap_weight(s, i) : start_weight(s, i);
        }
    }
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m]) {
            change_row(s, m, s->mult[m], R(0), a->curvature[m]);
            a->slope[m] = s->mult[m];
        }
    }
    a->offset = R(0);
}

/* y = H v. The products with B_k are stored one node ahead of their sum. */
static void multiply(const solver_t *s, real_t (*v)[LDZ], real_t (*y)[LDZ])
{
    const auglag_t *a = &s->auglag;
    (void)memset(y, 0, sizeof a->d);
    for (int k = 0; k < N; k++) {
        for (int l = 0; l < NX; l++) {
            y[k + 1][l] = riccati_dot(a->B[k][l], v[k], LDZ);
        }
        add_panels(y[k], v[k], a->H[k][0], LDZ);
        add_panels(y[k], v[k + 1], a->B[k][0], NX);
    }
    add_panels(y[N], v[N], a->H[N][0], NX);
}

/* Sets the box of the steps: bounds of controls, hard bounds of states, and the trust region |d_i| <= radius
 * scale_i. */
static void set_box(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < LDZ; i++) {
            const real_t reach = (k < N || i < NX) ? a->radius * variable_scale[i] : R(0);
            a->lower[k][i] = -reach;
            a->upper[k][i] = reach;
        }
        for (int j = 0; k < N && j < NU; j++) {
            const real_t reach = a->upper[k][NX + j], u = s->u[k][j];
            a->lower[k][NX + j] = clip(control_lower(s, k, j) - u, -reach, R(0));
            a->upper[k][NX + j] = clip(control_upper(s, k, j) - u, R(0), reach);
        }
    }
    for (int m = 0; m < NG; m++) {
        if (!row_relaxed[m]) {
            const int k = row_node(m), i = row_index(m);
            const real_t reach = a->radius * variable_scale[i], x = s->x[k][i];
            a->lower[k][i] = clip(row_lower(s, m) - x, -reach, R(0));
            a->upper[k][i] = clip(row_upper(s, m) - x, R(0), reach);
        }
    }
}

/* Returns 1 if the gradient is finite. */
static int gradient_is_finite(const auglag_t *a)
{
    return all_finite(a->g[0], (N + 1) * LDZ);
}

/* Moves the plan into its bounds. Returns 1 if it was outside. */
static int project_plan(solver_t *s)
{
    int left = 0;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = safe_value(s, k, j);
            left |= (s->u[k][j] != u); /* exact comparison: a point inside is unchanged */
            s->u[k][j] = u;
        }
    }
    for (int m = 0; m < NG; m++) {
        if (!row_relaxed[m]) {
            real_t *x = &s->x[row_node(m)][row_index(m)];
            const real_t inside = clip(*x, row_lower(s, m), row_upper(s, m));
            left |= (*x != inside); /* exact comparison, as above */
            *x = inside;
        }
    }
    return left;
}
