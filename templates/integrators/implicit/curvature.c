/* Second derivatives of lam' x_next + integral of the cost rate: with the multipliers mu_i of the stages,
 *
 *     Q += sum over steps and stages of Z_i' H_i Z_i,   H_i = d2 (mu_i' f + h weight_i l) / d(x, z, u)^2,
 *
 * where the first NXA rows of Z_i are the derivatives of the stage with respect to (x, u), the others U, the unit rows
 * of the controls. Only the variables in bent_variable[] have second derivatives. */

/* Returns the row of Z_i that belongs to a variable. */
static inline const real_t *row_of_stage(const real_t *Z, const real_t *U, int variable)
{
    return (variable < NXA) ? &Z[variable * NZ] : &U[(variable - NXA) * NZ];
}

/* W = H_i Z_i, with NZ columns; only the rows of variables with second derivatives are written. H holds the lower
 * triangle of H_i on entry, and the full matrix on return. */
static void multiply_curvature(real_t (*H)[NXAU], const real_t *Z, const real_t *U, real_t *W)
{
    for (int i = 0; i < NXAU; i++) {
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
            const real_t *row = row_of_stage(Z, U, bent_variable[b]);
            for (int c = 0; c < NZ; c++) {
                W[r * NZ + c] += factor * row[c];
            }
        }
    }
}

/* Q += Z_i' W, lower triangle. */
static void add_curvature_of_stage(const real_t *Z, const real_t *U, const real_t *W, real_t *Q)
{
    for (int a = 0; a < bent_count[0]; a++) {
        const int r = bent_variable[a];
        const real_t *row = row_of_stage(Z, U, r);
        for (int i = 0; i < NZ; i++) {
            for (int j = 0; j <= i; j++) {
                Q[i * NZ + j] += row[i] * W[r * NZ + j];
            }
        }
    }
}

/* Computes the gradients of the cost of all stages, 0 without a cost rate. */
static void all_rate_gradients(
    stage_t (*stage)[GROUPS], const real_t *u, const real_t *p, real_t h, real_t (*rho)[STAGES][NXAU])
{
    (void)memset(rho, 0, STEPS * sizeof *rho);
    for (int step = 0; HAS_STAGE_RATE_GRADIENT && step < STEPS; step++) {
        rate_gradients(stage[step], u, p, h, rho[step]);
    }
}

/* g += Z_i' rho of a stage. */
static void add_gradient_of_stage(const real_t *Z, const real_t *U, const real_t *rho, real_t *g)
{
    for (int r = 0; r < NXAU; r++) {
        const real_t *row = row_of_stage(Z, U, r);
        for (int c = 0; c < NZ; c++) {
            g[c] += rho[r] * row[c];
        }
    }
}

/* Adds the second derivatives of the stages of a group to Q and g; mult and rho begin with those of its first stage. */
static void add_group(const stage_t *t, int b, const real_t *u, const real_t *p, real_t h, const real_t *Z,
    const real_t *U, real_t (*mu)[NXA], real_t (*rho)[NXAU], real_t *g, real_t *Q)
{
    real_t W[NXAU * NZ], H[NXAU][NXAU] = {{R(0)}};
    for (int i = 0; i < GROUP; i++) {
        const real_t weight = h * stage_weight[b * GROUP + i], *own = &Z[i * NXA * NZ];
        STAGE_CURVATURE(&t->X[i * NXA], u, p, mu[i], &weight, H);
        multiply_curvature(H, own, U, W);
        add_curvature_of_stage(own, U, W, Q);
        if (HAS_STAGE_RATE_GRADIENT) {
            add_gradient_of_stage(own, U, rho[i], g);
        }
    }
}

/* Computes Q in three sweeps: stages forward, their multipliers backward, sensitivities and Q forward. */
static void implicit_symmetric(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, const real_t *lam, real_t *x_next, real_t *S, real_t *left, real_t *g, real_t *Q)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], adj[NX], pulled[NU] = {R(0)}, rho[STEPS][STAGES][NXAU], mu[STEPS][STAGES][NXA];
    real_t DV[STAGES][NX * NZ], U[NU * NZ], Z[NB * NZ];
    stage_t stage[STEPS][GROUPS];
    (void)memcpy(end, x, sizeof end);
    (void)memset(left, 0, NX * sizeof *left);
    record_stages(end, z, u, p, h, newton, stage, left);
    all_rate_gradients(stage, u, p, h, rho);
    (void)memcpy(adj, lam, sizeof adj);
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho[step], adj, mu[step], pulled);
    }
    unit_columns(S, U);
    for (int step = 0; step < STEPS; step++) {
        for (int b = 0; b < GROUPS; b++) {
            const int i = b * GROUP;
            stage_columns(&stage[step][b], b, h, S, U, NZ, DV, Z);
            add_group(&stage[step][b], b, u, p, h, Z, U, &mu[step][i], &rho[step][i], g, Q);
        }
        end_step_of_columns(S, DV, NZ);
    }
    (void)memcpy(x_next, end, sizeof end);
}

