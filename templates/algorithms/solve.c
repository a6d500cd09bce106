/* SQP to convergence: the steps of the real-time iteration, globalised by a filter line search (Waechter and Biegler
 * 2005, algorithm A) on two measures of a point,
 *
 *     violation = sum of gaps, of the residual of x_0 and of row violations, each in the scale of its state or row,
 *     cost      = cost [if SOFT_ROWS > 0: + penalties of the soft rows l1 v + l2/2 v^2].
 *
 * A full step that is rejected gets one second-order correction. [if NG > 0: If a linearisation is infeasible, its rows
 * are relaxed with the penalty row_weight (elastic QP).] */

/* Number of components of (dx, du) at node k. */
static inline int nz_at(int k)
{
    return (k < N) ? NZ : NX;
}

/* Component i of them. */
static inline real_t *step_at(step_t *d, int k, int i)
{
    return (i < NX) ? &d->dx[k][i] : &d->du[k][i - NX];
}

/* The same component of the plan. */
static inline real_t point_at(const solver_t *s, int k, int i)
{
    return (i < NX) ? s->x[k][i] : s->u[k][i - NX];
}

/* Measures of the present iterate, without derivatives. */
static measures_t measure(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    measures_t at = {R(0), R(0)};
    for (int i = 0; i < NX; i++) {
        if (!is_measured[i] && !is_accumulator[i]) {
            continue;
        }
        at.violation += FABS(s->x[0][i] - s->xhat[i]) / size_or(q->state_scale[i], z_scale[i]);
    }
    for (int k = 0; k < N; k++) {
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            at.violation += FABS(x_next[i] - s->x[k + 1][i]) / size_or(q->state_scale[i], z_scale[i]);
        }
    }
    real_t value[NG];
    if (NG > 0) {
        evaluate_rows(s, value);
    }
    for (int m = 0; m < NG; m++) {
        const real_t v = outside(s, m, value[m]);
        if (row_is_soft(m)) {
            at.cost += soft_penalty(m, v);
            continue;
        }
        at.violation += v / size_or(s->row_scale[row_id(m)], row_magnitude[row_id(m)]);
    }
    at.cost += nodal_cost(s);
    return at;
}

/* Returns to the base, from which the steps of this iteration start. */
static void move_back(solver_t *s)
{
    memcpy(s->x, s->sqp.x, sizeof s->x);
    memcpy(s->u, s->sqp.u, sizeof s->u);
}

/* (x, u) = base + length (dx, du); step becomes what has been added. */
static void move_to_trial(solver_t *s)
{
    sqp_t *q = &s->sqp;
    move_back(s);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            *step_at(&s->step, k, i) = q->length * *step_at(&q->step, k, i);
        }
    }
    take_step(s);
}

/* Raises a scale to a size that is more than twice as large. Returns 1 if it changes. */
static int raise_scale(real_t *scale, real_t size)
{
    if (!(size > R(2) * *scale) || !isfinite(size)) {
        return 0;
    }
    *scale = size;
    return 1;
}

/* Scales of the hard rows: the largest magnitude of the terms of a linearised row and of its finite bounds. Returns 1
 * if one of them changes. */
static int update_row_scales(solver_t *s, const real_t *size)
{
    int grew = 0;
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(m)) {
            continue;
        }
        real_t *scale = &s->row_scale[row_id(m)];
        grew |= raise_scale(scale, row_terms(s, m, size));
        grew |= raise_scale(scale, FABS(row_lower(s, m)));
        grew |= raise_scale(scale, FABS(row_upper(s, m)));
    }
    return grew;
}

static inline const real_t *gradient_of(const solver_t *s, int k)
{
    return (k < N) ? s->node[k].g : s->terminal.g;
}

/* Enlarges the sizes of the states to what a control of its size changes in an interval, and what they have to reach:
 * near 0, magnitudes and steps may be no more than rounding errors. */
static void enlarge_by_reach(const solver_t *s, real_t *size)
{
    real_t u[NU];
    control_sizes(s, u);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NX; i++) {
            for (int j = 0; j < NU; j++) {
                enlarge(&size[i], s->node[k].S[i][NX + j] * u[j]);
            }
        }
    }
    for (int m = 0; m < NG; m++) {
        if (row_is_state(m)) {
            enlarge(&size[row_index(m)], clip(R(0), row_lower(s, m), row_upper(s, m)));
        }
    }
}

