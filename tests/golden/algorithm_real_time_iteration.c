/* ==== algorithm: real_time_iteration ====================================================================== */

/* Seam "algorithm", contract: algorithm_reset, golden_prepare, _feedback, _step, _shift, _solve, _kkt.
 * Here: real-time iteration, one QP per sample, full step. */

/* The plain start: every state at its declared initial value, controls at their reference, multipliers 0. */
static void algorithm_reset(golden_solver_t *s)
{
    int k, i, j;
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            s->x[k][i] = initial_state[i];
            s->lam[k][i] = s->mu_x[k][i] = 0.0;
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            const int y = control_reference[j];
            s->u[k][j] = clip(y >= 0 ? s->yref[k][y] : 0.0, control_lower(s, k, j), control_upper(s, k, j));
            s->mu_u[k][j] = 0.0;
        }
        for (j = 0; j < GOLDEN_NH; j++) {
            s->mu[k][j] = 0.0;
        }
    }
    for (j = 0; j < GOLDEN_NH_N; j++) {
        s->mu_N[j] = 0.0;
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        s->xhat[i] = initial_state[i];
    }
    s->prepared = 0;
    s->samples = 0;
    s->status = (int32_t)GOLDEN_OK;
    qp_init(&s->qp);
    condense_init(s);
}

/* Node k: S = [A_k B_k], gap b_k = Phi(x_k, u_k) - x_{k+1}, gradient, general rows. */
static void linearize_node(const golden_solver_t *s, int k, golden_node_t *node)
{
    golden_real x_next[GOLDEN_NX];
    int i;
    integrator_interval(s->x[k], s->u[k], s->p[k], &interval_length[k], x_next, &node->S[0][0]);
    for (i = 0; i < GOLDEN_NX; i++) {
        node->b[i] = x_next[i] - s->x[k + 1][i];
    }
    path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W[0], node->g);
    path_rows(s->x[k], s->u[k], s->p[k], node->h, &node->J[0][0]);
}

static void linearize_terminal(const golden_solver_t *s, golden_terminal_t *terminal)
{
    terminal_gradient(s->x[GOLDEN_N], s->p[GOLDEN_N], s->yref_N, s->W_N, terminal->g);
    terminal_rows(s->x[GOLDEN_N], s->p[GOLDEN_N], terminal->h, &terminal->J[0][0]);
}

