/* SQP to convergence: the steps of the real-time iteration, globalised by a filter line search (Waechter and Biegler
 * 2005, algorithm A) on two measures of a point,
 *
 *     violation = sum of gaps, of the residual of x_0 and of row violations, each in the scale of its state or row,
 *     cost      = cost + penalties of the soft rows l1 v + l2/2 v^2.
 *
 * A full step that is rejected gets one second-order correction. If a linearisation is infeasible, its rows are relaxed
 * with the penalty row_weight (elastic QP). */

typedef struct {
    real_t violation, cost;
} measures_t;

/* A scale of 0 is unknown and counts as 1. */
static inline real_t scale_of(real_t scale)
{
    return (scale > R(0)) ? scale : R(1);
}

#if HARD_ROWS
/* Adds what a violation v >= 0 of row m costs, or its share of the violation. */
static void add_row(const solver_t *s, int m, real_t v, measures_t *at)
{
#if SOFT_ROWS
    if (IS_SOFT(m)) {
        at->cost += soft_penalty(m, v);
        return;
    }
#endif
    at->violation += v / scale_of(s->sqp.row_scale[row_id[m]]);
}
#endif

/* Measures of the present iterate, without derivatives. */
static measures_t measure(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    measures_t at = {R(0), R(0)};
    for (int i = 0; i < NX; i++) {
#if NF
        if (!is_measured[i] && !is_accumulator[i]) {
            continue;
        }
#endif
        at.violation += FABS(s->x[0][i] - s->xhat[i]) / scale_of(q->state_scale[i]);
    }
    for (int k = 0; k < N; k++) {
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            at.violation += FABS(x_next[i] - s->x[k + 1][i]) / scale_of(q->state_scale[i]);
        }
    }
#if NG
    real_t value[NG];
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t v = FABS(value[m] - clip(value[m], ROW_LOWER(s, m), ROW_UPPER(s, m)));
#if HARD_ROWS
        add_row(s, m, v, &at);
#else
        at.cost += soft_penalty(m, v);
#endif
    }
#endif
    at.cost += nodal_cost(s);
    return at;
}

/* Saves the result of a QP. */
static void put_step_aside(solver_t *s)
{
    s->sqp.step = s->step;
#if STAGE_MULTIPLIERS
    for (int k = 0; k <= N; k++) {
        multiplier_of_qp(s, k, s->sqp.lam[k]);
    }
#endif
}

/* Returns to the base, from which the steps of this iteration start. */
static void move_back(solver_t *s)
{
    memcpy(s->x, s->sqp.x, sizeof s->x);
    memcpy(s->u, s->sqp.u, sizeof s->u);
}

