/* ==== algorithm: real_time_iteration ====================================================================== */

/* Seam "algorithm", contract: algorithm_reset, golden_prepare, _feedback, _step, _shift, _solve, _kkt.
 * Here: real-time iteration, one QP per sample, full step. */

/* What control j is without a plan: its reference, or 0, inside the bounds. */
static golden_real reference_control(const golden_solver_t *s, int k, int j)
{
    const int y = control_reference[j];
    (void)k;
    return clip(y >= 0 ? s->yref[k][y] : 0.0, control_lower(s, k, j), control_upper(s, k, j));
}

/* Every state of the plan at x, every control where it is or, if that is not finite, at its reference; multipliers 0, empty
 * working set. */
static void start_at(golden_solver_t *s, const golden_real *x)
{
    int k, i, j;
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            s->x[k][i] = x[i];
            s->lam[k][i] = s->mu_x[k][i] = 0.0;
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            const golden_real u = s->u[k][j];
            s->u[k][j] = isfinite(u) ? clip(u, control_lower(s, k, j), control_upper(s, k, j)) : reference_control(s, k, j);
            s->mu_u[k][j] = 0.0;
        }
        for (j = 0; j < GOLDEN_NH; j++) {
            s->mu[k][j] = 0.0;
        }
    }
    for (j = 0; j < GOLDEN_NH_N; j++) {
        s->mu_N[j] = 0.0;
    }
    for (j = 0; j < GOLDEN_NE; j++) {
        s->eta[j] = 0.0;
    }
    condense_init(s);
}

static void start_at_measured(golden_solver_t *s)
{
    start_at(s, all_finite(s->xhat, GOLDEN_NX) ? s->xhat : initial_state);
}

/* The plain start: every state at its declared initial value, controls at their reference, multipliers 0. */
static void algorithm_reset(golden_solver_t *s)
{
    int k, j;
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            s->u[k][j] = reference_control(s, k, j);
        }
    }
    memcpy(s->xhat, initial_state, sizeof s->xhat);
    s->prepared = 0;
    s->samples = s->failing = 0;
    s->status = (int32_t)GOLDEN_OK;
    s->relaxation = (golden_real)INFINITY;
    s->stats.violated_row = s->stats.violated_node = -1;
    start_at(s, s->xhat);
}

/* Gap b_k = Phi(x_k, u_k) - x_{k+1} and general rows of node k. */
static void complete_node(const golden_solver_t *s, int k, const golden_real *x_next, golden_node_t *node)
{
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        node->b[i] = x_next[i] - s->x[k + 1][i];
    }
    path_rows(s->x[k], s->u[k], s->p[k], node->h, &node->J[0][0]);
}

/* First derivatives of node k alone: S = [A_k B_k], gradient, gap, general rows. */
static void linearize_node(const golden_solver_t *s, int k, golden_node_t *node)
{
    golden_real x_next[GOLDEN_NX];
    integrator_interval(s->x[k], s->u[k], s->p[k], &interval_length[k], x_next, &node->S[0][0]);
    path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W[0], node->g);
    complete_node(s, k, x_next, node);
}

static void linearize_terminal(const golden_solver_t *s, golden_terminal_t *terminal)
{
    terminal_gradient(s->x[GOLDEN_N], s->p[GOLDEN_N], s->yref_N, s->W_N, terminal->g);
    terminal_rows(s->x[GOLDEN_N], s->p[GOLDEN_N], terminal->h, &terminal->J[0][0]);
}

static void linearize_coupled(const golden_solver_t *s, golden_coupled_t *coupled)
{
    coupled_rows(s->x[0], s->x[GOLDEN_N], coupled->r, &coupled->J_0[0][0], &coupled->J_N[0][0]);
}

/* All nodes, from the last to the first, with what the Hessian takes from the same evaluation. */
static void linearize(golden_solver_t *s)
{
    golden_real x_next[GOLDEN_NX];
    int k;
    linearize_terminal(s, &s->terminal);
    linearize_coupled(s, &s->coupled);
    for (k = GOLDEN_N - 1; k >= 0; k--) {
        expand_node(s, k, x_next);
        complete_node(s, k, x_next, &s->node[k]);
    }
}

/* References entered after prepare: gradients anew, everything else stands. */
static void renew_gradients(golden_solver_t *s)
{
    int k;
    for (k = 0; k < GOLDEN_N; k++) {
        path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W[0], s->node[k].g);
    }
    terminal_gradient(s->x[GOLDEN_N], s->p[GOLDEN_N], s->yref_N, s->W_N, s->terminal.g);
    condense_gradient(s);
    s->reference_changed = 0;
}

