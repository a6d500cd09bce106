/* Predictor-corrector iterations lead from the initial sides to the solution. */

/* Returns the multiplier of a soft row that depends on no control; 0 for any other row. */
static real_t ipm_constant_multiplier(const solver_t *s, int c)
{
    const qp_t *q = &s->qp;
    const int m = c - NV;
    if (!(s->units.reach[c] > R(0)) && qp_is_soft(q, m)) {
        const real_t violation = ipm_violation(s, c);
        if (violation > R(0)) {
            const real_t force = q->penalty[m] + q->curvature[m] * violation;
            return (s->ipm.v[c] > q->upper[c]) ? force : -force;
        }
    }
    return R(0);
}

/* Computes the multipliers of the rows, except those of fixed controls. */
static void ipm_net_multipliers(solver_t *s)
{
    const ipm_t *q = &s->ipm;
    real_t *mult = s->qp.mult;
    (void)memset(mult, 0, sizeof s->qp.mult);
    for (int m = 0; m < NG; m++) {
        mult[NV + m] = (q->kind[NV + m] == EQUATION) ? q->y[m] : ipm_constant_multiplier(s, NV + m);
    }
    for (int i = 0; i < q->sides; i++) {
        mult[ipm_row(q, i)] += ipm_sign(q, i) * q->lam[i];
    }
}

/* Returns the unit of the complementarity: the cost of the inequalities, 1/2 sum_c mult_c (v_c at the first point -
 * v_c), at most the largest (mult reach)^2 of a row. As active inequalities may have no cost, the unit is at least a
 * small fraction of the largest (value / reach)^2 of a control; at rest it is so large that its square does not
 * underflow. */
static real_t ipm_cost_unit(const solver_t *s)
{
    const ipm_t *q = &s->ipm;
    real_t most = R(0), sum = R(0), way = TOL_UNIT;
    for (int c = 0; c < NV + NG; c++) {
        const real_t force = FABS(s->qp.mult[c]) * s->units.reach[c];
        most = (force > most) ? force : most;
        sum += s->qp.mult[c] * (q->origin[c] - q->v[c]);
    }
    for (int c = 0; c < NV; c++) {
        const real_t v = FABS(q->v[c]), reach = s->units.reach[c];
        way = (q->kind[c] == INEQUALITY && v > way * reach && reach > R(0)) ? v / reach : way;
    }
    sum = R(0.5) * FABS(sum);
    most = (sum < most * most) ? sum : most * most;
    way *= FACTOR_IPM_SMALL_DISTANCE;
    return (most > way * way) ? most : way * way;
}

/* Returns sum |a_i| |z_i| of row c, the scale of the rounding error of its value. */
static real_t ipm_terms(const solver_t *s, int c)
{
    if (NG && (GENERAL_ROWS || NE)) {
        if (c >= NV && !row_is_state(c - NV)) {
            const int k = row_node(c - NV);
            const real_t *a = row_gradient(s, c - NV);
            real_t sum = R(0);
            for (int i = 0; i < NX; i++) {
                sum += FABS(a[i] * s->qp.x[k][i]);
            }
            for (int i = 0; k < N && i < NU; i++) {
                sum += FABS(a[NX + i] * s->qp.z[k * NU + i]);
            }
            return sum;
        }
    }
    return FABS(s->ipm.v[c]);
}

/* Updates the largest |residual| of a row relative to |bound|, the terms of the value, and the distance that the unit
 * of cost allows. */
static void ipm_take_residual(solver_t *s, int c, real_t bound, real_t residual, real_t root)
{
    ipm_t *q = &s->ipm;
    const real_t amount = FABS(residual);
    real_t size = FABS(bound) + FABS(q->v[c]) + root * s->units.reach[c];
    if (amount > q->primal * size) {
        size += ipm_terms(s, c) - FABS(q->v[c]);
        q->primal = (amount > q->primal * size) ? amount / size : q->primal;
    }
}

