/* SQP to convergence: the pieces of the real-time iteration, globalised by a line search on the l1 merit function
 *
 *     phi = cost + gap_weight (sum |x_{k+1} - Phi_k| + |x_0 - xhat|) + row_weight (sum of row violations) + penalties,
 *
 * with one second-order correction where the full step is refused, and an elastic QP (rows relaxed at row_weight) where
 * a linearisation is infeasible. Soft rows enter with their penalties l1 v + l2/2 v^2. */

/* Constraints of the present iterate without derivatives: sqp.b = Phi(x_k, u_k) - x_{k+1}, general rows, and
 * their norms; penalties of the soft rows. */
static void evaluate_constraints(solver_t *s, real_t *gaps, real_t *violation, real_t *penalties)
{
    sqp_t *q = &s->sqp;
    int k, i;
    *gaps = R(0);
    *violation = R(0);
    *penalties = R(0);
    for (i = 0; i < NX; i++) {
        if (is_measured[i] || is_accumulator[i]) {
            *gaps += FABS(s->x[0][i] - s->xhat[i]);
        }
    }
    for (k = 0; k < N; k++) {
        interval_value(s->x[k], s->u[k], PARAM(s, k), interval_length[k], q->b[k]);
        for (i = 0; i < NX; i++) {
            q->b[k][i] -= s->x[k + 1][i];
            *gaps += FABS(q->b[k][i]);
        }
        path_rows(s->x[k], s->u[k], PARAM(s, k), q->h[k], &q->J[0][0]);
        add_rows_of_node(s, k, q->h[k], q->r, violation, penalties);
    }
    terminal_rows(s->x[N], PARAM_N(s), q->h_N, &q->J_N[0][0]);
    coupled_rows(s->x[0], s->x[N], q->r, &q->J_r[0][0], &q->J_r[0][0]);
    add_rows_of_node(s, N, q->h_N, q->r, violation, penalties);
}

static real_t merit(solver_t *s)
{
    real_t gaps, violation, penalties;
    evaluate_constraints(s, &gaps, &violation, &penalties);
    return nodal_cost(s) + penalties + s->sqp.gap_weight * gaps + s->sqp.row_weight * violation;
}

/* The step of the QP and the point it starts from are put aside. */
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
    int k, i, j;
    for (k = 0; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            s->x[k][i] = q->x[k][i] + alpha * q->dx[k][i];
        }
    }
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            const real_t u = q->u[k][j] + alpha * q->du[k][j];
            s->u[k][j] = clip(u, control_lower(s, k, j), control_upper(s, k, j));
        }
    }
}

/* Weights of the merit function stay above the multipliers of the QP. */
static void update_weights(solver_t *s)
{
    real_t lam = R(0);
    real_t mu = R(0);
    int k, i, m;
    for (k = 0; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            enlarge(&lam, s->lam[k][i]);
        }
    }
    for (m = 0; m < NG; m++) {
        enlarge(&mu, (row_l1[row_id[m]] < (real_t)INFINITY) ? R(0) : row_multiplier(s, m));
    }
    if (s->sqp.gap_weight < lam * R(1.5)) {
        s->sqp.gap_weight = lam * R(2);
    }
    if (s->sqp.row_weight < mu * R(1.5) && !s->sqp.elastic) {
        s->sqp.row_weight = mu * R(2);
    }
}

/* Directional derivative of the cost, g' (dx, du). */
static real_t cost_slope(const solver_t *s)
{
    real_t sum = R(0);
    int k, i;
    for (i = 0; i < NX; i++) {
        sum += s->terminal.g[i] * s->step.dx[N][i];
    }
    for (k = 0; k < N; k++) {
        for (i = 0; i < NX; i++) {
            sum += s->node[k].g[i] * s->step.dx[k][i];
        }
        for (i = 0; i < NU; i++) {
            sum += s->node[k].g[NX + i] * s->step.du[k][i];
        }
    }
    return sum;
}

/* The linearised rows after the full step: violation of hard ones (0 unless the QP was elastic), penalties of soft ones. */
static void linear_violation(const solver_t *s, real_t *violation, real_t *penalties)
{
    int m;
    *violation = R(0);
    *penalties = R(0);
    for (m = 0; m < NG; m++) {
        add_violation(m, FABS(row_excess(s, m)), violation, penalties);
    }
}

/* Second-order correction: the same QP with the constraint values of base + step,
 * b = Phi(x + dx, u + du) - x_{k+1} - A dx - B du, rows likewise. Leaves the corrected step in sqp.dx, du; 0 if it fails. */
