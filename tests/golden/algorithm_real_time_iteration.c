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
            s->u[k][j] = clip(y >= 0 ? s->yref[k][y] : 0.0, control_lower(s, j), control_upper(s, j));
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
    path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W, node->g);
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
        path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W, s->node[k].g);
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
        u0[j] = clip(isfinite(u) ? u : 0.0, control_lower(s, j), control_upper(s, j));
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
            return;
        }
        adjoint_step(&s->node[k - 1], s->hessian.Q[GOLDEN_NQ == 1 ? 0 : k - 1], s->condensed.dx[k - 1],
            &s->qp.z[(k - 1) * GOLDEN_NU], w);
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
            s->u[k][j] = clip(u, control_lower(s, j), control_upper(s, j));
        }
    }
}

/* Embed xhat, solve the QP, take the full step. The iterate changes only if all went well. */
static golden_status_t feedback_here(golden_solver_t *s, const golden_real *xhat)
{
    golden_status_t status;
    int i;
    if (s->reference_changed) {
        renew_gradients(s);
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        s->xhat[i] = xhat[i];
        s->condensed.dx[0][i] = xhat[i] - s->x[0][i];
    }
    condense_embed(s);
    status = qp_solve(&s->qp);
    s->stats.qp_iterations = s->qp.iterations;
    s->stats.active_set_changes = s->qp.changes;
    s->stats.dropped_rows = s->qp.dropped;
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
    } else if (!all_finite(xhat, GOLDEN_NX)) {
        status = GOLDEN_NOT_FINITE;
    } else if (s->status != GOLDEN_OK) {
        status = (golden_status_t)s->status;
    } else {
        status = feedback_here(s, xhat);
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

/* The plan moves by one interval: x_k <- x_{k+1}, u_k <- u_{k+1}, the last control is repeated and the tail integrated
 * (x_N stays if that overflows); multipliers and the working set move with it. */
golden_status_t golden_shift(golden_solver_t *s)
{
    golden_real tail[GOLDEN_NX];
    int k, i, j;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    for (k = 0; k < GOLDEN_N; k++) {
        const int from = (k + 1 < GOLDEN_N) ? k + 1 : k;
        for (i = 0; i < GOLDEN_NX; i++) {
            s->x[k][i] = s->x[k + 1][i];
            s->lam[k][i] = s->lam[k + 1][i];
            s->mu_x[k][i] = (k + 1 < GOLDEN_N) ? s->mu_x[k + 1][i] : s->mu_x[k][i];
        }
        for (j = 0; j < GOLDEN_NU; j++) {
            s->u[k][j] = s->u[from][j];
            s->mu_u[k][j] = s->mu_u[from][j];
        }
        for (j = 0; j < GOLDEN_NH; j++) {
            s->mu[k][j] = s->mu[from][j];
        }
    }
    integrate(s->x[GOLDEN_N - 1], s->u[GOLDEN_N - 1], s->p[GOLDEN_N - 1], interval_length[GOLDEN_N - 1], tail);
    if (all_finite(tail, GOLDEN_NX)) {
        memcpy(s->x[GOLDEN_N], tail, sizeof tail);
    }
    qp_shift_working_set(&s->qp, GOLDEN_NU);
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
        kkt_row(kkt, s->u[k][j], control_lower(s, j), control_upper(s, j), s->mu_u[k][j]);
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
        enlarge(&kkt->equality, s->xhat[i] - s->x[0][i]);
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

/* Full-step SQP: prepare, test, feedback, until all KKT residuals are at most tol. */
static golden_status_t solve_here(golden_solver_t *s, const golden_real *xhat, golden_real tol, int max_iterations)
{
    int iteration, i;
    for (i = 0; i < GOLDEN_NX; i++) {
        s->xhat[i] = xhat[i];
    }
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
            status = feedback_here(s, xhat);
        }
        if (status != GOLDEN_OK) {
            return status;
        }
    }
}

golden_status_t golden_solve(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real tol, int max_iterations)
{
    golden_status_t status;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    s->prepared = 0;
    if (!all_finite(xhat, GOLDEN_NX)) {
        return finish(s, GOLDEN_NOT_FINITE);
    }
    if (!(tol > 0.0) || max_iterations < 0) {
        return finish(s, GOLDEN_BAD_ARGUMENT);
    }
    status = solve_here(s, xhat, tol, max_iterations);
    s->samples += (s->samples < GOLDEN_MANY);
    return finish(s, status);
}
