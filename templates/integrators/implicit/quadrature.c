/* The integral of a cost rate l by the quadrature of the scheme: h sum over steps and stages of weight_i l(X_i, u, p). */

/* l += integral over dt. */
static void implicit_integral(
    const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *l)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, D[STAGES][NX], rate;
    stage_t stage;
    memcpy(end, x, sizeof end);
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < STAGES; i++) {
            (void)run_stage(&stage, (i > 0) ? stage.X : end, D, i, end, u, p, h, newton, left);
            STAGE_RATE(stage.X, u, p, &rate);
            *l += h * stage_weight[i] * rate;
        }
        end_step(end, D);
    }
}

/* rho_i = h weight_i dl / d(x, u) of the stages of a step. */
static void rate_gradients(const stage_t *stage, const real_t *u, const real_t *p, real_t h, real_t (*rho)[NZ])
{
    for (int i = 0; i < STAGES; i++) {
        const real_t weight = h * stage_weight[i];
        memset(rho[i], 0, sizeof rho[i]);
        STAGE_RATE_GRADIENT(stage[i].X, u, p, rho[i]);
        for (int r = 0; r < NZ; r++) {
            rho[i][r] *= weight;
        }
    }
}

/* g += gradient of the integral over dt. */
static void implicit_integral_gradient(
    const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *g)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, lam[NX] = {R(0)}, rho[STAGES][NZ], mu[STAGES][NX];
    stage_t stage[STEPS][STAGES];
    memcpy(end, x, sizeof end);
    record_stages(end, u, p, h, newton, stage, left);
    for (int step = STEPS - 1; step >= 0; step--) {
        rate_gradients(stage[step], u, p, h, rho);
        pull_step(stage[step], h, rho, lam, mu, g + NX);
    }
    for (int r = 0; r < NX; r++) {
        g[r] += lam[r];
    }
}

/* w += Gauss-Newton Hessian of the integral over dt times d = (dx, du): second derivatives of the rate along the
 * linearised stages. */
static void implicit_integral_product(
    const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton, const real_t *d, real_t *w)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, D[STAGES][NX], V[NX], DV[STAGES][NX * NZ], Z[NX * NZ], lam[NX] = {R(0)};
    real_t rho[STEPS][STAGES][NZ] = {{{R(0)}}}, mu[STAGES][NX];
    stage_t stage[STEPS][STAGES];
    memcpy(end, x, sizeof end);
    memcpy(V, d, sizeof V);
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < STAGES; i++) {
            const real_t weight = h * stage_weight[i];
            stage_t *t = &stage[step][i];
            (void)run_stage(t, (i > 0) ? (t - 1)->X : end, D, i, end, u, p, h, newton, left);
            stage_columns(t, i, h, V, d + NX, 1, DV, Z);
            STAGE_RATE_PRODUCT(t->X, u, p, Z, d + NX, rho[step][i]);
            for (int r = 0; r < NZ; r++) {
                rho[step][i][r] *= weight;
            }
        }
        end_step(end, D);
        end_step_of_columns(V, DV, 1);
    }
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho[step], lam, mu, w + NX);
    }
    for (int r = 0; r < NX; r++) {
        w[r] += lam[r];
    }
}