/* The control that is returned whenever no new one could be computed: the plan's, or its reference, inside the bounds. */
static void safe_control(const golden_solver_t *s, golden_real *u0)
{
    int j;
    for (j = 0; j < GOLDEN_NU; j++) {
        const golden_real u = s->u[0][j];
        u0[j] = isfinite(u) ? clip(u, control_lower(s, 0, j), control_upper(s, 0, j)) : reference_control(s, 0, j);
    }
}

static golden_status_t finish(golden_solver_t *s, golden_status_t status)
{
    s->status = (int32_t)status;
    return status;
}

/* Linearise, Hessian, condense, factorise. */
static golden_status_t prepare_here(golden_solver_t *s)
{
    linearize(s);
    hessian(s);
    s->reference_changed = 0;
    return condense_prepare(s);
}

golden_status_t golden_prepare(golden_solver_t *s)
{
    golden_status_t status;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (GOLDEN_SHIFT && s->samples > 0 && !s->prepared) {
        golden_shift(s);
        if (s->failing == 2) { /* states that a shift has integrated from the measured one would be as lost as the plan */
            start_at_measured(s);
        }
    }
    status = prepare_here(s);
    s->prepared = 1;
    return finish(s, status);
}

/* lam_N = q_N + Q_N dx_N + (rows)_N,  lam_k = q_k + Q_k dx_k + S_k' du_k + A_k' lam_{k+1} + (rows)_k. */
static void recover_multipliers(golden_solver_t *s)
{
    golden_real w[GOLDEN_NZ];
    int k, i, j;
    terminal_adjoint(&s->terminal, s->hessian.Q_N, s->step.dx[GOLDEN_N], w);
    for (k = GOLDEN_N;; k--) {
        for (i = 0; i < GOLDEN_NX; i++) {
            w[i] += s->mu_x[k][i];
            for (j = 0; j < GOLDEN_NE; j++) {
                w[i] += ((k == GOLDEN_N) ? s->coupled.J_N[j][i] * s->eta[j] : 0.0) +
                    ((k == 0) ? s->coupled.J_0[j][i] * s->eta[j] : 0.0);
            }
            for (j = 0; k < GOLDEN_N && j < GOLDEN_NH; j++) {
                w[i] += s->node[k].J[j][i] * s->mu[k][j];
            }
            for (j = 0; k == GOLDEN_N && j < GOLDEN_NH_N; j++) {
                w[i] += s->terminal.J[j][i] * s->mu_N[j];
            }
            s->lam[k][i] = w[i];
        }
        if (k == 0) {
            break;
        }
        adjoint_step(&s->node[k - 1], s->hessian.Q[GOLDEN_NQ == 1 ? 0 : k - 1], s->step.dx[k - 1],
            s->step.du[k - 1], w);
    }
    for (i = 0; i < GOLDEN_NF; i++) {
        s->lam[0][free_state[i]] = 0.0;
    }
}

/* Multipliers of the QP to the places of their rows. */
static void scatter_multipliers(golden_solver_t *s)
{
    int m;
    memcpy(s->mu_u, s->step.mult_u, sizeof s->mu_u);
    for (m = 0; m < GOLDEN_NG; m++) {
        *row_multiplier_place(s, m) = s->step.mult[m];
    }
}

/* 1 if the QP's step is finite. */
static int step_is_finite(const golden_solver_t *s)
{
    golden_real probe = 0.0;
    int k, i;
    for (k = 0; k < GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NU; i++) {
            probe += 0.0 * s->step.du[k][i];
        }
    }
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            probe += 0.0 * s->step.dx[k][i];
        }
    }
    return isfinite(probe) != 0;
}

/* x += dx, u += du. The controls are clipped last: u + (upper - u) can exceed the bound by an ulp. */
static void take_step(golden_solver_t *s)
{
    int k, i, j;
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            s->x[k][i] += s->step.dx[k][i];
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            const golden_real u = s->u[k][j] + s->step.du[k][j];
            s->u[k][j] = clip(u, control_lower(s, k, j), control_upper(s, k, j));
        }
    }
}

/* s->xhat = xhat where it is measured, 0 for accumulators, the plan's own value where x_0 is free; 0 is returned if a
 * measured entry is not finite. */
static int take_state(golden_solver_t *s, const golden_real *xhat)
{
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        if (is_measured[i] && !isfinite(xhat[i])) {
            return 0;
        }
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        s->xhat[i] = is_measured[i] ? xhat[i] : (is_accumulator[i] ? 0.0 : s->x[0][i]);
    }
    return 1;
}