/* (x, u) = base + alpha (dx, du); step becomes what has been added. */
static void move_to(solver_t *s, real_t alpha)
{
    const sqp_t *q = &s->sqp;
    move_back(s);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->step.dx[k][i] = alpha * q->step.dx[k][i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->step.du[k][j] = alpha * q->step.du[k][j];
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

#if HARD_ROWS
/* Scales of the hard rows: the largest magnitude of the terms of a linearised row and of its finite bounds. Returns 1 if
 * one of them changes. */
static int update_row_scales(solver_t *s, const real_t *size)
{
    int changed = 0;
    for (int m = 0; m < NG; m++) {
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        const real_t lower = FABS(ROW_LOWER(s, m)), upper = FABS(ROW_UPPER(s, m));
        real_t terms = row_terms(s, m, size);
        terms = (lower > terms && isfinite(lower)) ? lower : terms;
        terms = (upper > terms && isfinite(upper)) ? upper : terms;
        changed |= raise_scale(&s->sqp.row_scale[row_id[m]], terms);
    }
    return changed;
}
#endif

/* Scales of states and rows: largest magnitudes over the horizon at the present point. They only grow; if one does, the
 * measures of earlier points are not comparable any more, and the filter is cleared. */
static void update_scales(solver_t *s)
{
    sqp_t *q = &s->sqp;
    real_t size[NZ] = {0};
    int changed = 0;
    for (int k = 0; k < N; k++) {
        widen(size, s->x[k], NX);
        widen(size + NX, s->u[k], NU);
    }
    widen(size, s->x[N], NX);
    widen(size, s->xhat, NX);
    for (int i = 0; i < NX; i++) {
        changed |= raise_scale(&q->state_scale[i], size[i]);
    }
#if HARD_ROWS
    changed |= update_row_scales(s, size);
#endif
    if (changed) {
        q->entries = 0;
        q->most_violation = INF;
    }
}

static inline const real_t *gradient_of(const solver_t *s, int k)
{
    return (k < N) ? s->node[k].g : s->terminal.g;
}

/* Directional derivative of the cost, g' (dx, du). */
static real_t cost_slope(const solver_t *s)
{
    real_t sum = R(0);
    for (int k = 0; k <= N; k++) {
        const real_t *g = gradient_of(s, k);
        for (int i = 0; i < NX; i++) {
            sum += g[i] * s->step.dx[k][i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            sum += g[NX + j] * s->step.du[k][j];
        }
    }
    return sum;
}

/* Second-order correction: the constraints of the QP take the values at base + step, where s is:
 * b = Phi(x + dx, u + du) - x_{k+1} - A dx - B du, and the same for the rows. */
static void correct_constraints(solver_t *s)
{
    const step_t *d = &s->sqp.step;
    const real_t none[NX] = {0};
    for (int k = 0; k < N; k++) {
        node_t *node = &s->node[k];
        real_t y[NX], x_next[NX];
        interval_value(s, k, x_next);
        memcpy(node->b, none, sizeof y);
        STATE_STEP(node, d->dx[k], d->du[k], y);
        for (int i = 0; i < NX; i++) {
            node->b[i] = x_next[i] - s->x[k + 1][i] + d->dx[k + 1][i] - y[i];
        }
#if NH
        real_t J[NH * NZ];
        PATH_ROWS(s, k, node->h, J);
        for (int i = 0; i < NH; i++) {
            for (int j = 0; j < NZ; j++) {
                node->h[i] -= node->J[i][j] * ((j < NX) ? d->dx[k][j] : d->du[k][j - NX]);
            }
        }
#endif
    }
#if NH_N
    real_t J[NH_N * NX];
    TERMINAL_ROWS(s, s->terminal.h, J);
    for (int i = 0; i < NH_N; i++) {
        for (int j = 0; j < NX; j++) {
            s->terminal.h[i] -= s->terminal.J[i][j] * d->dx[N][j];
        }
    }
#endif
#if NE
    real_t J_0[NE * NX], J_N[NE * NX];
    COUPLED_ROWS(s, s->coupled.r, J_0, J_N);
    for (int i = 0; i < NE; i++) {
        for (int j = 0; j < NX; j++) {
            s->coupled.r[i] -= s->coupled.J_0[i][j] * d->dx[0][j] + s->coupled.J_N[i][j] * d->dx[N][j];
        }
    }
#endif
}

/* Returns 1 if a point is no worse than the filter allows. */
static int passes_filter(const sqp_t *q, const measures_t *at)
{
    if (!(at->violation <= q->most_violation && at->cost < INF)) {
        return 0;
    }
    for (int n = 0; n < q->entries; n++) {
        if (at->violation >= q->filter_violation[n] && at->cost >= q->filter_cost[n]) {
            return 0;
        }
    }
    return 1;
}

/* The filter rejects from now on what is not better than this point; the last of FILTER entries gives way. */
static void extend_filter(sqp_t *q, const measures_t *start)
{
    const int n = (q->entries < FILTER) ? q->entries++ : FILTER - 1;
    q->filter_violation[n] = (R(1) - R(1e-5)) * start->violation;
    q->filter_cost[n] = start->cost - R(1e-5) * start->violation * q->cost_scale;
}

/* Returns 1 if a step is expected to reduce the cost by more than it violates: it has to reduce the cost. */
static int is_descent(const sqp_t *q, const measures_t *start, real_t alpha, real_t slope)
{
    const real_t descent = -slope / q->cost_scale;
    return descent > R(0) && start->violation <= q->small_violation && alpha * descent * descent > start->violation;
}

/* Returns 1 if the present point is accepted after a step of length alpha; while feasibility is restored, if the
 * violation decreases by its share of `gain`, what the linearised rows and gaps promise. */
static int accepts(solver_t *s, const measures_t *start, real_t alpha, real_t slope, real_t gain)
{
    sqp_t *q = &s->sqp;
    const measures_t at = measure(s);
    const real_t rounding = TOL_MERIT_ROUNDING * (FABS(start->cost) + q->cost_scale);
    if (q->restoring) {
        return at.cost < INF && at.violation <= start->violation - R(1e-4) * alpha * gain;
    }
    if (!passes_filter(q, &at) || (alpha > R(1) && at.violation > R(100) * q->small_violation)) {
        return 0;
    }
    if (is_descent(q, start, alpha, slope)) {
        return at.cost <= start->cost + R(1e-4) * alpha * slope + rounding;
    }
    if (at.violation <= (R(1) - R(1e-5)) * start->violation + TOL_MERIT_ROUNDING ||
        at.cost <= start->cost - R(1e-5) * start->violation * q->cost_scale + rounding) {
        extend_filter(q, start);
        return 1;
    }
    return 0;
}

/* Returns 1 if the step of the same QP with corrected constraints is accepted. */
static int accepts_corrected(solver_t *s, const measures_t *start, real_t slope, real_t gain)
{
    correct_constraints(s);
    move_back(s);
    condense_rows(s);
    if (run_qp(s) != OK || !step_is_finite(s)) {
        return 0;
    }
    take_step(s);
    if (!accepts(s, start, R(1), slope, gain)) {
        return 0;
    }
    put_step_aside(s);
    return 1;
}

/* Backtracking. If the full step is rejected, one second-order correction is tried. */
static status_t line_search(solver_t *s, const measures_t *start, real_t slope, real_t gain)
{
    sqp_t *q = &s->sqp;
    for (int trial = 0; trial < MAX_TRIALS; trial++) {
        move_to(s, q->length);
        if (accepts(s, start, q->length, slope, gain)) {
            return OK;
        }
        if (q->length == R(1) && accepts_corrected(s, start, slope, gain)) { /* exactly, as powers of 2 are */
            return OK;
        }
        q->length *= R(0.5);
    }
    move_back(s);
    return STALLED;
}

#if HARD_ROWS
/* How much the cost may change along the horizon, at least 1: the largest |g_i| |z_i|, and what the multipliers of rows
 * say about rows in their scale. */
static real_t cost_unit(const solver_t *s)
{
    real_t largest = R(0);
    for (int k = 0; k <= N; k++) {
        const real_t *g = gradient_of(s, k);
        for (int i = 0; i < NX; i++) {
            enlarge(&largest, g[i] * s->x[k][i]);
        }
        for (int j = 0; k < N && j < NU; j++) {
            enlarge(&largest, g[NX + j] * s->u[k][j]);
        }
    }
    for (int m = 0; m < NG; m++) {
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        enlarge(&largest, ROW_MULTIPLIER(s, m) * scale_of(s->sqp.row_scale[row_id[m]]));
    }
    return (largest > R(1)) ? largest : R(1);
}

/* Solves the QP of the present linearisation. If it is infeasible, or has been given up, its rows are relaxed with the
 * penalty row_weight. */
static status_t solve_qp(solver_t *s)
{
    status_t status = run_qp(s);
    s->sqp.elastic = status == INFEASIBLE || status == ITERATION_LIMIT || status == STALLED;
    if (s->sqp.elastic) {
        s->relaxation = s->sqp.row_weight * cost_unit(s);
        status = run_qp(s);
        s->relaxation = INF;
    }
    return status;
}
#else
static status_t solve_qp(solver_t *s)
{
    return run_qp(s);
}
#endif

/* Directional derivative of the cost along the step of the QP; the penalties change as in the QP. */
static real_t slope_of(const solver_t *s)
{
    real_t slope = cost_slope(s);
#if SOFT_ROWS
    real_t value[NG];
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (IS_SOFT(m)) {
            slope += soft_penalty(m, FABS(row_excess(s, m, R(0))));
            slope -= soft_penalty(m, FABS(value[m] - clip(value[m], ROW_LOWER(s, m), ROW_UPPER(s, m))));
        }
    }
#endif
    return slope;
}

/* Moves a multiplier towards that of the QP, all the way if it is not finite. */
static inline void approach(real_t *a, real_t b, real_t length)
{
    *a = (length < R(1) && isfinite(*a)) ? *a + length * (b - *a) : b;
}

/* Multipliers after a step, towards those of the QP as far as the step went: after a short step, those of the QP may be
 * as far off as the step. Those of an elastic QP are those of its penalty: nothing is known. With states eliminated, lam
 * follows from the gradient of the QP at the end of the step. */
static void take_multipliers(solver_t *s)
{
    const sqp_t *q = &s->sqp;
#if HARD_ROWS
    if (s->sqp.elastic) {
        forget_multipliers(s);
        return;
    }
#endif
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            approach(&s->mu_u[k][j], q->step.mult_u[k][j], q->length);
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        approach(&ROW_MULTIPLIER(s, m), q->step.mult[m], q->length);
    }
#endif
#if HAS_ADJOINT_STEP
    (void)recover_multipliers(s); /* convergence is judged by the residuals of the problem itself */
#else
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            approach(&s->lam[k][i], q->lam[k][i], q->length);
        }
    }