static int second_order_correction(solver_t *s)
{
    sqp_t *q = &s->sqp;
    const real_t none[NX] = {0};
    real_t y[NX];
    int k, i, j, m;
    for (k = 0; k < N; k++) {
        node_t *node = &s->node[k];
        memcpy(node->b, none, sizeof y);
        state_step(node, q->dx[k], q->du[k], y);
        for (i = 0; i < NX; i++) {
            node->b[i] = q->b[k][i] + q->dx[k + 1][i] - y[i];
        }
        for (i = 0; i < NH; i++) {
            real_t value = q->h[k][i];
            for (j = 0; j < NZ; j++) {
                value -= node->J[i][j] * ((j < NX) ? q->dx[k][j] : q->du[k][j - NX]);
            }
            node->h[i] = value;
        }
    }
    for (i = 0; i < NH_N; i++) {
        s->terminal.h[i] = q->h_N[i];
        for (j = 0; j < NX; j++) {
            s->terminal.h[i] -= s->terminal.J[i][j] * q->dx[N][j];
        }
    }
    for (i = 0; i < NE; i++) {
        s->coupled.r[i] = q->r[i];
        for (j = 0; j < NX; j++) {
            s->coupled.r[i] -= s->coupled.J_0[i][j] * q->dx[0][j] + s->coupled.J_N[i][j] * q->dx[N][j];
        }
    }
    memcpy(s->x, q->x, sizeof s->x);
    memcpy(s->u, q->u, sizeof s->u);
    condense_rows(s);
    for (m = 0; m < NX; m++) {
        s->step.dx[0][m] = s->xhat[m] - s->x[0][m];
    }
    if (condense_solve(s) != OK) {
        return 0;
    }
    memcpy(q->dx, s->step.dx, sizeof q->dx);
    memcpy(q->du, s->step.du, sizeof q->du);
    return step_is_finite(s);
}

/* The largest of the last merit values: steps may rise above the last one, which spares the full steps of
 * Gauss-Newton that a monotone search would cut (Grippo, Lampariello and Lucidi 1986). */
static real_t merit_to_beat(solver_t *s, int iteration, real_t start)
{
    real_t largest = start;
    int n;
    s->sqp.recent[iteration % MEMORY] = start;
    for (n = 0; n < MEMORY && n <= iteration; n++) {
        if (s->sqp.recent[n] > largest) {
            largest = s->sqp.recent[n];
        }
    }
    return largest;
}

/* Backtracking on the merit function, Armijo constant 1e-4; the full step gets one second-order correction. */
static status_t line_search(solver_t *s, real_t start, real_t slope)
{
    const real_t rounding = TOL_MERIT_ROUNDING * (R(1) + FABS(start));
    real_t alpha = R(1);
    int trial;
    put_step_aside(s);
    for (trial = 0; trial < MAX_TRIALS; trial++) {
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

/* QP of the present linearisation; an infeasible one is solved with relaxed rows, penalty row_weight. */
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

/* One globalised iteration after prepare_here(). */
static status_t sqp_iteration(solver_t *s, int iteration)
{
    real_t gaps, violation, penalties, later, penalties_later, start, slope;
    status_t status = solve_qp(s);
    if (status != OK) {
        return status;
    }
    if (!step_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
    scatter_multipliers(s);
    recover_multipliers(s);
    update_weights(s);
    evaluate_constraints(s, &gaps, &violation, &penalties);
    linear_violation(s, &later, &penalties_later);
    start = nodal_cost(s) + penalties + s->sqp.gap_weight * gaps + s->sqp.row_weight * violation;
    slope = cost_slope(s) + (penalties_later - penalties) - s->sqp.gap_weight * gaps -
        s->sqp.row_weight * (violation - later);
    if (!isfinite(start)) {
        return NUMERICAL_FAILURE;
    }
    return line_search(s, merit_to_beat(s, iteration, start), (slope < R(0)) ? slope : R(0));
}

/* 1 if the last step was elastic and moved nothing: the rows cannot be met near this point. */
static int stuck_infeasible(const solver_t *s, real_t tol)
{
    real_t step = R(0);
    int k, i;
    for (k = 0; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            enlarge(&step, s->sqp.dx[k][i]);
        }
    }
    for (k = 0; k < N; k++) {
        for (i = 0; i < NU; i++) {
            enlarge(&step, s->sqp.du[k][i]);
        }
    }
    return s->sqp.elastic && step <= tol;
}

static status_t solve_here(solver_t *s, real_t tol, int max_iterations)
{
    int iteration;
    s->sqp.gap_weight = R(1);
    s->sqp.row_weight = R(1);
    for (iteration = 0;; iteration++) {
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
        if (s->sqp.elastic && (status == STALLED || (status == OK && stuck_infeasible(s, tol)))) {
            if (s->sqp.row_weight >= R(1e8)) {
                return INFEASIBLE;
            }
            s->sqp.row_weight *= R(10);
            continue;
        }
        if (status != OK) {
            return status;
        }
    }
}
