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

/* Measures of the present iterate, without derivatives; sqp.b = Phi(x_k, u_k) - x_{k+1}. */
static measures_t measure(solver_t *s)
{
    sqp_t *q = &s->sqp;
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
        interval_value(s, k, q->b[k]);
        for (int i = 0; i < NX; i++) {
            q->b[k][i] -= s->x[k + 1][i];
            at.violation += FABS(q->b[k][i]) / scale_of(q->state_scale[i]);
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

/* Saves the step of the QP and the point from which it starts. */
static void put_step_aside(solver_t *s)
{
    sqp_t *q = &s->sqp;
    memcpy(q->x, s->x, sizeof s->x);
    memcpy(q->u, s->u, sizeof s->u);
    memcpy(q->dx, s->step.dx, sizeof q->dx);
    memcpy(q->du, s->step.du, sizeof q->du);
}

/* (x, u) = base + alpha (dx, du). */
static void move_to(solver_t *s, real_t alpha)
{
    const sqp_t *q = &s->sqp;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] = q->x[k][i] + alpha * q->dx[k][i];
        }
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = q->u[k][j] + alpha * q->du[k][j];
            s->u[k][j] = safe_value(s, k, j);
        }
    }
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

/* Scales of states and rows: largest magnitudes over the horizon before and after the step. They only grow; if one does,
 * the measures of earlier points are not comparable any more, and the filter is cleared. */
static void update_scales(solver_t *s)
{
    sqp_t *q = &s->sqp;
    real_t size[NZ] = {0};
    int changed = 0;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&size[i], s->x[k][i]);
            enlarge(&size[i], s->x[k][i] + s->step.dx[k][i]);
        }
        for (int j = 0; k < N && j < NU; j++) {
            enlarge(&size[NX + j], s->u[k][j]);
            enlarge(&size[NX + j], s->u[k][j] + s->step.du[k][j]);
        }
    }
    for (int i = 0; i < NX; i++) {
        enlarge(&size[i], s->xhat[i]);
        changed |= raise_scale(&q->state_scale[i], size[i]);
    }
#if HARD_ROWS
    changed |= update_row_scales(s, size);
#endif
    if (changed) {
        q->entries = 0;
        q->most_violation = (real_t)INFINITY;
    }
}

/* Directional derivative of the cost, g' (dx, du). */
static real_t cost_slope(const solver_t *s)
{
    real_t sum = R(0);
    for (int i = 0; i < NX; i++) {
        sum += s->terminal.g[i] * s->step.dx[N][i];
    }
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NX; i++) {
            sum += s->node[k].g[i] * s->step.dx[k][i];
        }
        for (int i = 0; i < NU; i++) {
            sum += s->node[k].g[NX + i] * s->step.du[k][i];
        }
    }
    return sum;
}

/* Second-order correction: the constraints of the QP take the values at base + step, at which s has been evaluated:
 * b = Phi(x + dx, u + du) - x_{k+1} - A dx - B du, and the same for the rows. */
static void correct_constraints(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    const real_t none[NX] = {0};
    for (int k = 0; k < N; k++) {
        node_t *node = &s->node[k];
        real_t y[NX];
        memcpy(node->b, none, sizeof y);
        STATE_STEP(node, q->dx[k], q->du[k], y);
        for (int i = 0; i < NX; i++) {
            node->b[i] = q->b[k][i] + q->dx[k + 1][i] - y[i];
        }
#if NH
        real_t J[NH * NZ];
        PATH_ROWS(s, k, node->h, J);
        for (int i = 0; i < NH; i++) {
            for (int j = 0; j < NZ; j++) {
                node->h[i] -= node->J[i][j] * ((j < NX) ? q->dx[k][j] : q->du[k][j - NX]);
            }
        }
#endif
    }
#if NH_N
    real_t J[NH_N * NX];
    TERMINAL_ROWS(s, s->terminal.h, J);
    for (int i = 0; i < NH_N; i++) {
        for (int j = 0; j < NX; j++) {
            s->terminal.h[i] -= s->terminal.J[i][j] * q->dx[N][j];
        }
    }
#endif
#if NE
    real_t J_0[NE * NX], J_N[NE * NX];
    COUPLED_ROWS(s, s->coupled.r, J_0, J_N);
    for (int i = 0; i < NE; i++) {
        for (int j = 0; j < NX; j++) {
            s->coupled.r[i] -= s->coupled.J_0[i][j] * q->dx[0][j] + s->coupled.J_N[i][j] * q->dx[N][j];
        }
    }
#endif
}