/* Computes multipliers, residuals and unit of cost at the iterate. */
static void ipm_measure(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t root;
    ipm_values(s);
    ipm_net_multipliers(s);
    ipm_side_residuals(s);
    q->unit = ipm_cost_unit(s);
    q->unit = (q->unit > q->mu) ? q->unit : q->mu;
    root = SQRT(q->unit);
    q->primal = R(0);
    for (int i = 0; i < q->sides; i++) {
        ipm_take_residual(s, ipm_row(q, i), ipm_bound(s, i), q->r[i], root);
    }
    for (int m = 0; m < NG; m++) {
        const real_t bound = s->qp.lower[NV + m];
        if (q->stiffness[m] > R(0)) {
            ipm_take_residual(s, NV + m, bound, q->v[NV + m] - bound, root);
        }
    }
}

/* Reduces the regularisation if the residual of the rows decreases too slowly, as when rows leave little room to one
 * another. Due to the regularisation a full step does not satisfy the rows exactly. Returns 1 if it is reduced. */
static int ipm_increase_stiffening(ipm_t *q, real_t before)
{
    if (q->step > FACTOR_IPM_FULL_STEP && q->primal > R(2) * TOL_IPM_PRIMAL &&
        q->primal > FACTOR_IPM_SLOW_ROWS * before && q->stiffening < q->stiffest) {
        q->stiffening *= FACTOR_IPM_STIFFENING_RATIO;
        return 1;
    }
    return 0;
}

/* max(most, -direction / value). */
static inline real_t ipm_largest_ratio(real_t most, real_t value, real_t direction)
{
    const real_t ratio = -direction / value;
    return (ratio > most) ? ratio : most;
}

/* 1 / (longest step that keeps t, lam, e and kappa nonnegative). */
static real_t ipm_inverse_step(const ipm_t *q)
{
    real_t most = R(0);
    for (int i = 0; i < q->sides; i++) {
        most = ipm_largest_ratio(most, q->t[i], q->dt[i]);
        most = ipm_largest_ratio(most, q->lam[i], q->dlam[i]);
    }
    if (NG) {
        for (int i = 0; i < q->sides - q->hard; i++) { /* at most 2 * NG passes */
            if (q->kappa[i] > R(0)) {
                most = ipm_largest_ratio(most, q->e[i], q->de[i]);
                most = ipm_largest_ratio(most, q->kappa[i], q->dkappa[i]);
            }
        }
    }
    return most;
}

/* Returns the mean of t lam and e kappa after a step of the given length, relative to the present mean. */
static real_t ipm_reduction(const ipm_t *q, real_t step)
{
    real_t now = R(0), then = R(0);
    for (int i = 0; i < q->sides; i++) {
        now += q->t[i] * q->lam[i];
        then += (q->t[i] + step * q->dt[i]) * (q->lam[i] + step * q->dlam[i]);
    }
    if (NG) {
        for (int i = 0; i < q->sides - q->hard; i++) { /* at most 2 * NG passes */
            now += q->e[i] * q->kappa[i];
            then += (q->e[i] + step * q->de[i]) * (q->kappa[i] + step * q->dkappa[i]);
        }
    }
    return then / now;
}

/* Clears the correction terms, for the affine direction. */
static void ipm_correct_nothing(ipm_t *q)
{
    (void)memset(q->dt, 0, sizeof q->dt);
    (void)memset(q->dkappa, 0, sizeof q->dkappa);
}

/* Sets second-order correction and centring of the products t lam and e kappa: extra = (target - share dt dlam) / lam
 * replaces dt, and likewise for e. If only a short step along the affine direction is possible, its full correction
 * would be harmful: share < 1. */
