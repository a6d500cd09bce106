/* This part bounds the change of the values of rows, and computes the first iterate. Both start from the minimiser that
 * is subject to only the equations. */

/* Runs the recursion with the present weights. If a pivot may be zero, a term is added to it, which is increased until
 * the factorisation succeeds. */
static int ipm_factorize(solver_t *s)
{
    riccati_t *r = &s->riccati;
    r->regularize = 0;
    r->regularize_zero = R(0);
    if (riccati_factorize(s, N)) {
        return 1;
    }
    r->regularize = 1;
    r->regularize_zero = s->ipm.least_pivot;
    for (int attempt = 0; attempt < 5; attempt++) {
        if (riccati_factorize(s, N)) {
            return 1;
        }
        r->regularize_zero *= FACTOR_IPM_REGULARIZE;
    }
    return 0;
}

/* Returns the damping of the bounded rows of a QP whose Hessian is singular without them: the largest of Q_jj d^2 and
 * |g_j| d over the controls with two finite bounds, where d is the distance between the bounds. */
static real_t ipm_damping_cost(solver_t *s)
{
    real_t most = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t d = s->qp.upper[k * NU + j] - s->qp.lower[k * NU + j];
            const real_t square = stage_Q(s, k)[NX + j][NX + j] * d * d;
            const real_t linear = FABS(stage_g(s, k)[NX + j]) * d;
            most = (isfinite(square) && square > most) ? square : most;
            most = (isfinite(linear) && linear > most) ? linear : most;
        }
    }
    return (most > R(0)) ? most : R(1);
}

/* Sets the proximal term, a small fraction of the largest diagonal entry of each variable. If the Hessian is singular,
 * proximal point steps prevent rounding errors from moving the iterate along its null space. */
static void ipm_set_proximal(solver_t *s)
{
    ipm_t *q = &s->ipm;
    q->proximity = R(1);
    for (int i = 0; i < NZ; i++) {
        real_t most = R(0);
        for (int k = 0; k < N; k++) {
            most = (stage_Q(s, k)[i][i] > most) ? stage_Q(s, k)[i][i] : most;
        }
        q->proximal[i] = (most > R(0)) ? FACTOR_IPM_PROXIMAL * most : FACTOR_IPM_PROXIMAL_ZERO * q->least_pivot;
    }
}

/* Returns the least stiffening. A damped problem, whose Hessian is small beside the weights of its rows, has them
 * reduced. */
static inline real_t ipm_least_stiffening(const ipm_t *q)
{
    const real_t least = FACTOR_IPM_LEAST_STIFFENING * TOL_IPM_DUAL_REGULARIZATION / SQRT(TOL_UNIT);
    return (q->damping > R(0) && least < R(1)) ? least : R(1);
}

/* Returns the distance between the bounds of row c, or a fraction of their magnitude if they are closer than that; 0 if
 * one is infinite. */
static real_t ipm_range(const qp_t *q, int c)
{
    const real_t d = q->upper[c] - q->lower[c], size = FACTOR_IPM_RANGE * (FABS(q->lower[c]) + FABS(q->upper[c]));
    if (!(d > R(0) && isfinite(d))) {
        return R(0);
    }
    return (d > size) ? d : size;
}

/* Sets the weights for the first factorisation: of equations and, if it is damped, of the rows with two bounds. */
static void ipm_first_weights(solver_t *s)
{
    ipm_t *q = &s->ipm;
    (void)memset(q->weight, 0, sizeof q->weight);
    if (NG) {
        (void)memcpy(q->weight + NV, q->stiffness, sizeof q->stiffness);
    }
    for (int c = 0; q->damping > R(0) && c < NV + NG; c++) {
        const real_t d = ipm_range(&s->qp, c);
        if (q->kind[c] == INEQUALITY && d > R(0)) {
            q->weight[c] = q->damping / (d * d);
        }
    }
    ipm_set_weights(s);
}

/* Sets the stiffness of the equations: one step satisfies an equation up to a small fraction of reach^2 times the
 * multiplier. Returns 1 if there is an equation. */