/* Scales of states and rows: largest magnitudes over the horizon at the present point and of the present step. They
 * only grow; if one does, the measures of earlier points are not comparable any more, and the filter is cleared.
 * cost_unit is how much the cost may change along the horizon: the largest |g_i| |z_i|, at least that of its scale. */
static void update_scales(solver_t *s)
{
    sqp_t *q = &s->sqp;
    real_t size[NZ] = {0};
    int grew = 0;
    q->cost_unit = cost_size[0];
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            enlarge(&q->cost_unit, gradient_of(s, k)[i] * point_at(s, k, i));
            enlarge(&size[i], point_at(s, k, i));
            enlarge(&size[i], *step_at(&s->step, k, i));
        }
    }
    enlarge_by_reach(s, size);
    for (int i = 0; i < NX; i++) {
        grew |= raise_scale(&q->state_scale[i], size[i]);
    }
    if (HARD_ROWS) {
        grew |= update_row_scales(s, size);
    }
    if (grew) {
        q->entries = 0;
        q->most_violation = INF;
    }
}

#if CURVED
#include "algorithms/convexify.c"

#endif
/* Saves the result of a QP. */
static void put_step_aside(solver_t *s)
{
    s->sqp.step = s->step;
#if STAGE_MULTIPLIERS
    for (int k = 0; k <= N; k++) {
        multiplier_of_qp(s, k, s->sqp.lam[k]);
    }
#elif CURVED
    multipliers_of_qp(s, s->sqp.lam);
#endif
}

/* Second-order correction: the constraints of the QP take the values at base + step, where s is. As the step satisfies
 * A dx + B du + b = dx_{k+1}, the b are the sums of both gaps; rows are h(x + dx, u + du) - J (dx, du). */
static void correct_constraints(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        node_t *node = &s->node[k];
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            node->b[i] += x_next[i] - s->x[k + 1][i];
        }
        real_t J[NH][NZ];
        PATH_ROWS(s, k, node->h, J);
        for (int i = 0; i < NH; i++) {
            for (int j = 0; j < NZ; j++) {
                node->h[i] -= node->J[i][j] * *step_at(&s->sqp.step, k, j);
            }
        }
    }
    real_t J[NH_N][NX];
    TERMINAL_ROWS(s, s->terminal.h, J);
    for (int i = 0; i < NH_N; i++) {
        for (int j = 0; j < NX; j++) {
            s->terminal.h[i] -= s->terminal.J[i][j] * s->sqp.step.dx[N][j];
        }
    }
    real_t J_0[NE][NX], J_N[NE][NX];
    COUPLED_ROWS(s, s->coupled.r, J_0, J_N);
    for (int i = 0; i < NE; i++) {
        for (int j = 0; j < NX; j++) {
            s->coupled.r[i] -=
                s->coupled.J_0[i][j] * s->sqp.step.dx[0][j] + s->coupled.J_N[i][j] * s->sqp.step.dx[N][j];
        }
    }
}

/* Returns 1 if a point is no worse than the filter allows. */
static int passes_filter(const sqp_t *q, const measures_t *at)
{
    int ok = at->violation <= q->most_violation && at->cost < INF;
    for (int n = 0; n < q->entries; n++) {
        ok &= at->violation < q->filter[n].violation || at->cost < q->filter[n].cost;
    }
    return ok;
}

/* The filter rejects from now on what is not better than the base, up to rounding of the violation. Entries that it
 * rejects leave; if there are FILTER others, the one with the largest violation gives way. */
static void extend_filter(sqp_t *q)
{
    const measures_t added = {(R(1) - FACTOR_FILTER_SHARE) * q->base.violation + TOL_MERIT_ROUNDING,
        q->base.cost - FACTOR_FILTER_SHARE * q->base.violation * q->cost_scale};
    int kept = 0, worst = 0;
    for (int n = 0; n < q->entries; n++) {
        if (q->filter[n].violation < added.violation || q->filter[n].cost < added.cost) {
            q->filter[kept] = q->filter[n];
            worst = (q->filter[kept].violation > q->filter[worst].violation) ? kept : worst;
            kept++;
        }
    }
    q->filter[(kept < FILTER) ? kept : worst] = added;
    q->entries = (kept < FILTER) ? kept + 1 : FILTER;
}