static void ipm_correct(ipm_t *q, real_t target, real_t share)
{
    for (int i = 0; i < q->sides; i++) {
        q->dt[i] = (target - share * q->dt[i] * q->dlam[i]) / q->lam[i];
    }
    for (int i = 0; i < q->sides - q->hard; i++) { /* at most 2 * NG passes */
        q->dkappa[i] = (q->kappa[i] > R(0)) ? (target - share * q->de[i] * q->dkappa[i]) / q->e[i] : R(0);
    }
}

/* Moves states and controls by `step` times the direction, which multiplies the gaps by 1 - step. */
static void ipm_move_point(solver_t *s, real_t step)
{
    riccati_t *r = &s->riccati;
    const direction_t *d = &r->work.vectors.rhs.direction;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->qp.x[k][i] += step * d->dx[k][i];
        }
        for (int i = 0; k < N && i < NX; i++) {
            r->b[k][i] *= R(1) - step;
        }
    }
    for (int c = 0; c < NV; c++) {
        s->qp.z[c] += step * d->du[c];
    }
}

/* Moves all unknowns by `step` times the direction. */
static void ipm_move(solver_t *s, real_t step)
{
    ipm_t *q = &s->ipm;
    ipm_move_point(s, step);
    for (int m = 0; m < NG; m++) {
        const int c = NV + m;
        if (q->kind[c] == EQUATION) {
            q->y[m] += step * q->weight[c] * ((q->v[c] - s->qp.lower[c]) + q->dv[c]);
        }
    }
    for (int i = 0; i < q->sides; i++) {
        q->t[i] += step * q->dt[i];
        q->lam[i] += step * q->dlam[i];
    }
    for (int i = 0; i < q->sides - q->hard; i++) { /* at most 2 * NG passes */
        q->e[i] += step * q->de[i];
        q->kappa[i] += step * q->dkappa[i];
    }
}

/* Returns the fraction of the distance to the boundary that is kept: small, and smaller near the solution. An iteration
 * that is still far from the solution after many steps, or takes short ones, cycles close to the boundary; a larger
 * fraction ends the cycle. */
static real_t ipm_setback(const solver_t *s)
{
    const real_t gap = s->ipm.mu / s->ipm.unit;
    if (s->qp.iterations - s->ipm.begun > 15 && (gap > SQRT(TOL_UNIT) || s->ipm.step < R(0.5))) {
        return FACTOR_IPM_SETBACK_CYCLE;
    }
    return (gap > FACTOR_IPM_EARLY_GAP) ? FACTOR_IPM_SETBACK_EARLY
        : (gap < FACTOR_IPM_LATE_GAP)   ? FACTOR_IPM_SETBACK_LATE
                                        : FACTOR_IPM_SETBACK_SHARE * gap;
}

/* Returns the step length d'W d / -d'W dv for a direction, where d is the residual of the equations: the step of
 * steepest ascent of the dual function. If equations are nearly dependent, the method of multipliers takes short steps
 * in one direction. */
static real_t ipm_length_of_ascent(const solver_t *s)
{
    const ipm_t *q = &s->ipm;
    real_t gain = R(0), size = R(0);
    for (int c = NV; c < NV + NG; c++) {
        if (q->kind[c] == EQUATION) {
            const real_t residual = q->v[c] - s->qp.lower[c];
            gain += q->weight[c] * residual * residual;
            size -= q->weight[c] * residual * q->dv[c];
        }
    }
    if (!(q->stretched && gain > size)) {
        return R(1);
    }
    return (gain < FACTOR_IPM_LONGEST_ASCENT * size) ? gain / size : FACTOR_IPM_LONGEST_ASCENT;
}

/* Takes a step of Mehrotra's method (1992): affine direction, centring according to its success, corrected
 * direction. */