/* Solves the same QP with corrected constraints and stores the corrected step in sqp.dx and sqp.du. Returns 0 if it
 * fails. */
static int second_order_correction(solver_t *s)
{
    sqp_t *q = &s->sqp;
    correct_constraints(s);
    memcpy(s->x, q->x, sizeof s->x);
    memcpy(s->u, q->u, sizeof s->u);
    condense_rows(s);
    for (int i = 0; i < NX; i++) {
        s->step.dx[0][i] = s->xhat[i] - s->x[0][i];
    }
    if (condense_solve(s) != OK) {
        return 0;
    }
    memcpy(q->dx, s->step.dx, sizeof q->dx);
    memcpy(q->du, s->step.du, sizeof q->du);
    return step_is_finite(s);
}

/* Returns 1 if a point is no worse than the filter allows. */
static int passes_filter(const sqp_t *q, const measures_t *at)
{
    if (!(at->violation <= q->most_violation && at->cost < (real_t)INFINITY)) {
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
        return at.cost < (real_t)INFINITY && at.violation <= start->violation - R(1e-4) * alpha * gain;
    }
    if (!passes_filter(q, &at)) {
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

/* Backtracking. If the full step is rejected, one second-order correction is tried. */
static status_t line_search(solver_t *s, const measures_t *start, real_t slope, real_t gain)
{
    sqp_t *q = &s->sqp;
    q->length = R(1);
    put_step_aside(s);
    for (int trial = 0; trial < MAX_TRIALS; trial++) {
        move_to(s, q->length);
        if (accepts(s, start, q->length, slope, gain)) {
            return OK;
        }
        if (trial == 0) {
            memcpy(q->dx_full, q->dx, sizeof q->dx);
            memcpy(q->du_full, q->du, sizeof q->du);
            if (second_order_correction(s)) {
                move_to(s, R(1));
                if (accepts(s, start, R(1), slope, gain)) {
                    return OK;
                }
            }
            memcpy(q->dx, q->dx_full, sizeof q->dx);
            memcpy(q->du, q->du_full, sizeof q->du);
        }
        q->length *= R(0.5);
    }
    move_to(s, R(0));
    return STALLED;
}

#if HARD_ROWS
/* How much the cost may change along the horizon, at least 1: the largest |g_i| |z_i|, and what the multipliers of rows
 * say about rows in their scale. */
static real_t cost_unit(const solver_t *s)
{
    real_t largest = R(0);
    for (int k = 0; k <= N; k++) {
        const real_t *g = (k < N) ? s->node[k].g : s->terminal.g;
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
        s->relaxation = (real_t)INFINITY;
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

/* a + length (b - a), or b if a is not finite. */
static inline real_t between(real_t a, real_t b, real_t length)
{
    return (length < R(1) && isfinite(a)) ? a + length * (b - a) : b;
}

/* Multipliers after a step: those of rows move towards the ones of the QP, lam follows from the gradient of the QP at the
 * end of the step. After a short step, those of the QP may be as far off as the step. Those of an elastic QP are those
 * of its penalty: nothing is known. */
static void take_multipliers(solver_t *s)
{
    const real_t length = s->sqp.length;
#if HARD_ROWS
    if (s->sqp.elastic) {
        forget_multipliers(s);
        return;
    }
#endif
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->step.dx[k][i] = length * s->sqp.dx[k][i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->step.du[k][j] = length * s->sqp.du[k][j];
            s->mu_u[k][j] = between(s->mu_u[k][j], s->step.mult_u[k][j], length);
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        ROW_MULTIPLIER(s, m) = between(ROW_MULTIPLIER(s, m), s->step.mult[m], length);
    }
#endif
    (void)recover_multipliers(s); /* convergence is judged by the residuals of the problem itself */
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
    if (!q->restoring) {
        const status_t status = line_search(s, start, slope, gain);
        if (status == OK || !(start->violation > R(16) * TOL_MERIT_ROUNDING)) {
            return status;
        }
        memcpy(s->step.dx, q->dx, sizeof q->dx);
        memcpy(s->step.du, q->du, sizeof q->du);
        extend_filter(q, start);
        q->restoring = 1;
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
    if (!(q->most_violation < (real_t)INFINITY)) {
        update_scales(s); /* those of the plan: a relaxed QP needs them */
    }
    status_t status = solve_qp(s);
    if (status != OK) {
        return status;
    }
    if (!step_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
    update_scales(s);
    const measures_t start = measure(s);
    if (!isfinite(start.violation) || !isfinite(start.cost)) {
        return NUMERICAL_FAILURE;
    }
    if (!(q->most_violation < (real_t)INFINITY)) {
        q->most_violation = R(1e4) * ((start.violation > R(1)) ? start.violation : R(1));
        q->small_violation = R(1e-4) * ((start.violation > R(1)) ? start.violation : R(1));
    }
    status = search(s, &start);
    if (status == OK) {
        take_multipliers(s);
    }
    return status;
}

/* Relative KKT residuals from the linearisation of the last prepare. Returns 1 if all are at most tol. */
static int kkt_converged(solver_t *s, real_t tol)
{
    kkt_t *kkt = &s->kkt;
    memset(kkt, 0, sizeof *kkt);
    for (int k = 0; k < N; k++) {
        kkt_node(s, k, &s->node[k], kkt, 1);
    }
    kkt_terminal(s, &s->terminal, kkt, 1);
    kkt_rows(s, kkt, 1);
    return kkt->stationarity <= tol && kkt->equality <= tol && kkt->inequality <= tol && kkt->complementarity <= tol;
}

#if HARD_ROWS
/* Returns 1 if the last QP was elastic and its step is at most tol: the rows cannot be satisfied near this point. */
static int stuck_infeasible(const solver_t *s, real_t tol)
{
    real_t step = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&step, s->sqp.dx[k][i]);
        }
    }
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NU; i++) {
            enlarge(&step, s->sqp.du[k][i]);
        }
    }
    return s->sqp.elastic && step <= tol;
}
#endif

static status_t iterate(solver_t *s, real_t tol, int max_iterations)
{
    s->sqp.cost_scale = R(0);
    s->sqp.most_violation = (real_t)INFINITY;
    memset(s->sqp.state_scale, 0, sizeof s->sqp.state_scale);
    memset(&s->step, 0, sizeof s->step);
    s->sqp.entries = 0;
    s->sqp.restoring = 0;
#if HARD_ROWS
    s->sqp.row_weight = R(1000);
    memset(s->sqp.row_scale, 0, sizeof s->sqp.row_scale);
#endif
    for (int iteration = 0;; iteration++) {
        status_t status = prepare_here(s);
        s->stats.sqp_iterations = iteration;
        if (kkt_converged(s, tol)) {
            return OK;
        }
        if (iteration >= max_iterations) {
            return ITERATION_LIMIT;
        }
        if (status == OK) {
            status = sqp_iteration(s);
        }
#if HARD_ROWS
        if (s->sqp.elastic && (status == STALLED || (status == OK && stuck_infeasible(s, tol)))) {
            if (s->sqp.row_weight >= R(1e8)) {
                return INFEASIBLE;
            }
            s->sqp.row_weight *= R(10);
            continue;
        }
#endif
        if (status != OK) {
            return status;
        }
    }
}

/* Returns 1 if all multipliers that the first Hessian may read are finite. */
static int multipliers_are_finite(solver_t *s)
{
    real_t probe = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            probe += R(0) * s->lam[k][i];
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        probe += R(0) * ROW_MULTIPLIER(s, m);
    }
#endif
    return isfinite(probe) != 0;
}

/* The iterations; outside of them, penalties of rows are those of the rows as they are. */
static status_t solve_here(solver_t *s, real_t tol, int max_iterations)
{
    const status_t status = iterate(s, tol, max_iterations);
#if HARD_ROWS
    memset(s->sqp.row_scale, 0, sizeof s->sqp.row_scale);
#endif
    return status;
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
    if (!take_state(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    if (!(tol > R(0)) || max_iterations < 0) {
        return finish(s, BAD_ARGUMENT);
    }
#if NF
    for (int f = 0; f < NF; f++) {
        const real_t guess = xhat[free_state[f]];
        s->x[0][free_state[f]] = isfinite(guess) ? guess : s->x[0][free_state[f]];
    }
#endif
    forget_violation(s);
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    if (!multipliers_are_finite(s)) {
        forget_multipliers(s);
    }
    status = solve_here(s, tol, max_iterations);
#if HARD_ROWS
    if (status == INFEASIBLE) {
        name_violation(s);
    }
#endif
#if SHIFT
    s->samples += (s->samples < MANY);
#endif
#if LAGRANGIAN
    s->unsettled = 0;
#endif
    return finish(s, status);
}