/* Returns 1 if the present point is accepted after the step. While feasibility is restored, the violation has to
 * decrease by its share of `gain`, what the linearised rows and gaps promise. Otherwise the filter has to be passed,
 * the violation must not become more than ten times as large, and the cost has to fall if the step is expected to
 * reduce it by more than it violates. */
static int accepts(solver_t *s)
{
    sqp_t *q = &s->sqp;
    const measures_t at = measure(s), *base = &q->base;
    const real_t rounding = TOL_MERIT_ROUNDING * (FABS(base->cost) + q->cost_scale);
    const real_t share = FACTOR_FILTER_SHARE * base->violation, descent = -q->slope / q->cost_scale;
    if (q->restoring) {
        return at.cost < INF && at.violation <= base->violation - FACTOR_SQP_ARMIJO * q->length * q->gain;
    }
    if (!passes_filter(q, &at) ||
        at.violation > FACTOR_SQP_MOST_GROWTH * base->violation + FACTOR_SQP_SMALL_VIOLATION) {
        return 0;
    }
    if (descent > R(0) && base->violation <= FACTOR_FILTER_DESCENT * q->most_violation &&
        q->length * descent * descent > base->violation) {
        return at.cost <= base->cost + FACTOR_SQP_ARMIJO * q->length * q->slope + rounding;
    }
    if (at.violation > base->violation - share + TOL_MERIT_ROUNDING &&
        at.cost > base->cost - share * q->cost_scale + rounding) {
        return 0;
    }
    extend_filter(q);
    return 1;
}

/* Solves the QP with its rows relaxed. */
static status_t run_relaxed_qp(solver_t *s)
{
    s->relaxation = s->sqp.row_weight * s->sqp.cost_unit;
    const status_t status = run_qp(s);
    s->relaxation = INF;
    return status;
}

/* Returns 1 if the step of the same QP with corrected constraints is accepted. */
static int accepts_corrected(solver_t *s)
{
    int accepted = 0;
    correct_constraints(s);
    move_back(s);
    if (CURVED) {
        push_to_bounds(s);
    }
    condense_rows(s);
    status_t status;
    if (HARD_ROWS && s->sqp.elastic) {
        status = run_relaxed_qp(s);
    } else {
        status = run_qp(s);
    }
    if (status == OK && step_is_finite(s)) {
        take_step(s);
        accepted = accepts(s);
    }
    if (accepted) {
        put_step_aside(s);
    }
    if (CURVED) {
        restore_gradients(s);
    }
    return accepted;
}

/* Backtracking. If the full step is rejected, one second-order correction is tried. */
static status_t line_search(solver_t *s)
{
    sqp_t *q = &s->sqp;
    for (int trial = 0; trial < MAX_TRIALS; trial++) {
        move_to_trial(s);
        if (accepts(s)) {
            return OK;
        }
        if (q->length == R(1) && accepts_corrected(s)) { /* exactly, as powers of 2 are */
            return OK;
        }
        q->length *= R(0.5);
    }
    move_back(s);
    return STALLED;
}

#if HARD_ROWS
/* Solves the QP of the present linearisation. If it is infeasible, or has been given up, its rows are relaxed with the
 * penalty row_weight. */
static status_t solve_qp(solver_t *s)
{
    const status_t status = run_qp(s);
    s->sqp.elastic = is_given_up(status);
    return s->sqp.elastic ? run_relaxed_qp(s) : status;
}
#else
static status_t solve_qp(solver_t *s)
{
    return run_qp(s);
}
#endif

/* Directional derivative g' (dx, du) of the cost along the step[if SOFT_ROWS > 0:; the penalties change as in the
 * QP]. */
static real_t slope_of(solver_t *s)
{
    real_t slope = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            slope += gradient_of(s, k)[i] * *step_at(&s->step, k, i);
        }
    }
    if (SOFT_ROWS) {
        real_t value[NG];
        if (NG > 0) {
            evaluate_rows(s, value);
        }
        for (int m = 0; m < NG; m++) {
            if (row_is_soft(m)) {
                slope += soft_penalty(m, FABS(row_excess(s, m, R(0))));
                slope -= soft_penalty(m, outside(s, m, value[m]));
            }
        }
    }
    return slope;
}

/* Moves a multiplier towards that of the QP, all the way if it is not finite. */
static inline void approach(real_t *a, real_t b, real_t length)
{
    *a = (length < R(1) && isfinite(*a)) ? *a + length * (b - *a) : b;
}

