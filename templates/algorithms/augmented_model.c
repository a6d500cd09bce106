/* Contract of this part: the quadratic model of the augmented Lagrangian at the plan, over steps d = (dx_k, du_k) of
 * N + 1 nodes with NZ entries; those of the controls at node N are 0. Its Hessian is block tridiagonal,
 *
 *     diag(Q_k) + sum_k (S_k d_k - dx_{k+1})' rho (S_k d_k - dx_{k+1}) + dx_0' rho dx_0,
 *
 * Q_k = Hessian of the stage + sum of psi_m'' J_m' J_m over the relaxed rows of node k. */

/* sum_i a_i b_i over all variables. */
static real_t inner(real_t (*a)[NZ], real_t (*b)[NZ])
{
    const real_t *p = a[0], *q = b[0];
    real_t sum = R(0);
    for (int i = 0; i < VARIABLES; i++) {
        sum += p[i] * q[i];
    }
    return sum;
}

/* y += factor x */
static void add_multiple(real_t (*y)[NZ], real_t factor, real_t (*x)[NZ])
{
    real_t *p = y[0];
    const real_t *q = x[0];
    for (int i = 0; i < VARIABLES; i++) {
        p[i] += factor * q[i];
    }
}

#if NG
/* Gradient and curvature of the relaxed row m at its node. */
static void add_row(solver_t *s, int m)
{
    auglag_t *a = &s->auglag;
    const int k = row_node[m];
    const real_t mu = ROW_MULTIPLIER(s, m), curvature = a->curvature[m];
#if STATE_ROWS
    if (row_bounds_state[m]) {
        a->g[k][row_index[m]] += mu;
        a->Q[k][row_index[m]][row_index[m]] += curvature;
        return;
    }
#endif
#if GENERAL_ROWS || NE
    const real_t *J = nodal_row(s, m);
    const int n = (k < N) ? NZ : NX;
    for (int i = 0; i < n; i++) {
        a->g[k][i] += mu * J[i];
        for (int j = 0; j < n; j++) {
            a->Q[k][i][j] += curvature * J[i] * J[j];
        }
    }
#endif
}
#endif

/* Q_k and g_k of a path node, without the rows. */
static void assemble_node(solver_t *s, int k)
{
    auglag_t *a = &s->auglag;
    const node_t *node = &s->node[k];
    memcpy(a->g[k], node->g, sizeof a->g[k]);
    for (int j = 0; j < NX; j++) {
        a->g[k][j] -= s->lam[k][j];
        for (int i = 0; i < NZ; i++) {
            a->g[k][i] += node->S[j][i] * s->lam[k + 1][j];
        }
    }
    for (int i = 0; i < NZ; i++) {
        const real_t bend = FABS(HESSIAN(s, k)[i][i]) * variable_scale[i] * variable_scale[i];
        a->bend = (bend > a->bend) ? bend : a->bend;
        for (int j = 0; j <= i; j++) {
            a->Q[k][i][j] = a->Q[k][j][i] = HESSIAN(s, k)[i][j];
        }
    }
}

/* Gradient and Hessian from the linearisation and the estimates of the multipliers. */
static void assemble(solver_t *s)
{
    auglag_t *a = &s->auglag;
    a->bend = R(0);
    for (int k = 0; k < N; k++) {
        assemble_node(s, k);
    }
    for (int i = 0; i < NX; i++) {
        a->g[N][i] = s->terminal.g[i] - s->lam[N][i];
        for (int j = 0; j <= i; j++) {
            a->Q[N][i][j] = a->Q[N][j][i] = s->hessian.Q_N[i][j];
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m]) {
            add_row(s, m);
        }
    }
#endif
}

/* rho_i at node 0: free components of x_0 have no gap. */
static inline real_t start_weight(const solver_t *s, int i)
{
    return s->auglag.penalty * initial_weight[i];
}

/* y = H v */
static void multiply(const solver_t *s, real_t (*v)[NZ], real_t (*y)[NZ])
{
    const auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            real_t sum = R(0);
            for (int j = 0; j < NZ; j++) {
                sum += a->Q[k][i][j] * v[k][j];
            }
            y[k][i] = sum;
        }
    }
    for (int i = 0; i < NX; i++) {
        y[0][i] += start_weight(s, i) * v[0][i];
    }
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NX; i++) {
            const real_t *row = s->node[k].S[i];
            real_t gap = -v[k + 1][i];
            for (int j = 0; j < NZ; j++) {
                gap += row[j] * v[k][j];
            }
            gap *= gap_weight(s, i);
            y[k + 1][i] -= gap;
            for (int j = 0; j < NZ; j++) {
                y[k][j] += row[j] * gap;
            }
        }
    }
}

/* The box of the steps: bounds of controls and hard bounds of states, and the trust region |d_i| <= radius scale_i. */
static void set_box(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t reach = (k < N || i < NX) ? a->radius * variable_scale[i] : R(0);
            a->lower[k][i] = -reach;
            a->upper[k][i] = reach;
        }
        for (int j = 0; k < N && j < NU; j++) {
            const real_t reach = a->upper[k][NX + j], u = s->u[k][j];
            a->lower[k][NX + j] = clip(CONTROL_LOWER(s, k, j) - u, -reach, R(0));
            a->upper[k][NX + j] = clip(CONTROL_UPPER(s, k, j) - u, R(0), reach);
        }
    }
#if STATE_ROWS
    for (int m = 0; m < NG; m++) {
        if (!row_relaxed[m]) {
            const int k = row_node[m], i = row_index[m];
            const real_t reach = a->radius * variable_scale[i], x = s->x[k][i];
            a->lower[k][i] = clip(ROW_LOWER(s, m) - x, -reach, R(0));
            a->upper[k][i] = clip(ROW_UPPER(s, m) - x, R(0), reach);
        }
    }
#endif
}

/* Moves the plan into its bounds. */
static void project_plan(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = safe_value(s, k, j);
        }
    }
#if STATE_ROWS
    for (int m = 0; m < NG; m++) {
        if (!row_relaxed[m]) {
            real_t *x = &s->x[row_node[m]][row_index[m]];
            *x = clip(*x, ROW_LOWER(s, m), ROW_UPPER(s, m));
        }
    }
#endif
}