static void linearize(golden_solver_t *s)
{
    int k;
    for (k = 0; k < GOLDEN_N; k++) {
        linearize_node(s, k, &s->node[k]);
    }
    linearize_terminal(s, &s->terminal);
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

/* The control that is returned whenever no new one could be computed: the plan's, or 0, inside the bounds. */
static void safe_control(const golden_solver_t *s, golden_real *u0)
{
    int j;
    for (j = 0; j < GOLDEN_NU; j++) {
        const golden_real u = s->u[0][j];
        u0[j] = clip(isfinite(u) ? u : 0.0, control_lower(s, 0, j), control_upper(s, 0, j));
    }
}

static golden_status_t finish(golden_solver_t *s, golden_status_t status)
{
    s->status = (int32_t)status;
    return status;
}

/* Linearise, Hessian, condense, factorise at the predicted working set. */
static golden_status_t prepare_here(golden_solver_t *s)
{
    int i;
    linearize(s);
    hessian(s);
    condense_hessian(s);
    condense_gradient(s);
    condense_rows(s);
    s->reference_changed = 0;
    for (i = 0; i < GOLDEN_NX; i++) {
        s->condensed.dx[0][i] = 0.0;
    }
    condense_embed(s);
    return qp_factorize(&s->qp);
}

golden_status_t golden_prepare(golden_solver_t *s)
{
    golden_status_t status;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (GOLDEN_SHIFT && s->samples > 0 && !s->prepared) {
        golden_shift(s);
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
    terminal_adjoint(&s->terminal, s->hessian.Q_N, s->condensed.dx[GOLDEN_N], w);
    for (k = GOLDEN_N;; k--) {
        for (i = 0; i < GOLDEN_NX; i++) {
            w[i] += s->mu_x[k][i];
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
        adjoint_step(&s->node[k - 1], s->hessian.Q[GOLDEN_NQ == 1 ? 0 : k - 1], s->condensed.dx[k - 1],
            &s->qp.z[(k - 1) * GOLDEN_NU], w);
    }
    for (i = 0; i < GOLDEN_NF; i++) {
        s->lam[0][free_state[i]] = 0.0;
    }
}

/* Multipliers of the QP to the places of their rows. */
static void scatter_multipliers(golden_solver_t *s)
{
    int k, j, m;
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            s->mu_u[k][j] = s->qp.mult[k * GOLDEN_NU + j];
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        *row_multiplier_place(s, m) = s->qp.mult[GOLDEN_NV + m];
    }
}

/* 1 if the QP's step and multipliers are finite. */
static int step_is_finite(const golden_solver_t *s)
{
    golden_real probe = 0.0;
    int k, i;
    for (i = 0; i < GOLDEN_NV; i++) {
        probe += 0.0 * s->qp.z[i];
    }
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            probe += 0.0 * s->condensed.dx[k][i];
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
            s->x[k][i] += s->condensed.dx[k][i];
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            const golden_real u = s->u[k][j] + s->qp.z[k * GOLDEN_NU + j];
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

/* dx_0 = xhat - x_0 into the gradient and the bounds of the QP. */
static void embed_state(golden_solver_t *s)
{
    int i;
    for (i = 0; i < GOLDEN_NX; i++) {
        s->condensed.dx[0][i] = s->xhat[i] - s->x[0][i];
    }
    condense_embed(s);
}

/* The QP as it is embedded, and its counters. */
static golden_status_t run_qp(golden_solver_t *s)
{
    const golden_status_t status = qp_solve(&s->qp);
    s->stats.qp_iterations = s->qp.iterations;
    s->stats.active_set_changes = s->qp.changes;
    s->stats.dropped_rows = s->qp.dropped;
    return status;
}

/* Embed s->xhat, solve the QP, take the full step. The iterate changes only if all went well. */
static golden_status_t feedback_here(golden_solver_t *s)
{
    golden_status_t status;
    if (s->reference_changed) {
        renew_gradients(s);
    }
    embed_state(s);
    status = run_qp(s);
    if (status != GOLDEN_OK) {
        return status;
    }
    condense_expand(s);
    if (!step_is_finite(s)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    scatter_multipliers(s);
    recover_multipliers(s);
    take_step(s);
    return GOLDEN_OK;
}

golden_status_t golden_feedback(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU])
{
    golden_status_t status;
    int j;
    if (s->magic != GOLDEN_MAGIC) {
        for (j = 0; j < GOLDEN_NU; j++) {
            u0[j] = default_control[j];
        }
        return GOLDEN_NOT_INITIALIZED;
    }
    if (!s->prepared) {
        status = GOLDEN_NOT_PREPARED;
    } else if (!take_state(s, xhat)) {
        status = GOLDEN_NOT_FINITE;
    } else if (s->status != GOLDEN_OK) {
        status = (golden_status_t)s->status;
    } else {
        status = feedback_here(s);
    }
    s->prepared = 0;
    s->samples += (s->samples < GOLDEN_MANY);
    safe_control(s, u0);
    return finish(s, status);
}

golden_status_t golden_step(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU])
{
    (void)golden_prepare(s);
    return golden_feedback(s, xhat, u0);
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
    qp_shift_working_set(&s->qp, GOLDEN_NU, source);
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

/* Violation and complementarity of the rows of node k; h are its general rows. */
static void kkt_rows(const golden_solver_t *s, int k, const golden_real *h, golden_kkt_t *kkt)
{
    int m, j;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        kkt_row(kkt, row_value(s, m, h), row_lower(s, m), row_upper(s, m), row_multiplier(s, m));
    }
    for (j = 0; k < GOLDEN_N && j < GOLDEN_NU; j++) {
        kkt_row(kkt, s->u[k][j], control_lower(s, k, j), control_upper(s, k, j), s->mu_u[k][j]);
    }
}

/* Node k: gradient of the Lagrangian (q, r) + [A B]' lam_{k+1} - (lam_k, 0) + mu_x, mu_u + J' mu, and the gap. */
static void kkt_node(const golden_solver_t *s, int k, const golden_node_t *node, golden_kkt_t *kkt)
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
        sum += (i < GOLDEN_NX) ? s->mu_x[k][i] - s->lam[k][i] : s->mu_u[k][i - GOLDEN_NX];
        enlarge(&kkt->stationarity, sum);
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        enlarge(&kkt->equality, node->b[i]);
    }
    kkt_rows(s, k, node->h, kkt);
}