static void ipm_step(solver_t *s)
{
    ipm_t *q = &s->ipm;
    const real_t least = FACTOR_IPM_LEAST_TARGET * TOL_IPM_GAP * q->unit;
    real_t inverse, share, target, way, most = R(1);
    ipm_correct_nothing(q);
    ipm_direction(s);
    if (q->sides == 0) {
        if (NG) {
            most = ipm_length_of_ascent(s);
        }
        ipm_move(s, most);
        return;
    }
    inverse = ipm_inverse_step(q);
    share = ipm_reduction(q, (inverse > R(1)) ? R(1) / inverse : R(1));
    share = (share > R(0)) ? share : R(0);
    share = (share < R(1)) ? share : R(1);
    target = share * share * share * q->mu;
    ipm_correct(q, (target > least) ? target : least,
        (inverse > FACTOR_IPM_MOST_CORRECTION) ? FACTOR_IPM_MOST_CORRECTION / inverse : R(1));
    ipm_direction(s);
    inverse = ipm_inverse_step(q);
    way = R(1) - ipm_setback(s);
    if (NG) {
        most = ipm_length_of_ascent(s);
    }
    q->step = (way < inverse * most) ? way / inverse : most;
    ipm_move(s, q->step);
}

/* Computes the gaps b = S_k z_k + b_k - x_{k+1} at the iterate, where rounding errors accumulate over the iterations.
 * Returns the largest gap relative to the largest value of that state. */
static real_t ipm_gaps(solver_t *s)
{
    real_t most = R(0), size[NX] = {0};
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            const real_t x = FABS(s->qp.x[k][i]);
            size[i] = (x > size[i]) ? x : size[i];
        }
    }
    for (int k = 0; k < N; k++) {
        real_t *b = s->riccati.b[k];
        qp_gap(s, k, b);
        for (int i = 0; i < NX; i++) {
            most = (FABS(b[i]) > most * size[i]) ? FABS(b[i]) / size[i] : most;
        }
    }
    return most;
}

/* Returns 1 if the residuals are small enough to be accepted when they stop decreasing. */
static inline int ipm_small_residuals(const ipm_t *q)
{
    return q->merit <= FACTOR_IPM_ACCEPTED_ROWS && q->slope <= FACTOR_IPM_ACCEPTED_GRADIENT;
}

/* Returns 1 if all residuals are within their tolerance, or small and not decreasing, as large weights may cause
 * rounding errors in the gradient. In that case the gaps of the dynamics are closed first. */
static int ipm_has_converged(solver_t *s)
{
    ipm_t *q = &s->ipm;
    const real_t rows_before = q->merit, gradient_before = q->slope;
    q->merit = q->primal / TOL_IPM_PRIMAL;
    if (q->mu > q->merit * TOL_IPM_GAP * q->unit) {
        q->merit = q->mu / (TOL_IPM_GAP * q->unit);
    }
    q->slope = INF;
    if (!(q->merit <= FACTOR_IPM_ACCEPTED_ROWS)) {
        return 0;
    }
    q->slope = ipm_stationarity(s) / TOL_IPM_STATIONARITY;
    if ((q->merit > R(1) && q->merit <= FACTOR_IPM_STAGNANT * rows_before) || !ipm_small_residuals(q) ||
        (q->slope > R(1) && q->slope <= R(0.5) * gradient_before)) {
        return 0;
    }
    if (q->closed_gaps < 2 && ipm_gaps(s) > TOL_IPM_DYNAMICS) {
        q->closed_gaps++;
        return 0;
    }
    return 1;
}

/* Returns 1 if the result is a solution. Rows are not exact: a violation that moves the cost by no more than rounding
 * of its unit is negligible, even if the bounds, and with them all terms of a row, vanish. */
static int ipm_is_solution(solver_t *s)
{
    s->qp.least = FACTOR_IPM_NEGLIGIBLE_ROW * TOL_UNIT / TOL_QP_ACCEPTED * SQRT(s->ipm.unit);
    return qp_is_solution(s);
}

/* Returns 1 if the iterate is good enough to end the iterations. Without curvature, or after many iterations, rounding
 * errors may keep it from the tolerances at which they aim; they continue as long as the residuals decrease. */