static int ipm_set_stiffness(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int any = 0;
    for (int m = 0; m < NG; m++) {
        const real_t reach = s->units.reach[NV + m];
        const int equation = q->kind[NV + m] == EQUATION && reach > R(0);
        q->stiffness[m] = equation ? R(1) / (TOL_IPM_EQUATION_REGULARIZATION * reach * reach) : R(0);
        any |= equation;
    }
    return any;
}

/* Computes the reach of the rows, and the factorisation with the equations if there are any. */
static int ipm_add_equations(solver_t *s)
{
    riccati_set_reach(s);
    if (ipm_set_stiffness(s)) {
        ipm_first_weights(s);
        return ipm_factorize(s);
    }
    return 1;
}

/* Runs the first factorisation with damped rows, for a Hessian that is singular or vanishes beside the gradient. */
static int ipm_damped_factorization(solver_t *s)
{
    ipm_t *q = &s->ipm;
    (void)memset(q->stiffness, 0, sizeof q->stiffness);
    q->damping = ipm_damping_cost(s);
    q->stiffening = ipm_least_stiffening(q);
    ipm_set_proximal(s);
    ipm_first_weights(s);
    return ipm_factorize(s) && ipm_add_equations(s);
}

/* Factorises the problem with equations only, and computes the reach of the rows. plain: as in ipm_prepare(). */
static int ipm_first_factorization(solver_t *s, int plain)
{
    ipm_t *q = &s->ipm;
    int stands = plain;
    (void)memset(q->stiffness, 0, sizeof q->stiffness);
    (void)memset(q->proximal, 0, sizeof q->proximal);
    q->damping = R(0);
    q->stiffening = R(1);
    q->least_pivot = riccati_least_pivot(s);
    ipm_first_weights(s);
    s->riccati.regularize = 0;
    for (int c = 0; c < NV; c++) {
        stands &= !s->riccati.fixed[c];
    }
    return (stands || riccati_factorize(s, N)) ? ipm_add_equations(s) : ipm_damped_factorization(s);
}

/* Computes the multipliers of the weighted rows at v = 0, from which the first point is computed, and the values of the
 * fixed controls. Returns 1 if one of them has changed. */
static int ipm_first_forces(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int changed = 0;
    for (int c = 0; c < NV + NG; c++) {
        const real_t middle = R(0.5) * (s->qp.lower[c] + s->qp.upper[c]);
        const real_t f = (q->weight[c] > R(0)) ? -q->weight[c] * middle : R(0);
        changed |= !(f >= q->force[c] && f <= q->force[c]);
        q->force[c] = f;
    }
    for (int c = 0; c < NV; c++) {
        const real_t u = (q->kind[c] == GIVEN_CONTROL) ? s->qp.lower[c] : R(0);
        changed |= !(u >= s->riccati.du[c] && u <= s->riccati.du[c]);
        s->riccati.du[c] = u;
    }
    return changed;
}

/* Runs the backward substitution, which does not depend on dx_0. */
static void ipm_first_backward(solver_t *s)
{
    riccati_t *r = &s->riccati;
    real_t(*g)[NZ] = r->work.vectors.rhs.g;
    for (int k = 0; k < N; k++) {
        (void)memcpy(g[k], stage_g(s, k), sizeof g[k]);
        (void)memcpy(r->b[k], stage_b(s, k), sizeof r->b[k]);
    }
    (void)memcpy(g[N], stage_g(s, N), sizeof g[0][0] * NX);
    ipm_add_forces(s, s->ipm.force);
    riccati_backward(s, N);
}

/* (x, u) = minimiser subject to the equations only. Returns 0 if it is not finite. The recursion computes steps from
 * here on: its gaps and fixed controls become 0. */
static int ipm_first_point(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t probe = R(0);
    (void)memcpy(s->qp.x[0], s->step.dx[0], sizeof s->step.dx[0]);
    riccati_forward(s, s->qp.x, s->qp.z);
    (void)memset(s->riccati.b, 0, sizeof s->riccati.b);
    (void)memset(s->riccati.du, 0, sizeof s->riccati.du);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            probe += R(0) * s->qp.x[k][i];
        }
    }
    ipm_values(s);
    (void)memcpy(q->origin, q->v, sizeof q->v);
    for (int c = 0; c < NV + NG; c++) {
        probe += R(0) * q->v[c];
    }
    for (int m = 0; m < NG; m++) {
        const int c = NV + m;
        q->y[m] = (q->kind[c] == EQUATION) ? q->weight[c] * (q->v[c] - s->qp.lower[c]) : R(0);
    }
    return isfinite(probe) != 0;
}