static void kkt_terminal(const golden_solver_t *s, const golden_terminal_t *terminal, golden_kkt_t *kkt)
{
    int i, j;
    for (i = 0; i < GOLDEN_NX; i++) {
        golden_real sum = terminal->g[i] + s->mu_x[GOLDEN_N][i] - s->lam[GOLDEN_N][i];
        for (j = 0; j < GOLDEN_NH_N; j++) {
            sum += terminal->J[j][i] * s->mu_N[j];
        }
        enlarge(&kkt->stationarity, sum);
        if (is_measured[i] || is_accumulator[i]) {
            enlarge(&kkt->equality, s->xhat[i] - s->x[0][i]);
        }
    }
    kkt_rows(s, GOLDEN_N, terminal->h, kkt);
}

/* KKT residuals of the present iterate, linearised afresh (on the stack: one node). */
void golden_kkt(const golden_solver_t *s, golden_kkt_t *out)
{
    golden_node_t node;
    golden_terminal_t terminal;
    int k;
    memset(out, 0, sizeof *out);
    memset(&node, 0, sizeof node);
    memset(&terminal, 0, sizeof terminal);
    for (k = 0; k < GOLDEN_N; k++) {
        linearize_node(s, k, &node);
        kkt_node(s, k, &node, out);
    }
    linearize_terminal(s, &terminal);
    kkt_terminal(s, &terminal, out);
}

/* KKT residuals from the linearisation that prepare has just left; 1 if all are at most tol. */
static int kkt_converged(golden_solver_t *s, golden_real tol)
{
    golden_kkt_t *kkt = &s->kkt;
    int k;
    memset(kkt, 0, sizeof *kkt);
    for (k = 0; k < GOLDEN_N; k++) {
        kkt_node(s, k, &s->node[k], kkt);
    }
    kkt_terminal(s, &s->terminal, kkt);
    return kkt->stationarity <= tol && kkt->equality <= tol && kkt->inequality <= tol && kkt->complementarity <= tol;
}

/* SQP to convergence: the pieces of the real-time iteration, globalised by a line search on the l1 merit function
 *
 *     phi = cost + gap_weight (sum |x_{k+1} - Phi_k| + |x_0 - xhat|) + row_weight (sum of row violations),
 *
 * with one second-order correction where the full step is refused, and an elastic QP (rows relaxed at row_weight) where
 * a linearisation is infeasible. */

/* Violation of the rows of node k; h are its general rows. */
static golden_real row_violation(const golden_solver_t *s, int k, const golden_real *h)
{
    golden_real sum = 0.0;
    int m;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        const golden_real value = row_value(s, m, h);
        sum += fabs(value - clip(value, row_lower(s, m), row_upper(s, m)));
    }
    return sum;
}

/* Constraints of the present iterate without derivatives: sqp.b = Phi(x_k, u_k) - x_{k+1}, general rows, and their norms. */
static void evaluate_constraints(golden_solver_t *s, golden_real *gaps, golden_real *violation)
{
    golden_sqp_t *q = &s->sqp;
    int k, i;
    *gaps = 0.0;
    *violation = 0.0;
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
        *violation += row_violation(s, k, q->h[k]);
    }
    terminal_rows(s->x[GOLDEN_N], s->p[GOLDEN_N], q->h_N, &q->J_N[0][0]);
    *violation += row_violation(s, GOLDEN_N, q->h_N);
}

static golden_real merit(golden_solver_t *s)
{
    golden_real gaps, violation;
    evaluate_constraints(s, &gaps, &violation);
    return golden_cost(s) + s->sqp.gap_weight * gaps + s->sqp.row_weight * violation;
}

