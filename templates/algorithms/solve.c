/* SQP to convergence: the steps of the real-time iteration, globalised by a line search on the l1 merit function
 *
 *     phi = cost + gap_weight (sum |x_{k+1} - Phi_k| + |x_0 - xhat|) + row_weight (sum of row violations) + penalties,
 *
 * with one second-order correction if the full step is rejected, and an elastic QP (rows relaxed with row_weight) if a
 * linearisation is infeasible. Soft rows enter with their penalties l1 v + l2/2 v^2. */

/* Terms of the merit function besides the cost: l1 norms of the gaps and of the violations of hard rows, and penalties
 * of soft rows. */
typedef struct {
    real_t gaps;
#if HARD_ROWS
    real_t violation;
#endif
#if SOFT_ROWS
    real_t penalties;
#endif
} merit_terms_t;

#if SOFT_ROWS
/* Adds a violation v >= 0 of row m. */
static void add_violation(int m, real_t v, merit_terms_t *terms)
{
    if (IS_SOFT(m)) {
        terms->penalties += soft_penalty(m, v);
    }
#if HARD_ROWS
    if (!IS_SOFT(m)) {
        terms->violation += v;
    }
#endif
}
#endif

/* Evaluates the constraints at the present iterate without derivatives: sqp.b = Phi(x_k, u_k) - x_{k+1}, and the terms
 * of the merit function. */
static void evaluate_constraints(solver_t *s, merit_terms_t *terms)
{
    sqp_t *q = &s->sqp;
    memset(terms, 0, sizeof *terms);
    for (int i = 0; i < NX; i++) {
#if NF
        if (!is_measured[i] && !is_accumulator[i]) {
            continue;
        }
#endif
        terms->gaps += FABS(s->x[0][i] - s->xhat[i]);
    }
    for (int k = 0; k < N; k++) {
        interval_value(s, k, q->b[k]);
        for (int i = 0; i < NX; i++) {
            q->b[k][i] -= s->x[k + 1][i];
            terms->gaps += FABS(q->b[k][i]);
        }
    }
#if NG
    real_t value[NG];
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t v = FABS(value[m] - clip(value[m], ROW_LOWER(s, m), ROW_UPPER(s, m)));
#if SOFT_ROWS
        add_violation(m, v, terms);
#else
        terms->violation += v;
#endif
    }
#endif
}

/* Merit function phi from its terms. */
static real_t merit_of(const solver_t *s, const merit_terms_t *terms)
{
    real_t phi = nodal_cost(s);
#if SOFT_ROWS
    phi += terms->penalties;
#endif
    phi += s->sqp.gap_weight * terms->gaps;
#if HARD_ROWS
    phi += s->sqp.row_weight * terms->violation;
#endif
    return phi;
}

static real_t merit(solver_t *s)
{
    merit_terms_t terms;
    evaluate_constraints(s, &terms);
    return merit_of(s, &terms);
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

/* Increases the weights of the merit function where needed to keep them above the multipliers of the QP. */
static void update_weights(solver_t *s)
{
    real_t lam = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&lam, s->lam[k][i]);
        }
    }
    if (s->sqp.gap_weight < lam * R(1.5)) {
        s->sqp.gap_weight = lam * R(2);
    }
#if HARD_ROWS
    real_t mu = R(0);
    for (int m = 0; m < NG; m++) {
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        enlarge(&mu, ROW_MULTIPLIER(s, m));
    }
    if (s->sqp.row_weight < mu * R(1.5) && !s->sqp.elastic) {
        s->sqp.row_weight = mu * R(2);
    }
#endif
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

/* Largest of the last MEMORY merit values. A step may exceed the last value, which accepts full Gauss-Newton steps that
 * a monotone line search would shorten (Grippo, Lampariello and Lucidi 1986). */
static real_t merit_to_beat(solver_t *s, int iteration, real_t start)
{
    real_t largest = start;
    s->sqp.recent[iteration % MEMORY] = start;
    for (int n = 0; n < MEMORY && n <= iteration; n++) {
        if (s->sqp.recent[n] > largest) {
            largest = s->sqp.recent[n];
        }
    }
    return largest;
}