/* The QP for dx_0 = xhat - x_0 and the present bounds, and its counters. */
static golden_status_t run_qp(golden_solver_t *s)
{
    golden_status_t status;
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        s->step.dx[0][i] = s->xhat[i] - s->x[0][i];
    }
    status = condense_solve(s);
    s->stats.qp_iterations = s->qp.iterations;
    s->stats.active_set_changes = s->qp.changes;
    s->stats.dropped_rows = s->qp.dropped;
    s->stats.relaxed_rows = s->qp.relaxed;
    return status;
}

/* What becomes of a QP that has no solution, and of a plan that has become useless. */

/* What the linearised row m exceeds its bounds by after the step; > 0 at the upper bound. */
static golden_real row_excess(const golden_solver_t *s, int m)
{
    golden_real J[GOLDEN_NZ];
    golden_real value = row_gradient(s, m, J);
    const int k = row_node[m];
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        value += J[i] * s->step.dx[k][i];
        value += (row_kind[m] == 2) ? s->coupled.J_0[row_index[m]][i] * s->step.dx[0][i] : 0.0;
    }
    for (i = 0; k < GOLDEN_N && i < GOLDEN_NU; i++) {
        value += J[GOLDEN_NX + i] * s->step.du[k][i];
    }
    return value - clip(value, row_lower(s, m), row_upper(s, m));
}

static void forget_violation(golden_solver_t *s)
{
    s->stats.violated_row = s->stats.violated_node = -1;
    s->stats.violation = 0.0;
}

/* The hard row that the step, the QP's last or relaxed one, violates most goes to the statistics. */
static void name_violation(golden_solver_t *s)
{
    int m;
    forget_violation(s);
    for (m = 0; m < GOLDEN_NG; m++) {
        const golden_real excess = fabs(row_excess(s, m));
        if (excess > s->stats.violation && row_l1[row_id[m]] == (golden_real)INFINITY) {
            s->stats.violation = excess;
            s->stats.violated_row = (int32_t)row_id[m];
            s->stats.violated_node = (int32_t)row_node[m];
        }
    }
}

/* The QP is infeasible: its hard rows are relaxed at the weight that the options ask for, or it stays so. */
static golden_status_t relax_qp(golden_solver_t *s)
{
    golden_status_t status = GOLDEN_INFEASIBLE;
    if (relaxation_weight[0] < (golden_real)INFINITY) {
        s->relaxation = relaxation_weight[0];
        status = run_qp(s);
        s->relaxation = (golden_real)INFINITY;
    }
    name_violation(s);
    return (status == GOLDEN_OK) ? GOLDEN_RELAXED : status;
}

static int plan_is_finite(const golden_solver_t *s)
{
    return all_finite(&s->x[0][0], (GOLDEN_N + 1) * GOLDEN_NX) && all_finite(&s->u[0][0], GOLDEN_N * GOLDEN_NU);
}

/* After a failure that would come back: where numbers broke down, and where the QP fails for the second time in a row, the states
 * of the plan start anew at the measured one, for the plan may have nothing to do with it any more; its controls stay. Where the
 * QP did not end its working set is forgotten. */
static void recover(golden_solver_t *s, golden_status_t status)
{
    const int solved = status == GOLDEN_OK || status == GOLDEN_RELAXED;
    const int measured = status != GOLDEN_NOT_FINITE && status != GOLDEN_NOT_PREPARED;
    if (measured) {
        s->failing = solved ? 0 : s->failing ? 2 : 1;
    }
    if (status == GOLDEN_NUMERICAL_FAILURE || (measured && s->failing == 2)) {
        start_at_measured(s);
    } else if (status == GOLDEN_ITERATION_LIMIT || status == GOLDEN_STALLED) {
        condense_init(s);
    }
}

/* Embed s->xhat, solve the QP, take the full step. The iterate changes only if all went well. */
static golden_status_t feedback_here(golden_solver_t *s)
{
    golden_status_t status;
    if (s->reference_changed) {
        renew_gradients(s);
    }
    status = run_qp(s);
    if (status == GOLDEN_INFEASIBLE) {
        status = relax_qp(s);
    }
    if (status != GOLDEN_OK && status != GOLDEN_RELAXED) {
        return status;
    }
    if (!step_is_finite(s)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    scatter_multipliers(s);
    recover_multipliers(s);
    take_step(s);
    return status;
}

golden_status_t golden_feedback(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU])
{
    golden_status_t status;
    int measured, j;
    if (s->magic != GOLDEN_MAGIC) {
        for (j = 0; j < GOLDEN_NU; j++) {
            u0[j] = default_control[j];
        }
        return GOLDEN_NOT_INITIALIZED;
    }
    measured = take_state(s, xhat);
    forget_violation(s);
    if (!s->prepared) {
        status = GOLDEN_NOT_PREPARED;
    } else if (!measured) {
        status = GOLDEN_NOT_FINITE;
    } else if (s->status != GOLDEN_OK) {
        status = (golden_status_t)s->status;
    } else {
        status = feedback_here(s);
    }
    s->prepared = 0;
    s->samples += (s->samples < GOLDEN_MANY);
    safe_control(s, u0);
    recover(s, status);
    return finish(s, status);
}

