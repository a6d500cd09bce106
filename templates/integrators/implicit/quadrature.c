/* The integral of a cost rate l by the scheme: h sum over steps and stages of weight_i l(X_i, u, p). */

/* l += integral over dt. */
static void implicit_integral(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *l)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, D[STAGES][NX], point[NXA], rate;
    stage_t stage;
    (void)memcpy(end, x, sizeof end);
    start_point(point, x, z);
    for (int step = 0; step < STEPS; step++) {
        for (int b = 0; b < GROUPS; b++) {
            (void)run_stage(&stage, point, D, b, end, u, p, h, newton, left);
            for (int i = 0; i < GROUP; i++) {
                STAGE_RATE(&stage.X[i * NXA], u, p, &rate);
                *l += h * stage_weight[b * GROUP + i] * rate;
            }
        }
        end_step(end, D, point);
    }
}

/* rho_i = h weight_i dl / d(x, z, u) of the stages of a step. */
static void rate_gradients(const stage_t *stage, const real_t *u, const real_t *p, real_t h, real_t (*rho)[NXAU])
{
    for (int i = 0; i < STAGES; i++) {
        const real_t weight = h * stage_weight[i];
        (void)memset(rho[i], 0, sizeof rho[i]);
        STAGE_RATE_GRADIENT(&stage[i / GROUP].X[i % GROUP * NXA], u, p, rho[i]);
        for (int r = 0; r < NXAU; r++) {
            rho[i][r] *= weight;
        }
    }
}

/* g += gradient of the integral over dt. */
static void implicit_integral_gradient(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *g)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, lam[NX] = {R(0)}, rho[STAGES][NXAU], mu[STAGES][NXA];
    stage_t stage[STEPS][GROUPS];
    (void)memcpy(end, x, sizeof end);
    record_stages(end, z, u, p, h, newton, stage, left);
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
static void implicit_integral_product(const real_t *x, const real_t *z, const real_t *u, const real_t *p,
    const real_t *dt, int newton, const real_t *d, real_t *w)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, D[STAGES][NX], V[NX], DV[STAGES][NX * NZ], Z[NB], lam[NX] = {R(0)};
    real_t rho[STEPS][STAGES][NXAU] = {{{R(0)}}}, mu[STAGES][NXA], point[NXA];
    stage_t stage[STEPS][GROUPS];
    (void)memcpy(end, x, sizeof end);
    (void)memcpy(V, d, sizeof V);
    start_point(point, x, z);
    for (int step = 0; step < STEPS; step++) {
        for (int b = 0; b < GROUPS; b++) {
            stage_t *t = &stage[step][b];
            (void)run_stage(t, point, D, b, end, u, p, h, newton, left);
            stage_columns(t, b, h, V, d + NX, 1, DV, Z);
            for (int i = 0; i < GROUP; i++) {
                real_t *own = rho[step][b * GROUP + i];
                const real_t weight = h * stage_weight[b * GROUP + i];
                STAGE_RATE_PRODUCT(&t->X[i * NXA], u, p, &Z[i * NXA], d + NX, own);
                for (int r = 0; r < NXAU; r++) {
                    own[r] *= weight;
                }
            }
        }
        end_step(end, D, point);
        end_step_of_columns(V, DV, 1);
    }
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho[step], lam, mu, w + NX);
    }
    for (int r = 0; r < NX; r++) {
        w[r] += lam[r];
    }
}