/* Backtracking on the merit function with Armijo constant 1e-4. If the full step is rejected, one second-order
 * correction is tried. */
static status_t line_search(solver_t *s, real_t start, real_t slope)
{
    const real_t rounding = TOL_MERIT_ROUNDING * (R(1) + FABS(start));
    real_t alpha = R(1);
    put_step_aside(s);
    for (int trial = 0; trial < MAX_TRIALS; trial++) {
        move_to(s, alpha);
        if (merit(s) <= start + R(1e-4) * alpha * slope + rounding) {
            return OK;
        }
        if (trial == 0) {
            memcpy(s->sqp.dx_full, s->sqp.dx, sizeof s->sqp.dx);
            memcpy(s->sqp.du_full, s->sqp.du, sizeof s->sqp.du);
            if (second_order_correction(s)) {
                move_to(s, R(1));
                if (merit(s) <= start + R(1e-4) * slope + rounding) {
                    return OK;
                }
            }
            memcpy(s->sqp.dx, s->sqp.dx_full, sizeof s->sqp.dx);
            memcpy(s->sqp.du, s->sqp.du_full, sizeof s->sqp.du);
        }
        alpha *= R(0.5);
    }
    move_to(s, R(0));
    return STALLED;
}

#if HARD_ROWS
/* Solves the QP of the present linearisation. If it is infeasible, its rows are relaxed with the penalty row_weight. */
static status_t solve_qp(solver_t *s)
{
    status_t status = run_qp(s);
    s->sqp.elastic = status == INFEASIBLE;
    if (s->sqp.elastic) {
        s->relaxation = s->sqp.row_weight;
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

/* Directional derivative of the merit function along the step of the QP. After the full step the linearised rows are
 * violated only if the QP was elastic. */
static real_t merit_slope(const solver_t *s, const merit_terms_t *terms)
{
    real_t slope = cost_slope(s);
#if NG
    merit_terms_t later;
    memset(&later, 0, sizeof later);
    for (int m = 0; m < NG; m++) {
#if SOFT_ROWS
        add_violation(m, FABS(row_excess(s, m, R(0))), &later);
#else
        later.violation += FABS(row_excess(s, m, R(0)));
#endif
    }
#endif
#if SOFT_ROWS
    slope += later.penalties - terms->penalties;
#endif
    slope -= s->sqp.gap_weight * terms->gaps;
#if HARD_ROWS
    slope -= s->sqp.row_weight * (terms->violation - later.violation);
#endif
    return slope;
}

/* One globalised iteration after prepare_here(). */
static status_t sqp_iteration(solver_t *s, int iteration)
{
    merit_terms_t terms;
    real_t start, slope;
    const status_t status = solve_qp(s);
    if (status != OK) {
        return status;
    }
    if (!step_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
    scatter_multipliers(s);
    (void)recover_multipliers(s); /* convergence is judged by the residuals of the problem itself */
    update_weights(s);
    evaluate_constraints(s, &terms);
    start = merit_of(s, &terms);
    slope = merit_slope(s, &terms);
    if (!isfinite(start)) {
        return NUMERICAL_FAILURE;
    }
    return line_search(s, merit_to_beat(s, iteration, start), (slope < R(0)) ? slope : R(0));
}

/* KKT residuals from the linearisation of the last prepare. Returns 1 if all are at most tol. */
static int kkt_converged(solver_t *s, real_t tol)
{
    kkt_t *kkt = &s->kkt;
    memset(kkt, 0, sizeof *kkt);
    for (int k = 0; k < N; k++) {
        kkt_node(s, k, &s->node[k], kkt);
    }
    kkt_terminal(s, &s->terminal, kkt);
    kkt_rows(s, kkt);
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

static status_t solve_here(solver_t *s, real_t tol, int max_iterations)
{
    s->sqp.gap_weight = R(1);
#if HARD_ROWS
    s->sqp.row_weight = R(1);
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
            status = sqp_iteration(s, iteration);
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
