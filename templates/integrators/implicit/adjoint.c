/* Adjoints: the stages of all steps are stored, then followed backward. lam belongs to the end of a step, kappa_i to
 * its increment D_i, bar_i to base_i, mu_i to f(X_i, u, p); rho_i is the gradient of a cost of the stage:
 *
 *     kappa_i = increment_b[i] lam + sum_{l>i} increment_a[l][i] bar_l
 *     M' nu_i = kappa_i + rho_x,   mu_i = h a_ii nu_i,   bar_i = nu_i - kappa_i      (explicit: mu_i = h kappa_i,
 *     g_u += f_u' mu_i + rho_u,    lam += sum_i bar_i                                 bar_i = f_x' mu_i + rho_x) */

/* Stages of all steps; x becomes the end. */
static void record_stages(
    real_t *x, const real_t *u, const real_t *p, real_t h, int newton, stage_t (*stage)[STAGES], real_t *left)
{
    real_t D[STAGES][NX];
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < STAGES; i++) {
            stage_t *t = &stage[step][i];
            (void)run_stage(t, (i > 0) ? (t - 1)->X : x, D, i, x, u, p, h, newton, left);
        }
        end_step(x, D);
    }
}

/* kappa_i along n columns. */
static inline void adjoint_of_increment(const real_t *lam, int i, real_t (*bar)[NX * NZ], int n, real_t *kappa)
{
    for (int r = 0; r < NX * n; r++) {
        kappa[r] = increment_b[i] * lam[r];
    }
    for (int l = i + 1; l < STAGES; l++) {
        for (int r = 0; r < NX * n; r++) {
            kappa[r] += increment_a[l * STAGES + i] * bar[l][r];
        }
    }
}

/* mu_i and bar_i along n columns. rho: NZ rows of n numbers. */
static inline void pull_stage(
    const stage_t *t, int i, real_t h, const real_t *kappa, const real_t *rho, int n, real_t *mu, real_t *bar)
{
    real_t rest[NX * NZ];
    if (EXPLICIT_FIRST && i == 0) {
        for (int r = 0; r < NX * n; r++) {
            mu[r] = h * kappa[r];
            bar[r] = rho[r];
        }
        for (int r = 0; r < NX; r++) {
            for (int l = 0; l < NX; l++) {
                for (int c = 0; c < n; c++) {
                    bar[r * n + c] += t->J[l][r] * mu[l * n + c];
                }
            }
        }
    } else {
        const real_t ha = h * stage_a[i];
        for (int r = 0; r < NX * n; r++) {
            rest[r] = kappa[r] + rho[r];
        }
        solve_stage_transposed(t, rest, mu, n);
        for (int r = 0; r < NX * n; r++) {
            bar[r] = mu[r] - kappa[r];
            mu[r] *= ha;
        }
    }
}

/* g_u += f_u' mu + rho_u along n columns. */
static inline void pull_controls(const stage_t *t, const real_t *mu, const real_t *rho, int n, real_t *g_u)
{
    for (int j = 0; j < NU; j++) {
        for (int c = 0; c < n; c++) {
            g_u[j * n + c] += rho[(NX + j) * n + c];
        }
        for (int l = 0; l < NX; l++) {
            for (int c = 0; c < n; c++) {
                g_u[j * n + c] += t->J[l][NX + j] * mu[l * n + c];
            }
        }
    }
}

/* lam += sum_i bar_i along n columns. */
static inline void end_pulled_step(real_t *lam, real_t (*bar)[NX * NZ], int n)
{
    for (int i = 0; i < STAGES; i++) {
        for (int r = 0; r < NX * n; r++) {
            lam[r] += bar[i][r];
        }
    }
}

/* A step backward: lam, mu_i of its stages, g_u. */
static void pull_step(const stage_t *stage, real_t h, real_t (*rho)[NZ], real_t *lam, real_t (*mu)[NX], real_t *g_u)
{
    real_t bar[STAGES][NX * NZ], kappa[NX];
    for (int i = STAGES - 1; i >= 0; i--) {
        adjoint_of_increment(lam, i, bar, 1, kappa);
        pull_stage(&stage[i], i, h, kappa, rho[i], 1, mu[i], bar[i]);
        pull_controls(&stage[i], mu[i], rho[i], 1, g_u);
    }
    end_pulled_step(lam, bar, 1);
}

/* lam_x = A' lam, lam_u = B' lam. */
static void implicit_adjoint(const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton,
    const real_t *lam, real_t *lam_x, real_t *lam_u)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, rho[STAGES][NZ] = {{R(0)}}, mu[STAGES][NX];
    stage_t stage[STEPS][STAGES];
    memcpy(end, x, sizeof end);
    record_stages(end, u, p, h, newton, stage, left);
    memcpy(lam_x, lam, NX * sizeof *lam_x);
    memset(lam_u, 0, NU * sizeof *lam_u);
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho, lam_x, mu, lam_u);
    }
}
