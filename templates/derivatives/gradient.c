/* Gradient of J with respect to all controls, g[k][j] = dJ / du_k[j]. */

/* Writes the control of node k with u_j increased by step max(1, |u_j|); returns the increase as it is after
 * rounding. */
static real_t perturb_control(const data_t *d, int k, int j, real_t step, real_t *u)
{
    for (int i = 0; i < NU; i++) {
        u[i] = d->u[k][i];
    }
    u[j] += step * ((FABS(u[j]) > R(1)) ? FABS(u[j]) : R(1));
    return u[j] - d->u[k][j];
}

/* Algorithm 6.1: simulates J with one control changed, from its node on; N NU + 1 simulations. */
status_t API(gradient_finite_differences)(const data_t *d, real_t step, trajectory_t *t, real_t g[N][NU])
{
    real_t u[NU], x[NX];
    if (!(step >= TOL_UNIT) || !isfinite(step)) {
        return BAD_ARGUMENT;
    }
    if (API(simulate)(d, t) != OK) {
        return NOT_FINITE;
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t h = perturb_control(d, k, j, step, u);
            real_t J = t->partial[k];
            add_cost(d, k, t->x[k], u, &J);
            INTEGRATOR_VALUE(d, k, t->x[k], u, x);
            for (int n = k + 1; n < N; n++) {
                add_cost(d, n, x, d->u[n], &J);
                INTEGRATOR_VALUE(d, n, x, d->u[n], x);
            }
            g[k][j] = (with_terminal_cost(d, x, J) - t->J) / h;
        }
    }
    return finite_or(&g[0][0], N * NU);
}

/* g_j += q' column j of S */
static void add_columns(const real_t *q, const real_t *S, real_t *g)
{
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NU; j++) {
            g[j] += q[i] * S[i * NU + j];
        }
    }
}

/* g = r_k */
static void start_gradient(const nodes_t *nodes, int k, real_t *g)
{
    for (int j = 0; j < NU; j++) {
        g[j] = nodes->g[k][NX + j];
    }
}

/* lam = q_k + lam */
static void add_state_gradient(const nodes_t *nodes, int k, real_t *lam)
{
    for (int i = 0; i < NX; i++) {
        lam[i] += nodes->g[k][i];
    }
}

/* Algorithm 6.2: r_k + sum_{n>k} q_n' A_{n-1} ... A_{k+1} B_k; m holds the result of sensitivities. */
status_t API(gradient_forward)(const data_t *d, linearization_t *m, real_t g[N][NU])
{
    real_t phi[NX][NU];
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    cost_gradients(d, &m->nodes);
    for (int k = 0; k < N; k++) {
        start_gradient(&m->nodes, k, g[k]);
        start_columns(m, k, phi);
        for (int n = k + 1; n < N; n++) {
            add_columns(m->nodes.g[n], &phi[0][0], g[k]);
            advance_columns(m, n, phi);
        }
        add_columns(m->nodes.g_N, &phi[0][0], g[k]);
    }
    return finite_or(&g[0][0], N * NU);
}

/* Algorithm 6.3: lam_N = q_N; g_k = r_k + B_k' lam_{k+1}, lam_k = q_k + A_k' lam_{k+1}; m holds the result of
 * sensitivities. */
status_t API(gradient_adjoint_matrices)(const data_t *d, linearization_t *m, real_t g[N][NU])
{
    real_t lam[NX], lam_u[NU];
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    cost_gradients(d, &m->nodes);
    copy_state(lam, m->nodes.g_N);
    for (int k = N - 1; k >= 0; k--) {
        adjoint_product(m, k, lam, lam, lam_u);
        add_state_gradient(&m->nodes, k, lam);
        for (int j = 0; j < NU; j++) {
            g[k][j] = m->nodes.g[k][NX + j] + lam_u[j];
        }
    }
    return finite_or(&g[0][0], N * NU);
}

/* Algorithm 6.3 with products A_k' lam and B_k' lam instead of the matrices: the exact adjoint of the integrator. */
status_t API(gradient_adjoint)(const data_t *d, nodes_t *nodes, real_t g[N][NU])
{
    real_t lam[NX], lam_x[NX], lam_u[NU];
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    roll_out(d, N, nodes->x);
    cost_gradients(d, nodes);
    copy_state(lam, nodes->g_N);
    for (int k = N - 1; k >= 0; k--) {
        INTEGRATOR_ADJOINT(d, k, nodes->x[k], d->u[k], lam, lam_x, lam_u);
        copy_state(lam, lam_x);
        add_state_gradient(nodes, k, lam);
        for (int j = 0; j < NU; j++) {
            g[k][j] = nodes->g[k][NX + j] + lam_u[j];
        }
    }
    return finite_or(&g[0][0], N * NU);
}