/* Returns the violation of the bounds of row c, which has no multiplier yet, beyond rounding. */
static real_t ipm_violation(const solver_t *s, int c)
{
    const real_t v = s->ipm.v[c], over = v - s->qp.upper[c], under = s->qp.lower[c] - v;
    const real_t amount = (over > under) ? over : under;
    const real_t bound = FABS((over > under) ? s->qp.upper[c] : s->qp.lower[c]);
    return (amount > TOL_IPM_VIOLATION * (bound + FABS(v))) ? amount : R(0);
}

/* Returns 1 if a row with two bounds is violated by many times the distance between them. */
static int ipm_is_far(const solver_t *s)
{
    int far = 0;
    for (int c = 0; c < NV + NG; c++) {
        const real_t d = ipm_range(&s->qp, c);
        far |= d > R(0) && ipm_violation(s, c) > FACTOR_IPM_WARM_VIOLATION * d;
    }
    return far;
}

/* Computes the first point, again with damped rows if it is far from the bounds, as with a nearly linear cost. Returns
 * 0 if it is not finite. */
static int ipm_near_point(solver_t *s)
{
    if (!ipm_first_point(s)) {
        return 0;
    }
    if (s->ipm.damping > R(0) || !ipm_is_far(s)) {
        return 1;
    }
    if (!ipm_damped_factorization(s)) {
        return 0;
    }
    ipm_first_forces(s);
    ipm_first_backward(s);
    return ipm_first_point(s);
}

/* Returns the cost of the violations, sum of (violation / reach)^2; `count` is their number. */
static real_t ipm_violation_cost(const solver_t *s, int *count)
{
    real_t sum = R(0);
    *count = 0;
    for (int c = 0; c < NV + NG; c++) {
        if (s->ipm.kind[c] == INEQUALITY && s->units.reach[c] > R(0)) {
            const real_t d = ipm_violation(s, c) / s->units.reach[c];
            sum += d * d;
            *count += d > R(0);
        }
    }
    return sum;
}

/* Returns 1 if an inequality is violated. */
static int ipm_any_violation(const solver_t *s)
{
    int count;
    ipm_violation_cost(s, &count);
    return count > 0;
}

/* Returns 1 if soft side i was violated in the previous QP. */
static inline int ipm_was_violated(const solver_t *s, int i)
{
    return s->ipm.warm && s->qp.side[ipm_row(&s->ipm, i)] == (ipm_is_upper(&s->ipm, i) ? ABOVE : BELOW);
}

/* Starts side i near its present violation. */
static void ipm_start_violated_side(solver_t *s, int i, real_t mu)
{
    ipm_t *q = &s->ipm;
    const int c = ipm_row(q, i), j = i - q->hard, m = c - NV;
    const real_t least = SQRT(mu) * s->units.reach[c], violation = -ipm_distance(s, i);
    q->e[j] = (violation > least) ? violation : least;
    q->lam[i] = s->qp.penalty[m] + s->qp.curvature[m] * q->e[j];
    q->kappa[j] = (mu / q->e[j] < R(0.5) * q->lam[i]) ? mu / q->e[j] : R(0.5) * q->lam[i];
    q->lam[i] -= q->kappa[j];
    q->t[i] = mu / q->lam[i];
}

/* Starts slack and multiplier of a soft side, the multiplier below the penalty unless the side was violated in the
 * previous QP. */
