/* Second derivatives of lam' x_next + integral of the cost rate: with the multipliers mu_i of the stages,
 *
 *     Q += sum over steps and stages of Z_i' H_i Z_i,   H_i = d2 (mu_i' f + h weight_i l) / d(x, u)^2,
 *
 * where the first NX rows of Z_i are dX_i / d(x, u), the others the unit rows of the controls. Only the variables in
 * bent_variable[] have second derivatives. */

/* W = H_i Z, NZ columns, rows of bent variables; H holds the lower triangle of H_i, and all of it afterwards. */
static void multiply_curvature(real_t (*H)[NZ], const real_t *Z, real_t *W)
{
    for (int i = 0; i < NZ; i++) {
        for (int j = 0; j < i; j++) {
            H[j][i] = H[i][j];
        }
    }
    for (int a = 0; a < bent_count[0]; a++) {
        const int r = bent_variable[a];
        for (int c = 0; c < NZ; c++) {
            W[r * NZ + c] = R(0);
        }
        for (int b = 0; b < bent_count[0]; b++) {
            const real_t factor = H[r][bent_variable[b]];
            for (int c = 0; c < NZ; c++) {
                W[r * NZ + c] += factor * Z[bent_variable[b] * NZ + c];
            }
        }
    }
}

/* Q += Z' W, lower triangle. */
static void add_curvature_of_stage(const real_t *Z, const real_t *W, real_t *Q)
{
    for (int a = 0; a < bent_count[0]; a++) {
        const int r = bent_variable[a];
        for (int i = 0; i < NZ; i++) {
            for (int j = 0; j <= i; j++) {
                Q[i * NZ + j] += Z[r * NZ + i] * W[r * NZ + j];
            }
        }
    }
}

/* The gradients of the cost of all stages, 0 without a cost rate. */
static void all_rate_gradients(
    stage_t (*stage)[STAGES], const real_t *u, const real_t *p, real_t h, real_t (*rho)[STAGES][NZ])
{
    memset(rho, 0, STEPS * sizeof *rho);
    for (int step = 0; HAS_STAGE_RATE_GRADIENT && step < STEPS; step++) {
        rate_gradients(stage[step], u, p, h, rho[step]);
    }
}

/* g += Z' rho of a stage. */
static void add_gradient_of_stage(const real_t *Z, const real_t *rho, real_t *g)
{
    for (int r = 0; r < NZ; r++) {
        for (int c = 0; c < NZ; c++) {
            g[c] += rho[r] * Z[r * NZ + c];
        }
    }
}

/* Three sweeps: stages forward, their multipliers backward, sensitivities and Q forward. */
static void implicit_symmetric(const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton,
    const real_t *lam, real_t *x_next, real_t *S, real_t *left, real_t *g, real_t *Q)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], adj[NX], pulled[NU] = {R(0)}, rho[STEPS][STAGES][NZ], mu[STEPS][STAGES][NX];
    real_t DV[STAGES][NX * NZ], U[NU * NZ], Z[NZ * NZ], W[NZ * NZ], H[NZ][NZ] = {{R(0)}};
    stage_t stage[STEPS][STAGES];
    memcpy(end, x, sizeof end);
    memset(left, 0, NX * sizeof *left);
    record_stages(end, u, p, h, newton, stage, left);
    all_rate_gradients(stage, u, p, h, rho);
    memcpy(adj, lam, sizeof adj);
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho[step], adj, mu[step], pulled);
    }
    unit_columns(S, U);
    memcpy(Z + NX * NZ, U, sizeof U);
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < STAGES; i++) {
            const stage_t *t = &stage[step][i];
            const real_t weight = h * stage_weight[i];
            stage_columns(t, i, h, S, U, NZ, DV, Z);
            STAGE_CURVATURE(t->X, u, p, mu[step][i], &weight, H);
            multiply_curvature(H, Z, W);
            add_curvature_of_stage(Z, W, Q);
            if (HAS_STAGE_RATE_GRADIENT) {
                add_gradient_of_stage(Z, rho[step][i], g);
            }
        }
        end_step_of_columns(S, DV, NZ);
    }
    memcpy(x_next, end, sizeof end);
}

/* The derivatives of a step backward: adjS of lam, controlS of g_u, NZ columns. */
static void pull_columns(const stage_t *stage, const real_t *u, const real_t *p, real_t h, real_t (*mu)[NX],
    real_t (*Z)[NZ * NZ], real_t *adjS, real_t *controlS)
{
    real_t bar[STAGES][NX * NZ], kappa[NX * NZ], muS[NX * NZ], W[NZ * NZ], H[NZ][NZ] = {{R(0)}};
    memset(W, 0, sizeof W);
    for (int i = STAGES - 1; i >= 0; i--) {
        const real_t weight = h * stage_weight[i];
        STAGE_CURVATURE(stage[i].X, u, p, mu[i], &weight, H);
        multiply_curvature(H, Z[i], W);
        adjoint_of_increment(adjS, i, bar, NZ, kappa);
        pull_stage(&stage[i], i, h, kappa, W, NZ, muS, bar[i]);
        pull_controls(&stage[i], muS, W, NZ, controlS);
    }
    end_pulled_step(adjS, bar, NZ);
}

/* Forward over adjoint: stages and sensitivities forward, the derivatives of the adjoint backward. */
static void implicit_forward_over_adjoint(const real_t *x, const real_t *u, const real_t *p, const real_t *dt,
    int newton, const real_t *lam, real_t *x_next, real_t *S, real_t *left, real_t *g, real_t *Q)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], adj[NX], pulled[NU] = {R(0)}, rho[STEPS][STAGES][NZ], mu[STAGES][NX], D[STAGES][NX];
    real_t DV[STAGES][NX * NZ], U[NU * NZ], Z[STEPS][STAGES][NZ * NZ], adjS[NX * NZ] = {R(0)},
                                                                                 controlS[NU * NZ] = {R(0)};
    stage_t stage[STEPS][STAGES];
    memcpy(end, x, sizeof end);
    memset(left, 0, NX * sizeof *left);
    unit_columns(S, U);
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < STAGES; i++) {
            stage_t *t = &stage[step][i];
            (void)run_stage(t, (i > 0) ? (t - 1)->X : end, D, i, end, u, p, h, newton, left);
            memcpy(Z[step][i] + NX * NZ, U, sizeof U);
            stage_columns(t, i, h, S, U, NZ, DV, Z[step][i]);
        }
        end_step(end, D);
        end_step_of_columns(S, DV, NZ);
    }
    all_rate_gradients(stage, u, p, h, rho);
    memcpy(adj, lam, sizeof adj);
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho[step], adj, mu, pulled);
        pull_columns(stage[step], u, p, h, mu, Z[step], adjS, controlS);
        for (int i = 0; HAS_STAGE_RATE_GRADIENT && i < STAGES; i++) {
            add_gradient_of_stage(Z[step][i], rho[step][i], g);
        }
    }
    for (int i = 0; i < NZ; i++) {
        for (int j = 0; j <= i; j++) {
            Q[i * NZ + j] += (i < NX) ? adjS[i * NZ + j] : controlS[(i - NX) * NZ + j];
        }
    }
    memcpy(x_next, end, sizeof end);
}