/* Multipliers after a step. [if ELASTIC: Those of an elastic QP are those of its penalty: nothing is known.] [if
 * LAGRANGIAN || TWO_HESSIANS: Where the Hessian depends on them, they move towards those of the QP only as far as the
 * step went: after a short step, those of the QP may be as far off as the step.] [if !STAGE_MULTIPLIERS: With states
 * eliminated, lam follows from the gradient of the QP.] */
static void take_multipliers(solver_t *s)
{
    if (HARD_ROWS) {
        if (s->sqp.elastic) {
            forget_multipliers(s);
            return;
        }
    }
    if (CURVED || LAGRANGIAN || STAGE_MULTIPLIERS) {
        const sqp_t *q = &s->sqp;
        for (int k = 0; k < N; k++) {
            for (int j = 0; j < NU; j++) {
                approach(&s->mu_u[k][j], q->step.mult_u[k][j], q->length);
            }
        }
        for (int m = 0; m < NG; m++) {
            approach(&s->mult[m], q->step.mult[m], q->length);
        }
    } else {
        s->step = s->sqp.step;
        copy_multipliers(s);
    }
    if (HAS_ADJOINT_STEP && !CURVED) {
        (void)recover_multipliers(s); /* convergence is judged by the residuals of the problem itself */
    } else {
        for (int k = 0; k <= N; k++) {
            for (int i = 0; i < NX; i++) {
                approach(&s->lam[k][i], s->sqp.lam[k][i], s->sqp.length);
            }
        }
    }
}

#if HARD_ROWS
/* By how much the full step reduces the violation according to the linearisation. */
static real_t gain_of(const solver_t *s)
{
    real_t gain = s->sqp.base.violation;
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(m)) {
            continue;
        }
        gain -= FABS(row_excess(s, m, R(0))) / size_or(s->row_scale[row_id(m)], row_magnitude[row_id(m)]);
    }
    return gain;
}
#else
static real_t gain_of(const solver_t *s)
{
    return s->sqp.base.violation;
}
#endif

/* The line search; if no step passes the filter, feasibility is restored: until the filter is passed again, steps have
 * to reduce the violation alone. */
static status_t search(solver_t *s)
{
    sqp_t *q = &s->sqp;
    q->slope = slope_of(s);
    q->gain = gain_of(s);
    enlarge(&q->cost_scale, q->slope);
    q->restoring = q->elastic || (q->restoring && !passes_filter(q, &q->base));
    if (!q->restoring) {
        q->length = R(1);
        const status_t status = line_search(s);
        if (status == OK || !(q->base.violation > FACTOR_SQP_AT_REST * TOL_MERIT_ROUNDING)) {
            return status;
        }
        extend_filter(q);
        q->restoring = 1;
    }
    q->length = R(1);
    return (q->gain > FACTOR_SQP_HOPELESS * q->base.violation) ? line_search(s) : STALLED;
}

/* Away from feasibility, multipliers beyond what the cost can explain are scaled down: their Hessian would hide the
 * cost from the next QP, whose multipliers would be larger still. */
static void bound_multipliers(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    const real_t most = FACTOR_SQP_EXPLAINED * ((q->cost_scale > q->cost_unit) ? q->cost_scale : q->cost_unit);
    real_t largest = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&largest, s->lam[k][i] * size_or(q->state_scale[i], z_scale[i]));
        }
    }
    if (!(q->base.violation > FACTOR_SQP_AWAY) || largest <= most) {
        return;
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->lam[k][i] *= most / largest;
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->mu_u[k][j] *= most / largest;
        }
    }
    for (int m = 0; m < NG; m++) {
        s->mult[m] *= most / largest;
    }
}

/* The shift of the next Hessian: more after a step that had to be shortened. Returns 1 if the same point may be tried
 * again with more of it. */