golden_status_t golden_step(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU])
{
    (void)golden_prepare(s);
    return golden_feedback(s, xhat, u0);
}

/* Warm start of a shifted problem: the side of control i + n becomes the prediction for control i, the last n keep theirs;
 * general row j takes that of row source[j] >= j, or none if source[j] < 0. */
static void qp_shift_working_set(golden_qp_t *q, int n, const int *source)
{
    for (int i = 0; i + n < GOLDEN_NS * GOLDEN_NUS; ++i) {
        q->side[i] = q->side[i + n];
    }
    for (int j = 0; j < GOLDEN_NG; ++j) {
        q->side[GOLDEN_NV + j] = source[j] < 0 ? 0 : q->side[GOLDEN_NV + source[j]];
    }
}

/* Slacks follow their rows. */
static void condense_shift(golden_solver_t *s, const int *source)
{
    int m;
    for (m = 0; m < GOLDEN_NG; m++) {
        if (row_slack[m] >= 0) {
            s->qp.side[row_slack[m]] = (source[m] < 0) ? 0 : s->qp.side[row_slack[source[m]]];
        }
    }
    qp_shift_working_set(&s->qp, GOLDEN_NU, source);
}

/* The QP's prediction moves by one interval: the row of node k takes that of node k + 1, if it holds there too. */
static void shift_working_set(golden_solver_t *s)
{
    int source[GOLDEN_NG + 1], m, next;
    for (m = 0; m < GOLDEN_NG; m++) {
        source[m] = m;
        for (next = m + 1; next < GOLDEN_NG && row_node[next] <= row_node[m] + 1; next++) {
            if (row_node[next] > row_node[m] && row_id[next] == row_id[m]) {
                source[m] = next;
            }
        }
    }
    condense_shift(s, source);
}

/* Node k takes what node k + 1 has; the last node and the last interval keep theirs. */
static void shift_by_one(golden_solver_t *s)
{
    int k, i, j;
    for (k = 0; k < GOLDEN_N; k++) {
        const int from = (k + 1 < GOLDEN_N) ? k + 1 : k;
        for (i = 0; i < GOLDEN_NX; i++) {
            s->x[k][i] = s->x[k + 1][i];
            s->lam[k][i] = s->lam[k + 1][i];
            s->mu_x[k][i] = s->mu_x[from][i];
        }
        for (j = 0; j < GOLDEN_NU; j++) {
            s->u[k][j] = clip(s->u[from][j], control_lower(s, k, j), control_upper(s, k, j));
            s->mu_u[k][j] = s->mu_u[from][j];
        }
        for (j = 0; j < GOLDEN_NH; j++) {
            s->mu[k][j] = s->mu[from][j];
        }
    }
    shift_working_set(s);
}

/* The plan moves by one interval: x_k <- x_{k+1}, u_k <- u_{k+1}, the last control is repeated and the tail integrated
 * (x_N stays if that overflows); multipliers and the working set move with it. */
static void shift_plan(golden_solver_t *s)
{
    golden_real tail[GOLDEN_NX];
    shift_by_one(s);
    interval_value(s->x[GOLDEN_N - 1], s->u[GOLDEN_N - 1], s->p[GOLDEN_N - 1], interval_length[GOLDEN_N - 1], tail);
    if (all_finite(tail, GOLDEN_NX)) {
        memcpy(s->x[GOLDEN_N], tail, sizeof tail);
    }
}

golden_status_t golden_shift(golden_solver_t *s)
{
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    shift_plan(s);
    s->prepared = 0;
    return GOLDEN_OK;
}

/* max |a|, a NaN wins. */
static void enlarge(golden_real *largest, golden_real value)
{
    const golden_real a = fabs(value);
    if (!(a <= *largest)) {
        *largest = a;
    }
}

