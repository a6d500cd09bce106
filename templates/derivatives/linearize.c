/* The linear time-varying model along the trajectory: dx_{k+1} = A_k dx_k + B_k du_k, dl_k = (q_k, r_k)'(dx_k, du_k),
 * dl_N = q_N' dx_N; g_k = (q_k, r_k), S_k = [A_k B_k]. */

/* Computes the gradients of the costs of all nodes. */
static void cost_gradients(const data_t *d, nodes_t *n)
{
    for (int k = 0; k < N; k++) {
        PATH_GRADIENT(d, k, n->x[k], d->u[k], n->g[k]);
    }
    TERMINAL_GRADIENT(d, n->x[N], n->g_N);
}

/* Algorithm 6.7: S_k = [A_k B_k] of every interval; elements that are structurally zero are not written again. */
status_t API(sensitivities)(const data_t *d, linearization_t *m)
{
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    clear(&m->S[0][0][0], N * NX * (NX + NU));
    copy_state(m->nodes.x[0], d->x0);
    for (int k = 0; k < N; k++) {
        real_t left[NX];
        INTEGRATOR_INTERVAL(d, k, m->nodes.x[k], d->u[k], m->nodes.x[k + 1], m->S[k], left);
    }
    return finite_or(&m->S[0][0][0], N * NX * (NX + NU));
}

/* phi = B_k */
static void start_columns(const linearization_t *m, int k, real_t (*phi)[NU])
{
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NU; j++) {
            phi[i][j] = m->S[k][i][NX + j];
        }
    }
}

/* phi = A_k phi */
static void advance_columns(const linearization_t *m, int k, real_t (*phi)[NU])
{
    real_t old[NX][NU];
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NU; j++) {
            old[i][j] = phi[i][j];
        }
    }
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NU; j++) {
            phi[i][j] = R(0);
        }
        for (int l = 0; l < NX; l++) {
            for (int j = 0; j < NU; j++) {
                phi[i][j] += m->S[k][i][l] * old[l][j];
            }
        }
    }
}

/* lam_u = B_k' lam, lam_x = A_k' lam */
static void adjoint_product(const linearization_t *m, int k, const real_t *lam, real_t *lam_x, real_t *lam_u)
{
    real_t sum[NX + NU];
    for (int j = 0; j < NX + NU; j++) {
        sum[j] = R(0);
    }
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX + NU; j++) {
            sum[j] += m->S[k][i][j] * lam[i];
        }
    }
    copy_state(lam_x, sum);
    for (int j = 0; j < NU; j++) {
        lam_u[j] = sum[NX + j];
    }
}