static int adapt_shifts(solver_t *s, status_t status)
{
    curved_t *c = &s->curved;
    const real_t length = (status == STALLED) ? R(0) : s->sqp.length;
    c->proximal = clip(
        c->proximal * ((length < R(1)) ? FACTOR_SQP_DAMP : R(1) / FACTOR_SQP_DAMP), FACTOR_SQP_LEAST_PROXIMAL, R(1));
    if (length < FACTOR_SQP_SHORT_STEP) {
        const real_t growth = (length < FACTOR_SQP_VERY_SHORT_STEP) ? FACTOR_SQP_MUCH_MORE : FACTOR_SQP_DAMP;
        c->damping = (c->damping > R(0)) ? growth * c->damping : FACTOR_SQP_FIRST_DAMPING;
    } else if (length >= R(1)) {
        c->damping = (c->damping > FACTOR_SQP_LEAST_DAMPING) ? c->damping / FACTOR_SQP_DAMP : R(0);
    }
    return status == STALLED && c->damping < FACTOR_SQP_MOST_DAMPING;
}

/* The QP of the present linearisation. */
static status_t form_qp(solver_t *s)
{
    if (CURVED) {
        if (!convexify(s)) {
            return NUMERICAL_FAILURE;
        }
        push_to_bounds(s);
    }
    return condense_prepare(s);
}

/* One globalised iteration at a point that has been linearised. */
static status_t sqp_iteration(solver_t *s)
{
    sqp_t *q = &s->sqp;
    update_scales(s); /* a relaxed QP needs them */
    status_t status = form_qp(s);
    status = (status == OK) ? solve_qp(s) : status;
    if (status != OK) {
        if (CURVED) {
            restore_gradients(s);
            if (s->curved.damping < R(1)) { /* a QP with more curvature may have a solution */
                s->curved.damping =
                    (s->curved.damping > R(0)) ? FACTOR_SQP_MUCH_MORE * s->curved.damping : FACTOR_SQP_FIRST_DAMPING;
                q->length = R(0);
                q->elastic = 0;
                return OK;
            }
        }
        return (status == ITERATION_LIMIT || status == STALLED) ? SUBPROBLEM_FAILED : status;
    }
    put_step_aside(s);
#if CURVED
    restore_gradients(s);
#endif
    update_scales(s);
    q->base = measure(s);
    if (!step_is_finite(s) || !isfinite(q->base.violation) || !isfinite(q->base.cost)) {
        return NUMERICAL_FAILURE;
    }
    if (!(q->most_violation < INF)) {
        q->most_violation = FACTOR_FILTER_LIMIT * ((q->base.violation > R(1)) ? q->base.violation : R(1));
    }
    memcpy(q->x, s->x, sizeof s->x);
    memcpy(q->u, s->u, sizeof s->u);
    status = search(s);
    q->slow = q->elastic && !(q->gain > FACTOR_SQP_LITTLE_PROGRESS * q->base.violation);
    if (CURVED) {
        if (adapt_shifts(s, status)) {
            return OK;
        }
    }
    if (CURVED && status == OK && !(s->curved.damping < FACTOR_SQP_ENDLESS_DAMPING)) {
        return SUBPROBLEM_FAILED; /* steps that become ever shorter lead nowhere: another start may */
    }
    if (status == OK) {
        take_multipliers(s);
        if (CURVED) {
            bound_multipliers(s);
        }
    }
    return status;
}

/* KKT residuals from the linearisation of the last prepare. Returns 1 if all are at most tol, relative to their
 * terms. */
static int kkt_converged(solver_t *s, real_t tol)
{
    kkt_t *kkt = &s->kkt;
    memset(kkt, 0, sizeof *kkt);
    for (int k = 0; k < N; k++) {
        kkt_node(s, k, &s->node[k], kkt);
    }
    kkt_terminal(s, &s->terminal, kkt);
    kkt_rows(s, kkt);
    return kkt->relative <= tol;
}

/* Starts from the plan with an empty filter and unknown scales. */
static void start_search(solver_t *s, int attempts)
{
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    memset(&s->sqp, 0, sizeof s->sqp);
    memset(&s->step, 0, sizeof s->step);
    memset(s->row_scale, 0, sizeof s->row_scale);
    s->row_residual = R(0);
    s->sqp.attempts = (int32_t)attempts;
    s->curved.proximal = FACTOR_SQP_FIRST_PROXIMAL;
    s->curved.damping = (attempts % 2 == 0) ? R(0) : FACTOR_SQP_SECOND_START;
    s->sqp.most_violation = s->sqp.base.violation = INF;
    s->sqp.row_weight = FACTOR_SQP_ELASTIC_WEIGHT;
}

