/* This part checks a result before the status becomes OK. The result (x, z, mult) must satisfy the hard rows and the
 * stationarity of the original QP, whatever the solver has concluded from its own, perturbed, conditions. */

/* Computes size[], the largest magnitude of every component of x and z over the stages; full: also of the sum of the
 * terms of a state in the dynamics, which may cancel. */
static void qp_component_sizes(solver_t *s, int full, real_t *size)
{
    const qp_t *q = &s->qp;
    qp_enlarge(q, size);
    for (int k = 0; full && k < N; k++) {
        real_t z[NZ];
        qp_stage_point(q, k, z);
        for (int i = 0; i < NX; i++) {
            real_t sum = FABS(stage_b(s, k)[i]);
            for (int j = 0; j < NZ; j++) {
                sum += FABS(stage_S(s, k)[i][j] * z[j]);
            }
            size[i] = (sum > size[i]) ? sum : size[i];
        }
    }
}

/* Returns 1 if row c with the value v is inside its bounds, and at the bound of its multiplier, up to rounding. `size`:
 * magnitude of its terms; `scale`: its scale. full: a multiplier whose bound the value does not reach becomes 0, and
 * the gradient, which is checked next, then shows whether it was needed. Otherwise the row does not hold. */
static int qp_row_holds(qp_t *q, int c, int hard, real_t v, real_t size, real_t scale, int full)
{
    const real_t over = v - q->upper[c], under = q->lower[c] - v;
    const real_t at_upper = TOL_QP_ACCEPTED * (size + FABS(q->upper[c])) + TOL_ROUNDING * scale;
    const real_t at_lower = TOL_QP_ACCEPTED * (size + FABS(q->lower[c])) + TOL_ROUNDING * scale;
    int holds = !hard || (over <= at_upper && under <= at_lower);
    if ((q->mult[c] > R(0) && !(over >= -at_upper && over > -INF)) ||
        (q->mult[c] < R(0) && !(under >= -at_lower && under > -INF))) {
        holds &= full;
        q->mult[c] = full ? R(0) : q->mult[c];
    }
    return holds;
}

/* Returns the least magnitude of row c: near a plan that is a solution, all its terms may vanish. */
static inline real_t qp_least_size(const solver_t *s, int c, int full)
{
    return full ? s->qp.least * s->units.reach[c] : R(0);
}

/* Returns 1 if all hard rows hold. */
static int qp_rows_hold(solver_t *s, int full)
{
    real_t size[NZ] = {0};
    int holds = 1;
    qp_component_sizes(s, full, size);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const int c = k * NU + j;
            real_t terms = size[NX + j];
            if (INTERIOR_POINT) {
                terms += qp_least_size(s, c, full);
            }
            holds &= qp_row_holds(&s->qp, c, 1, s->qp.z[c], terms, z_scale[NX + j], full);
        }
    }
    for (int m = 0; m < NG; m++) {
        real_t terms = row_terms(s, m, size);
        if (INTERIOR_POINT) {
            terms += qp_least_size(s, NV + m, full);
        }
        const real_t scale = row_magnitude[row_id(m)];
        holds &= qp_row_holds(&s->qp, NV + m, !qp_is_soft(&s->qp, m), qp_row_value(s, m), terms, scale, full);
    }
    return holds;
}

/* w = gradient of the Lagrangian at stage k with the multipliers lam of x_{k+1}; for the controls of the stage, rest[]
 * and terms[] become the largest magnitude of w and of the sum of its terms, those of the dynamics only if `full`. */
static void qp_check_stage(solver_t *s, int k, int full, const real_t *lam, real_t *w, real_t *rest, real_t *terms)
{
    const int first = k * NU;
    const real_t *g = stage_g(s, k);
    real_t(*S)[NZ] = stage_S(s, k);
    for (int j = 0; j < NU; j++) {
        const int i = NX + j;
        real_t sum = FABS(g[i]) + FABS(w[i] - g[i]) + FABS(s->qp.mult[first + j]);
        for (int l = 0; full && l < NX; l++) {
            sum += FABS(S[l][i] * lam[l]);
        }
        terms[j] = (sum > terms[j]) ? sum : terms[j];
    }
    riccati_combine(w, lam, S[0], NZ, NX, NZ);
    for (int j = 0; j < NU; j++) {
        const real_t amount = FABS(w[NX + j] + s->qp.mult[first + j]);
        rest[j] = (amount <= rest[j] || !isfinite(rest[j])) ? rest[j] : amount;
    }
}

/* Returns the magnitude of the terms of the cost at stage k, |g'z| and |y'z|, where y is the gradient. */
static real_t qp_cost_terms(solver_t *s, int k, const real_t *y)
{
    real_t sum = R(0);
    for (int i = 0; i < ((k < N) ? NZ : NX); i++) {
        const real_t z = (i < NX) ? s->qp.x[k][i] : s->qp.z[k * NU + i - NX];
        sum += (FABS(stage_g(s, k)[i]) + FABS(y[i])) * FABS(z);
    }
    return sum;
}

/* Returns 1 if a gradient with respect to control j is negligible: it moves this cost by less than rounding or, if it
 * is of the size of the noise, by less than the accepted part. */