/* One row lower <= value <= upper with multiplier mu: violation, and |mu| times the distance to the bound it pushes at. */
static void kkt_row(golden_kkt_t *kkt, golden_real value, golden_real lower, golden_real upper, golden_real mu)
{
    if (!(value >= lower)) {
        enlarge(&kkt->inequality, lower - value);
    }
    if (!(value <= upper)) {
        enlarge(&kkt->inequality, value - upper);
    }
    if (lower < upper && mu > 0.0) {
        enlarge(&kkt->complementarity, mu * (upper - value));
    }
    if (lower < upper && mu < 0.0) {
        enlarge(&kkt->complementarity, mu * (value - lower));
    }
}

/* One side of a soft row, excess over its bound and multiplier m >= 0: conditions of min l1 v + l2/2 v^2, v >= excess, v >= 0
 * at v = max(0, excess); nu = l1 + l2 v - m >= 0 is the multiplier of v >= 0. */
static void kkt_soft_side(golden_kkt_t *kkt, golden_real excess, golden_real m, golden_real l1, golden_real l2)
{
    const golden_real v = (excess > 0.0) ? excess : 0.0;
    const golden_real nu = l1 + l2 * v - m;
    enlarge(&kkt->complementarity, nu * v);
    if (!(nu >= 0.0)) {
        enlarge(&kkt->complementarity, nu);
    }
    if (m > 0.0) {
        enlarge(&kkt->complementarity, m * (excess - v));
    }
}

/* Violation and complementarity of the rows of node k; h are its general rows, r the coupled ones. */
static void kkt_rows(const golden_solver_t *s, int k, const golden_real *h, const golden_real *r, golden_kkt_t *kkt)
{
    int m, j;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        const golden_real l1 = row_l1[row_id[m]], value = row_value(s, m, h, r);
        if (l1 < (golden_real)INFINITY) {
            const golden_real mu = row_multiplier(s, m), l2 = row_curvature(m);
            kkt_soft_side(kkt, value - row_upper(s, m), (mu > 0.0) ? mu : 0.0, l1, l2);
            kkt_soft_side(kkt, row_lower(s, m) - value, (mu < 0.0) ? -mu : 0.0, l1, l2);
        } else {
            kkt_row(kkt, value, row_lower(s, m), row_upper(s, m), row_multiplier(s, m));
        }
    }
    for (j = 0; k < GOLDEN_N && j < GOLDEN_NU; j++) {
        kkt_row(kkt, s->u[k][j], control_lower(s, k, j), control_upper(s, k, j), s->mu_u[k][j]);
    }
}

/* Node k: gradient of the Lagrangian (q, r) + [A B]' lam_{k+1} - (lam_k, 0) + mu_x, mu_u + J' mu, and the gap. */
static void kkt_node(const golden_solver_t *s, int k, const golden_node_t *node, const golden_coupled_t *coupled, golden_kkt_t *kkt)
{
    int i, j;
    for (i = 0; i < GOLDEN_NZ; i++) {
        golden_real sum = node->g[i];
        for (j = 0; j < GOLDEN_NX; j++) {
            sum += node->S[j][i] * s->lam[k + 1][j];
        }
        for (j = 0; j < GOLDEN_NH; j++) {
            sum += node->J[j][i] * s->mu[k][j];
        }
        for (j = 0; k == 0 && i < GOLDEN_NX && j < GOLDEN_NE; j++) {
            sum += coupled->J_0[j][i] * s->eta[j];
        }
        sum += (i < GOLDEN_NX) ? s->mu_x[k][i] - s->lam[k][i] : s->mu_u[k][i - GOLDEN_NX];
        enlarge(&kkt->stationarity, sum);
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        enlarge(&kkt->equality, node->b[i]);
    }
    kkt_rows(s, k, node->h, coupled->r, kkt);
}

static void kkt_terminal(const golden_solver_t *s, const golden_terminal_t *terminal, const golden_coupled_t *coupled,
    golden_kkt_t *kkt)
{
    int i, j;
    for (i = 0; i < GOLDEN_NX; i++) {
        golden_real sum = terminal->g[i] + s->mu_x[GOLDEN_N][i] - s->lam[GOLDEN_N][i];
        for (j = 0; j < GOLDEN_NH_N; j++) {
            sum += terminal->J[j][i] * s->mu_N[j];
        }
        for (j = 0; j < GOLDEN_NE; j++) {
            sum += coupled->J_N[j][i] * s->eta[j];
        }
        enlarge(&kkt->stationarity, sum);
        if (is_measured[i] || is_accumulator[i]) {
            enlarge(&kkt->equality, s->xhat[i] - s->x[0][i]);
        }
    }
    kkt_rows(s, GOLDEN_N, terminal->h, coupled->r, kkt);
}

