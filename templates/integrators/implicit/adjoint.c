/* Adjoints: the stages of all steps are stored, then followed backward. lam belongs to the end of a step, kappa_i to
 * its increment D_i, bar_i to base_i, mu_i to f(X_i, u, p) and g; rho_i is the gradient of a cost of the
 * stage, and sums over stages of its own group run over i and j:
 *
 *     kappa_i = increment_b[i] lam + sum_{l after the group} increment_a[l][i] bar_l
 *     M' nu = (kappa_i + rho_x, rho_z),   mu_j = h sum_i a_ij nu_i, that of g is nu_j,
 *     bar_i = nu_i - kappa_i      (explicit: mu_i = h kappa_i, bar_i = f_x' mu_i + rho_x)
 *     g_u += f_u' mu_i + rho_u,   lam += sum_i bar_i */

/* Computes the stages of all steps; x becomes the end. */
static void record_stages(real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t h, int newton,
    stage_t (*stage)[GROUPS], real_t *left)
{
    real_t D[STAGES][NX], point[NXA];
    start_point(point, x, z);
    for (int step = 0; step < STEPS; step++) {
        for (int b = 0; b < GROUPS; b++) {
            (void)run_stage(&stage[step][b], point, D, b, x, u, p, h, newton, left);
        }
        end_step(x, D, point);
    }
}

/* Computes kappa_i of the stages of group b along n columns. */
static inline void adjoint_of_increment(const real_t *lam, int b, real_t (*bar)[NX * NZ], int n, real_t *kappa)
{
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX * n; r++) {
            kappa[i * NX * n + r] = increment_b[b * GROUP + i] * lam[r];
        }
        for (int l = (b + 1) * GROUP; l < STAGES; l++) {
            for (int r = 0; r < NX * n; r++) {
                kappa[i * NX * n + r] += increment_a[l * STAGES + b * GROUP + i] * bar[l][r];
            }
        }
    }
}

/* Computes mu and bar of an explicit stage along n columns. rho: NXAU rows of n numbers. */
static inline void pull_explicit_stage(
    const stage_t *t, real_t h, const real_t *kappa, const real_t *rho, int n, real_t *mu, real_t *bar)
{
    for (int r = 0; r < NX * n; r++) {
        mu[r] = h * kappa[r];
        bar[r] = rho[r];
    }
    for (int r = 0; r < NX; r++) {
        for (int l = 0; l < NX; l++) {
            for (int c = 0; c < n; c++) {
                bar[r * n + c] += t->J[0][l][r] * mu[l * n + c];
            }
        }
    }
}

/* Computes mu_j of all stages of a group from nu, along n columns. */
static inline void weigh_multipliers(const real_t *ha, const real_t *nu, int n, real_t *mu)
{
    for (int j = 0; j < GROUP; j++) {
        for (int r = 0; r < NX * n; r++) {
            mu[j * NXA * n + r] = ha[j] * nu[r];
        }
        for (int i = 1; i < GROUP; i++) {
            for (int r = 0; r < NX * n; r++) {
                mu[j * NXA * n + r] += ha[i * GROUP + j] * nu[i * NXA * n + r];
            }
        }
        for (int r = NX * n; r < NXA * n; r++) {
            mu[j * NXA * n + r] = nu[j * NXA * n + r];
        }
    }
}

/* Computes mu and bar of the stages of group b along n columns: NXAU rows of rho and NXA rows of mu for each of its
 * stages. */
static inline void pull_stage(const stage_t *t, int b, real_t h, const real_t *kappa, const real_t *rho, int n,
    real_t *mu, real_t (*bar)[NX * NZ])
{
    if (EXPLICIT_FIRST && b == 0) {
        pull_explicit_stage(t, h, kappa, rho, n, mu, bar[0]);
        return;
    }
    real_t rest[NB * NZ], nu[NB * NZ], ha[GROUP * GROUP];
    stage_lengths(h, b, ha);
    for (int i = 0; i < GROUP; i++) {
        const real_t *own = &rho[i * NXAU * n];
        for (int r = 0; r < NX * n; r++) {
            rest[i * NXA * n + r] = kappa[i * NX * n + r] + own[r];
        }
        for (int r = NX * n; r < NXA * n; r++) {
            rest[i * NXA * n + r] = own[r];
        }
    }
    solve_stage_transposed(t, rest, nu, n);
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX * n; r++) {
            bar[b * GROUP + i][r] = nu[i * NXA * n + r] - kappa[i * NX * n + r];
        }
    }
    weigh_multipliers(ha, nu, n, mu);
}

/* g_u += f_u' mu + rho_u along n columns. */
static inline void pull_controls(const stage_t *t, const real_t *mu, const real_t *rho, int n, real_t *g_u)
{
    for (int i = 0; i < GROUP; i++) {
        for (int j = 0; j < NU; j++) {
            for (int c = 0; c < n; c++) {
                g_u[j * n + c] += rho[(i * NXAU + NXA + j) * n + c];
            }
            for (int l = 0; l < NXA; l++) {
                for (int c = 0; c < n; c++) {
                    g_u[j * n + c] += t->J[i][l][NXA + j] * mu[(i * NXA + l) * n + c];
                }
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

/* Follows a step backward: lam, mu_i of its stages, g_u. */
static void pull_step(const stage_t *stage, real_t h, real_t (*rho)[NXAU], real_t *lam, real_t (*mu)[NXA], real_t *g_u)
{
    real_t bar[STAGES][NX * NZ], kappa[GROUP * NX];
    for (int b = GROUPS - 1; b >= 0; b--) {
        const int i = b * GROUP;
        adjoint_of_increment(lam, b, bar, 1, kappa);
        pull_stage(&stage[b], b, h, kappa, rho[i], 1, mu[i], bar);
        pull_controls(&stage[b], mu[i], rho[i], 1, g_u);
    }
    end_pulled_step(lam, bar, 1);
}

/* lam_x = A' lam, lam_u = B' lam. */
static void implicit_adjoint(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, const real_t *lam, real_t *lam_x, real_t *lam_u)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], left[NX] = {R(0)}, rho[STAGES][NXAU] = {{R(0)}}, mu[STAGES][NXA];
    stage_t stage[STEPS][GROUPS];
    (void)memcpy(end, x, sizeof end);
    record_stages(end, z, u, p, h, newton, stage, left);
    (void)memcpy(lam_x, lam, NX * sizeof *lam_x);
    (void)memset(lam_u, 0, NU * sizeof *lam_u);
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho, lam_x, mu, lam_u);
    }
}