static int qp_is_negligible(solver_t *s, int j, real_t gradient, real_t noise, real_t cost)
{
    real_t curvature = R(0);
    for (int k = 0; k < N; k++) {
        const real_t d = stage_Q(s, k)[NX + j][NX + j];
        curvature = (d > curvature) ? d : curvature;
    }
    const real_t reach = SQRT(cost * curvature);
    if (!(reach < INF)) {
        return 0;
    }
    return gradient <= TOL_QP_NOISE * reach ||
        (gradient <= TOL_QP_NOISE * noise && gradient <= TOL_QP_ACCEPTED * reach);
}

/* Computes noise[], the magnitude of all terms of the gradient with respect to the states of stage k, from the noise of
 * stage k + 1; most[]: the largest of the controls; size[]: magnitudes of the components of x and z. In a QP that
 * decouples into parts, all terms of one part may be rounding errors of another, and lam may be the rest of a sum that
 * vanishes. */
static void qp_spread_noise(solver_t *s, int k, const real_t *y, const real_t *size, real_t *noise, real_t *most)
{
    const int n = (k < N) ? NZ : NX;
    real_t sum[NZ] = {0};
    for (int i = 0; i < n; i++) {
        sum[i] = FABS(stage_g(s, k)[i]) + FABS(y[i]);
        sum[i] += FABS((k < N) ? stage_Q(s, k)[i][i] : stage_Q_N(s)[i][i]) * size[i];
        for (int l = 0; k < N && l < NX; l++) {
            sum[i] += FABS(stage_S(s, k)[l][i]) * noise[l];
        }
    }
    (void)memcpy(noise, sum, sizeof sum[0] * NX);
    for (int j = 0; k < N && j < NU; j++) {
        most[j] = (sum[NX + j] > most[j]) ? sum[NX + j] : most[j];
    }
}

/* Returns 1 if the gradient with respect to the free components of x_0 vanishes, where y is the part of stage 0. */
static int qp_free_is_stationary(solver_t *s, const real_t *y, const real_t *noise)
{
    const real_t *g = stage_g(s, 0);
    int holds = 1;
    real_t lam[NX], size[NX];
    (void)memcpy(lam, s->riccati.work.vectors.rhs.g[0], sizeof lam);
    for (int i = 0; i < NX; i++) {
        size[i] = FABS(g[i]) + FABS(y[i] - g[i]) + FABS(lam[i] - y[i]);
    }
    for (int f = 0; f < NF; f++) {
        const int i = free_state[f];
        const real_t rest = FABS(lam[i]) - TOL_ROUNDING * force_size[i];
        holds &= rest <= TOL_QP_ACCEPTED * size[i] || rest <= TOL_QP_NOISE * noise[i];
    }
    return holds;
}

/* Computes the gradients of cost and rows of all stages before their products with the dynamics, because vector loads
 * stall on scalars that have just been stored. */
static void qp_start_check(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        qp_cost_gradient(s, k, s->riccati.work.vectors.rhs.g[k]);
        for (int m = row_first[k]; m < row_first[k + 1]; m++) {
            qp_add_row(s, m, s->qp.mult[NV + m]);
        }
    }
}

/* Returns 1 if the gradient of the Lagrangian vanishes up to its tolerance, or moves the cost by no more than zeros do
 * (full). The multipliers of the dynamics follow from the states and remain in the first entries of rhs.g, so that only
 * the components of what is free are to be checked. */
static int qp_is_stationary(solver_t *s, int full)
{
    real_t(*w)[NZ] = s->riccati.work.vectors.rhs.g;
    real_t y[NZ], rest[NU] = {0}, terms[NU] = {0};
    real_t size[NZ] = {0}, noise[NX] = {0}, most[NU] = {0};
    real_t cost = least_cost();
    int holds = 1;
    if (full) {
        qp_component_sizes(s, full, size);
    }
    if (TILES) {
        qp_start_check(s);
    }
    for (int k = N; k >= 0; k--) {
        if (!TILES) {
            qp_cost_gradient(s, k, w[k]);
            for (int m = row_first[k]; m < row_first[k + 1]; m++) {
                qp_add_row(s, m, s->qp.mult[NV + m]);
            }
        }
        (void)memcpy(y, w[k], sizeof y[0] * (k < N ? NZ : NX));
        if (k < N) {
            qp_check_stage(s, k, full, w[k + 1], w[k], rest, terms);
        }
        if (full) {
            qp_spread_noise(s, k, y, size, noise, most);
            cost += qp_cost_terms(s, k, y);
        }
    }
    for (int j = 0; j < NU; j++) {
        const real_t rounding = (full ? TOL_ZERO : TOL_ROUNDING) * force_size[NX + j];
        holds &= isfinite(terms[j]);
        holds &= rest[j] <= TOL_QP_ACCEPTED * terms[j] + rounding ||
            (full && qp_is_negligible(s, j, rest[j], most[j], cost));
    }
    if (NF) {
        holds &= qp_free_is_stationary(s, y, noise);
    }
    return holds;
}

/* Returns 1 if the result is a solution. The test is first made with sums of fewer terms, which are cheaper to compute;
 * if it fails, multipliers of rows that are not at their bounds become 0. */
static int qp_is_solution(solver_t *s)
{
    int solution = 0;
    for (int full = 0; full <= 1 && !solution; full++) {
        solution = qp_rows_hold(s, full) && qp_is_stationary(s, full);
    }
    return solution;
}