/* Follows the derivatives of a step backward: adjS of lam, controlS of g_u, NZ columns. */
static void pull_columns(const stage_t *stage, const real_t *u, const real_t *p, real_t h, real_t (*mu)[NXA],
    real_t (*Z)[NB * NZ], const real_t *U, real_t *adjS, real_t *controlS)
{
    real_t bar[STAGES][NX * NZ], kappa[GROUP * NX * NZ], muS[NB * NZ], W[GROUP * NXAU * NZ], H[NXAU][NXAU] = {{R(0)}};
    (void)memset(W, 0, sizeof W);
    for (int b = GROUPS - 1; b >= 0; b--) {
        for (int i = 0; i < GROUP; i++) {
            const real_t weight = h * stage_weight[b * GROUP + i];
            STAGE_CURVATURE(&stage[b].X[i * NXA], u, p, mu[b * GROUP + i], &weight, H);
            multiply_curvature(H, &Z[b][i * NXA * NZ], U, &W[i * NXAU * NZ]);
        }
        adjoint_of_increment(adjS, b, bar, NZ, kappa);
        pull_stage(&stage[b], b, h, kappa, W, NZ, muS, bar);
        pull_controls(&stage[b], muS, W, NZ, controlS);
    }
    end_pulled_step(adjS, bar, NZ);
}

/* Computes Q by forward over adjoint: stages and sensitivities forward, the derivatives of the adjoint backward. */
static void implicit_forward_over_adjoint(const real_t *x, const real_t *z, const real_t *u, const real_t *p,
    const real_t *dt, int newton, const real_t *lam, real_t *x_next, real_t *S, real_t *left, real_t *g, real_t *Q)
{
    const real_t h = *dt / (real_t)STEPS;
    real_t end[NX], adj[NX], pulled[NU] = {R(0)}, rho[STEPS][STAGES][NXAU], mu[STAGES][NXA], D[STAGES][NX];
    real_t DV[STAGES][NX * NZ], U[NU * NZ], Z[STEPS][GROUPS][NB * NZ], adjS[NX * NZ] = {R(0)}, point[NXA];
    real_t controlS[NU * NZ] = {R(0)};
    stage_t stage[STEPS][GROUPS];
    (void)memcpy(end, x, sizeof end);
    (void)memset(left, 0, NX * sizeof *left);
    unit_columns(S, U);
    start_point(point, x, z);
    for (int step = 0; step < STEPS; step++) {
        for (int b = 0; b < GROUPS; b++) {
            (void)run_stage(&stage[step][b], point, D, b, end, u, p, h, newton, left);
            stage_columns(&stage[step][b], b, h, S, U, NZ, DV, Z[step][b]);
        }
        end_step(end, D, point);
        end_step_of_columns(S, DV, NZ);
    }
    all_rate_gradients(stage, u, p, h, rho);
    (void)memcpy(adj, lam, sizeof adj);
    for (int step = STEPS - 1; step >= 0; step--) {
        pull_step(stage[step], h, rho[step], adj, mu, pulled);
        pull_columns(stage[step], u, p, h, mu, Z[step], U, adjS, controlS);
        for (int i = 0; HAS_STAGE_RATE_GRADIENT && i < STAGES; i++) {
            add_gradient_of_stage(&Z[step][i / GROUP][i % GROUP * NXA * NZ], U, rho[step][i], g);
        }
    }
    for (int i = 0; i < NZ; i++) {
        for (int j = 0; j <= i; j++) {
            Q[i * NZ + j] += (i < NX) ? adjS[i * NZ + j] : controlS[(i - NX) * NZ + j];
        }
    }
    (void)memcpy(x_next, end, sizeof end);
}