#endif
}

#if HARD_ROWS
/* By how much the full step reduces the violation according to the linearisation. */
static real_t gain_of(const solver_t *s, const measures_t *start)
{
    real_t left = R(0);
    for (int m = 0; m < NG; m++) {
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        left += FABS(row_excess(s, m, R(0))) / scale_of(s->sqp.row_scale[row_id[m]]);
    }
    return start->violation - left;
}
#else
static real_t gain_of(const measures_t *start)
{
    return start->violation;
}
#endif

#include "algorithms/accelerate.c"

/* The line search; if no step passes the filter, feasibility is restored: until the filter is passed again, steps have
 * to reduce the violation alone. */
static status_t search(solver_t *s, const measures_t *start)
{
    sqp_t *q = &s->sqp;
    const real_t slope = slope_of(s);
#if HARD_ROWS
    const real_t gain = gain_of(s, start);
#else
    const real_t gain = gain_of(start);
#endif
    enlarge(&q->cost_scale, slope);
    q->restoring = q->elastic || (q->restoring && !passes_filter(q, start));
    if (q->restoring) {
        q->length = R(1);
    } else {
#if !ACCELERATE
        update_trend(s);
        remember_last(s);
#else
        if (takes_accelerated(s, start, gain)) {
            q->length = R(1);
            return OK;
        }
#endif
        choose_length(q);
        const status_t status = line_search(s, start, slope, gain);
        if (status == OK || !(start->violation > R(16) * TOL_MERIT_ROUNDING)) {
            return status;
        }
        extend_filter(q, start);
        q->restoring = 1;
        q->length = R(1);
    }
    if (!(gain > R(1e-8) * start->violation)) {
        return STALLED;
    }
    return line_search(s, start, slope, gain);
}