/* KKT residuals of the present iterate, linearised afresh (on the stack: one node). */
void golden_kkt(const golden_solver_t *s, golden_kkt_t *out)
{
    golden_node_t node;
    golden_terminal_t terminal;
    golden_coupled_t coupled;
    int k;
    memset(out, 0, sizeof *out);
    memset(&node, 0, sizeof node);
    memset(&terminal, 0, sizeof terminal);
    memset(&coupled, 0, sizeof coupled);
    linearize_coupled(s, &coupled);
    for (k = 0; k < GOLDEN_N; k++) {
        linearize_node(s, k, &node);
        kkt_node(s, k, &node, &coupled, out);
    }
    linearize_terminal(s, &terminal);
    kkt_terminal(s, &terminal, &coupled, out);
}

/* KKT residuals from the linearisation that prepare has just left; 1 if all are at most tol. */
static int kkt_converged(golden_solver_t *s, golden_real tol)
{
    golden_kkt_t *kkt = &s->kkt;
    int k;
    memset(kkt, 0, sizeof *kkt);
    for (k = 0; k < GOLDEN_N; k++) {
        kkt_node(s, k, &s->node[k], &s->coupled, kkt);
    }
    kkt_terminal(s, &s->terminal, &s->coupled, kkt);
    return kkt->stationarity <= tol && kkt->equality <= tol && kkt->inequality <= tol && kkt->complementarity <= tol;
}

/* SQP to convergence: the pieces of the real-time iteration, globalised by a line search on the l1 merit function
 *
 *     phi = cost + gap_weight (sum |x_{k+1} - Phi_k| + |x_0 - xhat|) + row_weight (sum of row violations) + penalties,
 *
 * with one second-order correction where the full step is refused, and an elastic QP (rows relaxed at row_weight) where
 * a linearisation is infeasible. Soft rows enter with their penalties l1 v + l2/2 v^2. */

/* Constraints of the present iterate without derivatives: sqp.b = Phi(x_k, u_k) - x_{k+1}, general rows, and
 * their norms; penalties of the soft rows. */
static void evaluate_constraints(golden_solver_t *s, golden_real *gaps, golden_real *violation, golden_real *penalties)
{
    golden_sqp_t *q = &s->sqp;
    int k, i;
    *gaps = 0.0;
    *violation = 0.0;
    *penalties = 0.0;
    for (i = 0; i < GOLDEN_NX; i++) {
        if (is_measured[i] || is_accumulator[i]) {
            *gaps += fabs(s->x[0][i] - s->xhat[i]);
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        interval_value(s->x[k], s->u[k], s->p[k], interval_length[k], q->b[k]);
        for (i = 0; i < GOLDEN_NX; i++) {
            q->b[k][i] -= s->x[k + 1][i];
            *gaps += fabs(q->b[k][i]);
        }
        path_rows(s->x[k], s->u[k], s->p[k], q->h[k], &q->J[0][0]);
        add_rows_of_node(s, k, q->h[k], q->r, violation, penalties);
    }
    terminal_rows(s->x[GOLDEN_N], s->p[GOLDEN_N], q->h_N, &q->J_N[0][0]);
    coupled_rows(s->x[0], s->x[GOLDEN_N], q->r, &q->J_r[0][0], &q->J_r[0][0]);
    add_rows_of_node(s, GOLDEN_N, q->h_N, q->r, violation, penalties);
}

static golden_real merit(golden_solver_t *s)
{
    golden_real gaps, violation, penalties;
    evaluate_constraints(s, &gaps, &violation, &penalties);
    return nodal_cost(s) + penalties + s->sqp.gap_weight * gaps + s->sqp.row_weight * violation;
}

/* The step of the QP and the point it starts from are put aside. */
static void put_step_aside(golden_solver_t *s)
{
    golden_sqp_t *q = &s->sqp;
    memcpy(q->x, s->x, sizeof s->x);
    memcpy(q->u, s->u, sizeof s->u);
    memcpy(q->dx, s->step.dx, sizeof q->dx);
    memcpy(q->du, s->step.du, sizeof q->du);
}

/* (x, u) = base + alpha (dx, du). */
static void move_to(golden_solver_t *s, golden_real alpha)
{
    const golden_sqp_t *q = &s->sqp;
    int k, i, j;
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            s->x[k][i] = q->x[k][i] + alpha * q->dx[k][i];
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            const golden_real u = q->u[k][j] + alpha * q->du[k][j];
            s->u[k][j] = clip(u, control_lower(s, k, j), control_upper(s, k, j));
        }
    }
}