static void ipm_start_soft_side(solver_t *s, int i, real_t mu)
{
    ipm_t *q = &s->ipm;
    const int m = ipm_row(q, i) - NV, j = i - q->hard;
    const real_t l1 = s->qp.penalty[m];
    if (!(l1 > R(0))) {
        q->kappa[j] = R(0);
        q->e[j] = q->lam[i] / s->qp.curvature[m];
        return;
    }
    if (!IPM_CROSSOVER) {
        if (ipm_was_violated(s, i)) {
            ipm_start_violated_side(s, i, mu);
            return;
        }
    }
    q->lam[i] = (q->lam[i] < R(0.5) * l1) ? q->lam[i] : R(0.5) * l1;
    q->t[i] = mu / q->lam[i];
    q->kappa[j] = l1 - q->lam[i];
    q->e[j] = mu / q->kappa[j];
}

/* Computes the distance t of side i from its multiplier in the previous QP: t lam = mu,
 *     t - reach^2 lam = distance - reach^2 |previous multiplier|,
 * where the distance of a violated bound counts as 0. The multiplier is limited to `most`, which is derived from the
 * present cost of the violations, most^2 / 16. Returns 0 if there was no multiplier. */
static real_t ipm_warm_distance(const solver_t *s, int i, real_t mu, real_t most)
{
    const ipm_t *q = &s->ipm;
    const int c = ipm_row(q, i);
    const real_t reach = s->units.reach[c], distance = ipm_distance(s, i);
    real_t force = q->warm ? ipm_sign(q, i) * q->before[c] * reach : R(0), root;
    if (!(force > R(0))) {
        return R(0);
    }
    force = (force < most) ? force : most;
    force -= (distance > R(0)) ? distance / reach : R(0);
    root = SQRT(force * force + R(4) * mu);
    return (force > R(0)) ? R(2) * mu * reach / (root + force) : R(0.5) * (root - force) * reach;
}

/* Returns the distance t of side i without a multiplier: that of the value moved inside the bounds, sqrt(mu) reach from
 * each of them or in the middle, so that the distances of a row sum up to the one between its bounds. */
static real_t ipm_cold_distance(const solver_t *s, int i, real_t root_mu)
{
    const int c = ipm_row(&s->ipm, i);
    const real_t range = s->qp.upper[c] - s->qp.lower[c], distance = ipm_distance(s, i);
    real_t t = root_mu * s->units.reach[c];
    t = (R(0.5) * range < t && range > R(0)) ? R(0.5) * range : t;
    if (distance > range - t && range > R(0)) {
        return range - t;
    }
    return (distance > t) ? distance : t;
}

/* Makes the distances of the two sides of a row sum up to the distance d between its bounds; the smaller one counts. */
static void ipm_match_sides(ipm_t *q, int i, real_t d)
{
    const int least = (q->t[i] < q->t[i + 1]) ? i : i + 1, other = 2 * i + 1 - least;
    q->t[least] = (q->t[least] < R(0.5) * d) ? q->t[least] : R(0.5) * d;
    q->t[other] = d - q->t[least];
}

/* Sets the initial t and lam = mu / t of every side. */
static void ipm_start_sides(solver_t *s, real_t mu)
{
    ipm_t *q = &s->ipm;
    const real_t root_mu = SQRT(mu);
    real_t most = R(0);
    if (!IPM_CROSSOVER) {
        int count;
        most = FACTOR_IPM_MOST_MULTIPLIER * SQRT(ipm_violation_cost(s, &count));
    }
    for (int i = 0; i < q->sides; i++) {
        q->t[i] = ipm_cold_distance(s, i, root_mu);
        if (!IPM_CROSSOVER) {
            const real_t warm = ipm_warm_distance(s, i, mu, most);
            q->t[i] = (warm > R(0)) ? warm : q->t[i];
        }
    }
    for (int i = 0; i < q->hard; i += ipm_sides_of_row(q, i)) { /* at most NV + NG passes */
        const real_t d = s->qp.upper[ipm_row(q, i)] - s->qp.lower[ipm_row(q, i)];
        if (ipm_sides_of_row(q, i) == 2 && d > R(0)) {
            ipm_match_sides(q, i, d);
        }
    }
    for (int i = 0; i < q->sides; i++) {
        q->lam[i] = mu / q->t[i];
    }
    if (NG) {
        for (int i = q->hard; i < q->sides; i++) { /* at most 2 * NG passes */
            ipm_start_soft_side(s, i, mu);
        }
    }
}