/* One globalised iteration after prepare_here(). */
static status_t sqp_iteration(solver_t *s)
{
    sqp_t *q = &s->sqp;
    update_scales(s); /* a relaxed QP needs them */
    status_t status = solve_qp(s);
    if (status != OK) {
        return (status == ITERATION_LIMIT || status == STALLED) ? SUBPROBLEM_FAILED : status;
    }
    if (!step_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
#if ACCELERATE
    if (watch(s)) {
        return OK;
    }
#endif
    memcpy(q->x, s->x, sizeof s->x);
    memcpy(q->u, s->u, sizeof s->u);
    put_step_aside(s);
    move_to(s, R(1));
    update_scales(s);
    move_back(s);
    const measures_t start = measure(s);
#if HARD_ROWS
    q->slow = q->elastic && start.violation > R(0.999) * q->violation;
#endif
    q->violation = start.violation;
    if (!isfinite(start.violation) || !isfinite(start.cost)) {
        return NUMERICAL_FAILURE;
    }
    if (!(q->most_violation < INF)) {
        q->most_violation = R(1e4) * ((start.violation > R(1)) ? start.violation : R(1));
        q->small_violation = R(1e-4) * ((start.violation > R(1)) ? start.violation : R(1));
    }
    status = search(s, &start);
    if (q->length < R(1) || q->restoring) {
        q->points = 0; /* steps from points far away say nothing */
#if ACCELERATE
        q->watched = 0;
#endif
    }
    q->caution = (q->length < R(1)) ? R(4) * q->caution : R(0.5) * q->caution;
    q->caution = clip(q->caution, R(1.0625), R(64));
    if (status == OK) {
        take_multipliers(s);
    }
    return status;
}

/* KKT residuals from the linearisation of the last prepare. Returns 1 if all are at most tol, relative to their terms. */
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

#if HARD_ROWS
/* Returns 1 if the last QP was elastic and its step is at most tol, or the last step hardly reduced the violation: at this
 * penalty the rows cannot be satisfied near this point. */
static int stuck_infeasible(const solver_t *s, real_t tol)
{
    const step_t *d = &s->sqp.step;
    real_t step = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&step, d->dx[k][i]);
        }
        for (int j = 0; k < N && j < NU; j++) {
            enlarge(&step, d->du[k][j]);
        }
    }
    return s->sqp.elastic && (step <= tol || s->sqp.slow);
}
#endif