/* Weights of the merit function stay above the multipliers of the QP. */
static void update_weights(golden_solver_t *s)
{
    golden_real lam = 0.0;
    golden_real mu = 0.0;
    int k, i, m;
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            enlarge(&lam, s->lam[k][i]);
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        enlarge(&mu, (row_l1[row_id[m]] < (golden_real)INFINITY) ? 0.0 : row_multiplier(s, m));
    }
    if (s->sqp.gap_weight < lam * 1.5) {
        s->sqp.gap_weight = lam * 2.0;
    }
    if (s->sqp.row_weight < mu * 1.5 && !s->sqp.elastic) {
        s->sqp.row_weight = mu * 2.0;
    }
}

/* Directional derivative of the cost, g' (dx, du). */
static golden_real cost_slope(const golden_solver_t *s)
{
    golden_real sum = 0.0;
    int k, i;
    for (i = 0; i < GOLDEN_NX; i++) {
        sum += s->terminal.g[i] * s->step.dx[GOLDEN_N][i];
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            sum += s->node[k].g[i] * s->step.dx[k][i];
        }
        for (i = 0; i < GOLDEN_NU; i++) {
            sum += s->node[k].g[GOLDEN_NX + i] * s->step.du[k][i];
        }
    }
    return sum;
}

/* The linearised rows after the full step: violation of hard ones (0 unless the QP was elastic), penalties of soft ones. */
static void linear_violation(const golden_solver_t *s, golden_real *violation, golden_real *penalties)
{
    int m;
    *violation = 0.0;
    *penalties = 0.0;
    for (m = 0; m < GOLDEN_NG; m++) {
        add_violation(m, fabs(row_excess(s, m)), violation, penalties);
    }
}

/* Second-order correction: the same QP with the constraint values of base + step,
 * b = Phi(x + dx, u + du) - x_{k+1} - A dx - B du, rows likewise. Leaves the corrected step in sqp.dx, du; 0 if it fails. */
static int second_order_correction(golden_solver_t *s)
{
    golden_sqp_t *q = &s->sqp;
    const golden_real none[GOLDEN_NX] = {0};
    golden_real y[GOLDEN_NX];
    int k, i, j, m;
    for (k = 0; k < GOLDEN_N; k++) {
        golden_node_t *node = &s->node[k];
        memcpy(node->b, none, sizeof y);
        state_step(node, q->dx[k], q->du[k], y);
        for (i = 0; i < GOLDEN_NX; i++) {
            node->b[i] = q->b[k][i] + q->dx[k + 1][i] - y[i];
        }
        for (i = 0; i < GOLDEN_NH; i++) {
            golden_real value = q->h[k][i];
            for (j = 0; j < GOLDEN_NZ; j++) {
                value -= node->J[i][j] * ((j < GOLDEN_NX) ? q->dx[k][j] : q->du[k][j - GOLDEN_NX]);
            }
            node->h[i] = value;
        }
    }
    for (i = 0; i < GOLDEN_NH_N; i++) {
        s->terminal.h[i] = q->h_N[i];
        for (j = 0; j < GOLDEN_NX; j++) {
            s->terminal.h[i] -= s->terminal.J[i][j] * q->dx[GOLDEN_N][j];
        }
    }
    for (i = 0; i < GOLDEN_NE; i++) {
        s->coupled.r[i] = q->r[i];
        for (j = 0; j < GOLDEN_NX; j++) {
            s->coupled.r[i] -= s->coupled.J_0[i][j] * q->dx[0][j] + s->coupled.J_N[i][j] * q->dx[GOLDEN_N][j];
        }
    }
    memcpy(s->x, q->x, sizeof s->x);
    memcpy(s->u, q->u, sizeof s->u);
    condense_rows(s);
    for (m = 0; m < GOLDEN_NX; m++) {
        s->step.dx[0][m] = s->xhat[m] - s->x[0][m];
    }
    if (condense_solve(s) != GOLDEN_OK) {
        return 0;
    }
    memcpy(q->dx, s->step.dx, sizeof q->dx);
    memcpy(q->du, s->step.du, sizeof q->du);
    return step_is_finite(s);
}

/* The largest of the last merit values: steps may rise above the last one, which spares the full steps of
 * Gauss-Newton that a monotone search would cut (Grippo, Lampariello and Lucidi 1986). */
static golden_real merit_to_beat(golden_solver_t *s, int iteration, golden_real start)
{
    golden_real largest = start;
    int n;
    s->sqp.recent[iteration % GOLDEN_MEMORY] = start;
    for (n = 0; n < GOLDEN_MEMORY && n <= iteration; n++) {
        if (s->sqp.recent[n] > largest) {
            largest = s->sqp.recent[n];
        }
    }
    return largest;
}