static int ipm_suffices(solver_t *s, real_t merit_before)
{
    ipm_t *q = &s->ipm;
    q->deferred = 0;
    if (!(q->damping > R(0) || s->qp.iterations - q->begun > 20) || q->primal > TOL_QP_ACCEPTED ||
        q->mu > TOL_QP_ACCEPTED * q->unit) {
        return 0;
    }
    q->deferred =
        q->merit > R(1) && q->merit <= FACTOR_IPM_IMPROVEMENT * merit_before && s->qp.iterations - q->begun <= 60;
    if (q->deferred) {
        return 0;
    }
    ipm_stationarity(s); /* multipliers of fixed controls */
    return ipm_is_solution(s);
}

/* Resets the stiffening and limits it to a lower value for the rest of the solve, if the rounding errors of stiff rows
 * have covered the gradient for several iterations. Returns 1 if it does. */
static int ipm_limit_stiffening(ipm_t *q, real_t gradient_before)
{
    if (q->stiffening > ipm_least_stiffening(q) && q->slope < INF && q->slope > FACTOR_IPM_ACCEPTED_GRADIENT &&
        q->slope > R(0.5) * gradient_before) {
        q->stiffest = FACTOR_IPM_STIFFEST_RATIO * q->stiffening;
        q->stiffening = ipm_least_stiffening(q);
        return 1;
    }
    return 0;
}

/* Reduces the proximal term as far as rounding permits if the gradient decreases too slowly, because proximal point
 * steps are short along directions of little curvature. Returns 1 if it does. */
static int ipm_reduce_proximal(ipm_t *q, real_t gradient_before)
{
    if (q->damping > R(0) && q->slope < INF && q->slope > R(1) && q->slope > R(0.5) * gradient_before &&
        q->proximity > FACTOR_IPM_LEAST_PROXIMAL * SQRT(TOL_UNIT)) {
        q->proximity *= FACTOR_IPM_PROXIMAL_RATIO;
        for (int i = 0; i < NZ; i++) {
            q->proximal[i] *= FACTOR_IPM_PROXIMAL_RATIO;
        }
        return 1;
    }
    return 0;
}

/* Runs the recursion with the present weights. It may fail if rows are too stiff; it is then repeated with the initial
 * regularisation. Returns 0 if that fails, too. */
static int ipm_weigh_and_factorize(solver_t *s)
{
    ipm_weigh(s);
    while (!ipm_factorize(s)) { /* at most 2 passes */
        if (s->ipm.stiffening <= ipm_least_stiffening(&s->ipm)) {
            return 0;
        }
        s->ipm.stiffening = ipm_least_stiffening(&s->ipm);
        ipm_weigh(s);
    }
    return 1;
}

/* Returns 1 if the next step is to be stretched: every other step if only the equations have not converged and their
 * residuals hardly decrease. */
static int ipm_slow_equations(const ipm_t *q, real_t before)
{
    return !q->stretched && q->primal > FACTOR_IPM_STAGNANT * before && q->stiffening >= q->stiffest &&
        q->mu <= FACTOR_IPM_ACCEPTED_ROWS * TOL_IPM_GAP * q->unit && ipm_any(q, EQUATION);
}

/* Returns 1 before termination if the residuals of the equations exceed rounding: the next step is then stretched. Also
 * returns 1 after a stretched step, so that another step follows. */
static int ipm_inexact_equations(ipm_t *q)
{
    q->stretched = !q->stretched;
    if (q->stretched) {
        q->stretched =
            ipm_any(q, EQUATION) && q->primal > FACTOR_IPM_INEXACT * TOL_IPM_PRIMAL && q->primal <= R(0.5) * q->slow;
        q->slow = q->primal;
        return q->stretched;
    }
    return 1;
}

/* Resets the measures of progress. */
static void ipm_forget_progress(ipm_t *q)
{
    q->closed_gaps = 0;
    q->merit = INF;
    q->slope = INF;
    q->primal = INF;
    q->step = R(1);
    q->stiffest = FACTOR_IPM_MOST_STIFFENING;
    q->stretched = 0;
    q->slow = INF;
}

