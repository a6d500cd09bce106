/* These sweeps run over the horizon. Only the states are stored; of the derivatives [A_k B_k] of an interval only
 * products with vectors are computed. Controls are divided by control_scale. */

/* Simulates the plan from x_0 with its controls. Returns 0 if a state is not finite. */
static int simulate_plan(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
    s->stats.simulations++;
    return all_finite(s->x[0], (N + 1) * NX);
}

/* own = gradient of the cost and the rows of node k, g = [A_k B_k]' lam, and lam becomes the state part of own + g. */
static void carry_back(const solver_t *s, int k, int what, real_t *lam, real_t *g, real_t *own)
{
    for (int i = 0; i < NZ; i++) {
        own[i] = R(0);
    }
    PATH_GRADIENT(s, k, own);
    add_rows(s, k, what, own, own);
    INTEGRATOR_ADJOINT(s, k, lam, g);
    for (int i = 0; i < NX; i++) {
        lam[i] = g[i] + own[i];
    }
}

/* lam_N = gradient of the terminal cost and rows. */
static void start_adjoint(const solver_t *s, int what, real_t *lam)
{
    for (int i = 0; i < NX; i++) {
        lam[i] = R(0);
    }
    TERMINAL_GRADIENT(s, lam);
    add_rows(s, N, what, lam, lam);
}

/* r_k = scale (B_k' lam_{k+1} + gradient in u_k), lam_k = A_k' lam_{k+1} + gradient in x_k. */
static void differentiate(solver_t *s)
{
    real_t lam[NX], g[NZ], own[NZ];
    start_adjoint(s, ESTIMATE, lam);
    for (int k = N - 1; k >= 0; k--) {
        carry_back(s, k, ESTIMATE, lam, g, own);
        for (int j = 0; j < NU; j++) {
            s->shooting.r[k][j] = control_scale[j] * (g[NX + j] + own[NX + j]);
        }
    }
}

/* Returns sum_kj a_kj b_kj. */
static real_t inner(const real_t *a, const real_t *b)
{
    real_t sum = R(0);
    for (int i = 0; i < N * NU; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}