/* An empty filter, unknown scales. */
static void start_search(solver_t *s)
{
    memset(&s->sqp, 0, sizeof s->sqp);
    memset(&s->step, 0, sizeof s->step);
    s->sqp.in_solve = 1;
    s->sqp.caution = R(1.0625);
    s->sqp.most_violation = INF;
#if HARD_ROWS
    s->sqp.row_weight = R(1000);
#endif
}

/* Iterations until stats.sqp_iterations = last. If the search is resumed, the present point has been linearised. */
static status_t iterate(solver_t *s, real_t tol, int last)
{
    sqp_t *q = &s->sqp;
    for (;; s->stats.sqp_iterations++) {
        if (!q->resumes) {
            const status_t prepared = prepare_here(s);
            q->prepared = (int32_t)prepared;
        }
        q->resumes = 0;
        if (kkt_converged(s, tol)) {
            return OK;
        }
        if (s->stats.sqp_iterations >= last) {
            return ITERATION_LIMIT;
        }
        const status_t status = (q->prepared == (int32_t)OK) ? sqp_iteration(s) : (status_t)q->prepared;
#if HARD_ROWS
        if (q->elastic && (status == STALLED || (status == OK && stuck_infeasible(s, tol)))) {
            if (q->row_weight >= R(1e8)) {
                return INFEASIBLE;
            }
            q->row_weight *= R(10);
            continue;
        }
#endif
        if (status != OK) {
            return status;
        }
    }
}

/* A new start after a search that has ended where the constraints cannot be satisfied: the states to which the controls
 * of the plan lead, and the next time those to which the reference controls do. */
static void start_elsewhere(solver_t *s)
{
    const int32_t attempts = s->sqp.attempts + 1;
    if (attempts > 1) {
        forget_plan(s);
    }
    memcpy(s->x[0], s->xhat, sizeof s->xhat);
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
    forget_multipliers(s);
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    start_search(s);
    s->sqp.attempts = attempts;
}

static status_t solve_here(solver_t *s, real_t tol, int last)
{
    status_t status = iterate(s, tol, last);
    while ((status == INFEASIBLE || status == SUBPROBLEM_FAILED || (status == STALLED && s->sqp.violation > R(1e-4))) &&
        s->sqp.attempts < MAX_ATTEMPTS && s->stats.sqp_iterations++ < last) {
        start_elsewhere(s);
        status = iterate(s, tol, last);
    }
    return status;
}

/* Returns 1 if all multipliers that the first Hessian may read are finite. */
static int multipliers_are_finite(solver_t *s)
{
    int finite = all_finite(s->lam[0], (N + 1) * NX);
#if NG
    for (int m = 0; m < NG; m++) {
        finite &= isfinite(ROW_MULTIPLIER(s, m)) != 0;
    }
#endif
    return finite;
}

/* Starts from the plan, of which it gives up what is not finite. */
static void begin(solver_t *s)
{
    forget_violation(s);
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    if (!multipliers_are_finite(s)) {
        forget_multipliers(s);
    }
#if SHIFT
    s->samples += (s->samples < MANY);
#endif
#if LAGRANGIAN
    s->unsettled = 0;
#endif
    start_search(s);
    s->stats.sqp_iterations = 0;
}

status_t API(solve)(solver_t *s, const real_t xhat[NX], real_t tol, int max_iterations)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    s->prepared = 0;
#if BUDGET
    s->qp.allowance = -1;
#endif
    if (!s->sqp.resumes && !take_state(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    if (!(tol > R(0)) || max_iterations < 0) {
        return finish(s, BAD_ARGUMENT);
    }
    if (!s->sqp.resumes) {
#if NF
        for (int f = 0; f < NF; f++) {
            const real_t guess = xhat[free_state[f]];
            s->x[0][free_state[f]] = isfinite(guess) ? guess : s->x[0][free_state[f]];
        }
#endif
        begin(s);
    }
    s->sqp.in_solve = 1;
    status = solve_here(s, tol, max_iterations);
    s->sqp.in_solve = 0;
#if HARD_ROWS
    s->sqp.elastic = 0;
    if (status == INFEASIBLE) {
        name_violation(s);
    }
#endif
    return finish(s, status);
}