/* Returns 1 if the iterate is the solution; `done` states this for all conditions but the equations. Otherwise the next
 * step may be stretched. */
static int ipm_ends(ipm_t *q, int done, real_t before)
{
    if (done) {
        return !ipm_inexact_equations(q);
    }
    q->stretched = ipm_slow_equations(q, before);
    return 0;
}

/* Returns 1 if the residuals of the rows stop decreasing, as when the rows contradict one another. */
static inline int ipm_stagnates(const ipm_t *q, real_t before)
{
    return q->primal > TOL_IPM_PRIMAL && (q->step < R(0.5) || q->primal > R(0.5) * before);
}

/* Values of crossing: iterate to the solution; iterate until a working set is indicated; the iterations have ended
 * so. */
enum { TO_THE_END = 0, CROSS_OVER = 1, HANDED_OVER = 2 };

/* Returns 1 if the iterate is so close to the solution that it indicates the working set, and if the iterations are to
 * end then. */
static int ipm_hands_over(ipm_t *q)
{
    if (q->crossing == TO_THE_END || q->sides == 0 || q->mu > FACTOR_IPM_HAND_OVER * q->unit ||
        q->primal > FACTOR_IPM_HAND_OVER) {
        return 0;
    }
    q->crossing = HANDED_OVER;
    return 1;
}

/* Judges the present point, whose measures are known, and adapts the regularisations; `changed` becomes 1 if one has
 * changed. Returns 1 if the iterations end here. */
static int ipm_ends_here(solver_t *s, real_t before, real_t gradient_before, int *changed)
{
    ipm_t *q = &s->ipm;
    const real_t merit_before = q->merit;
    int done;
    *changed = ipm_increase_stiffening(q, before);
    if (IPM_CROSSOVER) {
        if (ipm_hands_over(q)) {
            return 1;
        }
    }
    done = ipm_has_converged(s);
    if (q->probing && (q->slope < INF || s->qp.iterations > 20) && ipm_any_violation(s)) {
        return 1;
    }
    *changed |= ipm_limit_stiffening(q, gradient_before) | ipm_reduce_proximal(q, gradient_before);
    done &= !*changed;
    if (NG) {
        done = ipm_ends(q, done, before);
    }
    return done || ipm_suffices(s, merit_before);
}

/* Iterates from the present point. Returns OK, ITERATION_LIMIT, INFEASIBLE or NUMERICAL_FAILURE. */
static status_t ipm_iterate(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int cap = IPM_MAX_ITERATIONS;
    if (!IPM_CROSSOVER && q->warm) {
        cap = IPM_MAX_ITERATIONS / 4;
    }
    ipm_forget_progress(q);
    q->begun = s->qp.iterations;
    for (;;) { /* at most IPM_MAX_ITERATIONS passes in qp_solve */
        const real_t before = q->primal, gradient_before = q->slope;
        int changed;
        ipm_measure(s);
        ipm_cost_gradient(s);
        if (!isfinite(q->mu) || !isfinite(q->primal)) {
            return NUMERICAL_FAILURE;
        }
        if (ipm_ends_here(s, before, gradient_before, &changed)) {
            return OK;
        }
        if (NG) {
            if ((s->qp.iterations >= cap || ipm_stagnates(q, before)) && ipm_infeasible(s)) {
                return INFEASIBLE;
            }
        }
        if (s->qp.iterations >= cap) {
            return ITERATION_LIMIT;
        }
        s->qp.iterations++;
        if ((q->sides > 0 || changed) && !ipm_weigh_and_factorize(s)) {
            return (q->deferred || ipm_small_residuals(q)) ? OK : NUMERICAL_FAILURE; /* OK is checked at the end */
        }
        ipm_step(s);
    }
}