/* Backtracking on the merit function, Armijo constant 1e-4; the full step gets one second-order correction. */
static golden_status_t line_search(golden_solver_t *s, golden_real start, golden_real slope)
{
    const golden_real rounding = 1.4210854715202004e-14 * (1.0 + fabs(start));
    golden_real alpha = 1.0;
    int trial;
    put_step_aside(s);
    for (trial = 0; trial < GOLDEN_MAX_TRIALS; trial++) {
        move_to(s, alpha);
        if (merit(s) <= start + 0.0001 * alpha * slope + rounding) {
            return GOLDEN_OK;
        }
        if (trial == 0) {
            memcpy(s->sqp.dx_full, s->sqp.dx, sizeof s->sqp.dx);
            memcpy(s->sqp.du_full, s->sqp.du, sizeof s->sqp.du);
            if (second_order_correction(s)) {
                move_to(s, 1.0);
                if (merit(s) <= start + 0.0001 * slope + rounding) {
                    return GOLDEN_OK;
                }
            }
            memcpy(s->sqp.dx, s->sqp.dx_full, sizeof s->sqp.dx);
            memcpy(s->sqp.du, s->sqp.du_full, sizeof s->sqp.du);
        }
        alpha *= 0.5;
    }
    move_to(s, 0.0);
    return GOLDEN_STALLED;
}

/* QP of the present linearisation; an infeasible one is solved with relaxed rows, penalty row_weight. */
static golden_status_t solve_qp(golden_solver_t *s)
{
    golden_status_t status = run_qp(s);
    s->sqp.elastic = status == GOLDEN_INFEASIBLE;
    if (s->sqp.elastic) {
        s->relaxation = s->sqp.row_weight;
        status = run_qp(s);
        s->relaxation = (golden_real)INFINITY;
    }
    return status;
}

/* One globalised iteration after prepare_here(). */
static golden_status_t sqp_iteration(golden_solver_t *s, int iteration)
{
    golden_real gaps, violation, penalties, later, penalties_later, start, slope;
    golden_status_t status = solve_qp(s);
    if (status != GOLDEN_OK) {
        return status;
    }
    if (!step_is_finite(s)) {
        return GOLDEN_NUMERICAL_FAILURE;
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
        return GOLDEN_NUMERICAL_FAILURE;
    }
    return line_search(s, merit_to_beat(s, iteration, start), (slope < 0.0) ? slope : 0.0);
}

/* 1 if the last step was elastic and moved nothing: the rows cannot be met near this point. */
static int stuck_infeasible(const golden_solver_t *s, golden_real tol)
{
    golden_real step = 0.0;
    int k, i;
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            enlarge(&step, s->sqp.dx[k][i]);
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NU; i++) {
            enlarge(&step, s->sqp.du[k][i]);
        }
    }
    return s->sqp.elastic && step <= tol;
}

static golden_status_t solve_here(golden_solver_t *s, golden_real tol, int max_iterations)
{
    int iteration;
    s->sqp.gap_weight = 1.0;
    s->sqp.row_weight = 1.0;
    for (iteration = 0;; iteration++) {
        golden_status_t status = prepare_here(s);
        s->stats.sqp_iterations = iteration;
        if (kkt_converged(s, tol)) {
            return GOLDEN_OK;
        }
        if (iteration >= max_iterations) {
            return GOLDEN_ITERATION_LIMIT;
        }
        if (status == GOLDEN_OK) {
            status = sqp_iteration(s, iteration);
        }
        if (s->sqp.elastic && (status == GOLDEN_STALLED || (status == GOLDEN_OK && stuck_infeasible(s, tol)))) {
            if (s->sqp.row_weight >= 100000000.0) {
                return GOLDEN_INFEASIBLE;
            }
            s->sqp.row_weight *= 10.0;
            continue;
        }
        if (status != GOLDEN_OK) {
            return status;
        }
    }
}

golden_status_t golden_solve(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real tol, int max_iterations)
{
    golden_status_t status;
    int i;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    s->prepared = 0;
    if (!take_state(s, xhat)) {
        return finish(s, GOLDEN_NOT_FINITE);
    }
    if (!(tol > 0.0) || max_iterations < 0) {
        return finish(s, GOLDEN_BAD_ARGUMENT);
    }
    for (i = 0; i < GOLDEN_NF; i++) {
        const golden_real guess = xhat[free_state[i]];
        s->x[0][free_state[i]] = isfinite(guess) ? guess : s->x[0][free_state[i]];
    }
    forget_violation(s);
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    status = solve_here(s, tol, max_iterations);
    if (status == GOLDEN_INFEASIBLE) {
        name_violation(s);
    }
    s->samples += (s->samples < GOLDEN_MANY);
    return finish(s, status);
}