/* The step of the QP and the point it starts from are put aside. */
static void put_step_aside(golden_solver_t *s)
{
    golden_sqp_t *q = &s->sqp;
    memcpy(q->x, s->x, sizeof s->x);
    memcpy(q->u, s->u, sizeof s->u);
    memcpy(q->dx, s->condensed.dx, sizeof s->condensed.dx);
    memcpy(q->du, s->qp.z, sizeof q->du);
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
            const golden_real u = q->u[k][j] + alpha * q->du[k * GOLDEN_NU + j];
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
        enlarge(&mu, row_multiplier(s, m));
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
        sum += s->terminal.g[i] * s->condensed.dx[GOLDEN_N][i];
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NX; i++) {
            sum += s->node[k].g[i] * s->condensed.dx[k][i];
        }
        for (i = 0; i < GOLDEN_NU; i++) {
            sum += s->node[k].g[GOLDEN_NX + i] * s->qp.z[k * GOLDEN_NU + i];
        }
    }
    return sum;
}

/* Violation of the linearised rows after the full step; 0 unless the QP was elastic. */
static golden_real linear_violation(const golden_solver_t *s)
{
    golden_real sum = 0.0;
    int m, i;
    for (m = 0; m < GOLDEN_NG; m++) {
        golden_real value = 0.0;
        for (i = 0; i < GOLDEN_NV; i++) {
            value += s->qp.A[m][i] * s->qp.z[i];
        }
        sum += fabs(value - clip(value, s->qp.lower[GOLDEN_NV + m], s->qp.upper[GOLDEN_NV + m]));
    }
    return sum;
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
        state_step(node, q->dx[k], &q->du[k * GOLDEN_NU], y);
        for (i = 0; i < GOLDEN_NX; i++) {
            node->b[i] = q->b[k][i] + q->dx[k + 1][i] - y[i];
        }
        for (i = 0; i < GOLDEN_NH; i++) {
            golden_real value = q->h[k][i];
            for (j = 0; j < GOLDEN_NZ; j++) {
                value -= node->J[i][j] * ((j < GOLDEN_NX) ? q->dx[k][j] : q->du[k * GOLDEN_NU + j - GOLDEN_NX]);
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
    memcpy(s->x, q->x, sizeof s->x);
    memcpy(s->u, q->u, sizeof s->u);
    condense_gradient(s);
    condense_rows(s);
    condense_embed(s);
    if (qp_solve(&s->qp) != GOLDEN_OK) {
        return 0;
    }
    condense_expand(s);
    for (m = 0; m < GOLDEN_NV; m++) {
        q->du[m] = s->qp.z[m];
    }
    memcpy(q->dx, s->condensed.dx, sizeof q->dx);
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
    golden_status_t status;
    int m;
    embed_state(s);
    s->sqp.elastic = 0;
    status = run_qp(s);
    if (status == GOLDEN_INFEASIBLE) {
        s->sqp.elastic = 1;
        for (m = 0; m < GOLDEN_NG; m++) {
            s->qp.penalty[m] = s->sqp.row_weight;
        }
        status = run_qp(s);
        for (m = 0; m < GOLDEN_NG; m++) {
            s->qp.penalty[m] = (golden_real)INFINITY;
        }
    }
    return status;
}

/* One globalised iteration after prepare_here(). */
static golden_status_t sqp_iteration(golden_solver_t *s, int iteration)
{
    golden_real gaps, violation, start, slope;
    golden_status_t status = solve_qp(s);
    if (status != GOLDEN_OK) {
        return status;
    }
    condense_expand(s);
    if (!step_is_finite(s)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    scatter_multipliers(s);
    recover_multipliers(s);
    update_weights(s);
    evaluate_constraints(s, &gaps, &violation);
    start = golden_cost(s) + s->sqp.gap_weight * gaps + s->sqp.row_weight * violation;
    slope = cost_slope(s) - s->sqp.gap_weight * gaps - s->sqp.row_weight * (violation - linear_violation(s));
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
    for (i = 0; i < GOLDEN_NV; i++) {
        enlarge(&step, s->sqp.du[i]);
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
    status = solve_here(s, tol, max_iterations);
    s->samples += (s->samples < GOLDEN_MANY);
    return finish(s, status);
}