/* Returns 1 if the cost falls without limit: far beyond its scale, along a variable that is far beyond its own. */
static int runs_away(const solver_t *s)
{
    if (!(s->sqp.base.cost < -FACTOR_SQP_ENDLESS * cost_size[0])) {
        return 0;
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            if (FABS(point_at(s, k, i)) > FACTOR_SQP_ENDLESS * z_scale[i]) {
                return 1;
            }
        }
    }
    return 0;
}

/* Iterations until stats.sqp_iterations = last. */
static status_t iterate(solver_t *s, real_t tol, int last)
{
    sqp_t *q = &s->sqp;
    for (;; s->stats.sqp_iterations++) {
        if (CURVED) {
            expand_curved(s);
        } else {
            evaluate_here(s);
        }
        if (kkt_converged(s, tol)) {
            return OK;
        }
        if (s->stats.sqp_iterations >= last) {
            return ITERATION_LIMIT;
        }
        status_t status = sqp_iteration(s);
        if (status == OK && runs_away(s)) {
            return STALLED;
        }
        if (HARD_ROWS) {
            if (q->elastic && (status == STALLED || (status == OK && q->slow))) {
                status = (q->row_weight < FACTOR_SQP_MOST_ELASTIC_WEIGHT) ? OK : INFEASIBLE;
                q->row_weight *= FACTOR_PENALTY_RATIO;
            }
        }
        if (status != OK) {
            return status;
        }
    }
}

/* A new start after a search that has ended where the constraints cannot be satisfied: the states to which the controls
 * of the plan lead, and the next time those to which the reference controls do. */
static void start_elsewhere(solver_t *s)
{
    if (s->sqp.attempts > 0) {
        forget_plan(s);
    }
    memcpy(s->x[0], s->xhat, sizeof s->xhat);
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
    forget_multipliers(s);
    const int32_t infeasible = s->sqp.infeasible;
    start_search(s, s->sqp.attempts + 1);
    s->sqp.infeasible = infeasible;
}

static status_t solve_here(solver_t *s, real_t tol, int last)
{
    for (;;) {
        const status_t status = iterate(s, tol, last);
        const int ends = status == OK || status == ITERATION_LIMIT ||
            (status == STALLED && !(s->sqp.base.violation > FACTOR_SQP_AWAY));
        s->sqp.infeasible |= status == INFEASIBLE;
        if (ends || s->sqp.attempts == MAX_ATTEMPTS || s->stats.sqp_iterations++ >= last) {
            if (HARD_ROWS && !ends && s->sqp.infeasible) {
                return INFEASIBLE;
            }
            return status;
        }
        start_elsewhere(s);
    }
}

/* Returns 1 if all multipliers that the first Hessian may read are finite. */
static int multipliers_are_finite(solver_t *s)
{
    int finite = all_finite(s->lam[0], (N + 1) * NX);
    for (int m = 0; m < NG; m++) {
        finite &= isfinite(s->mult[m]) != 0;
    }
    return finite;
}

/* Begins with the plan and this state. Returns 0 if the state is not finite. */
static int take_over(solver_t *s, const real_t xhat[NX])
{
    s->stats.sqp_iterations = 0;
    if (!take_state(s, xhat)) {
        return 0;
    }
    for (int f = 0; f < NF; f++) {
        const real_t guess = xhat[free_state[f]];
        s->x[0][free_state[f]] = isfinite(guess) ? guess : s->x[0][free_state[f]];
    }
    forget_violation(s);
    s->samples += (s->samples < MANY);
    if ((CURVED || LAGRANGIAN) && !multipliers_are_finite(s)) {
        forget_multipliers(s);
    }
    start_search(s, 0);
    return 1;
}

/* Starts from the plan, of which it gives up what is not finite, or resumes the last search. */
status_t API(solve)(solver_t *s, const real_t xhat[NX], real_t tol, int max_iterations)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    s->prepared = 0;
    s->unsettled = 0;
    s->fresh = 0; /* its plan is no first plan */
    before_solve(s);
    if (!(tol > R(0)) || max_iterations < 0) {
        return finish(s, BAD_ARGUMENT);
    }
    if (!s->sqp.resumes && !take_over(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    s->curved.in_solve = 1;
    status = solve_here(s, tol, max_iterations);
    s->curved.in_solve = 0;
    s->sqp.resumes = 0;
    s->sqp.elastic = 0;
    if (HARD_ROWS && status == INFEASIBLE) {
        name_violation(s);
    }
    return finish(s, status);
}
