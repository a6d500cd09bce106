/* Seam "algorithm", contract: algorithm_reset, API(prepare), _feedback, _step, _shift, _solve, _kkt.
 * Here: real-time iteration, one QP per sample, full step. */

/* What control j is without a plan: its reference, or 0, inside the bounds. */
static real_t reference_control(const solver_t *s, int k, int j)
{
    const int y = control_reference[j];
    (void)k;
    return clip(y >= 0 ? YREF(s, k)[y] : R(0), control_lower(s, k, j), control_upper(s, k, j));
}

/* Every state of the plan at x, every control where it is or, if that is not finite, at its reference; multipliers 0, empty
 * working set. */
static void start_at(solver_t *s, const real_t *x)
{
    int k, i, j;
    for (k = 0; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            s->x[k][i] = x[i];
            s->lam[k][i] = s->mu_x[k][i] = R(0);
        }
    }
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            const real_t u = s->u[k][j];
            s->u[k][j] = isfinite(u) ? clip(u, control_lower(s, k, j), control_upper(s, k, j)) : reference_control(s, k, j);
            s->mu_u[k][j] = R(0);
        }
        for (j = 0; j < NH; j++) {
            s->mu[k][j] = R(0);
        }
    }
    for (j = 0; j < NH_N; j++) {
        s->mu_N[j] = R(0);
    }
    for (j = 0; j < NE; j++) {
        s->eta[j] = R(0);
    }
    condense_init(s);
}

static void start_at_measured(solver_t *s)
{
    start_at(s, all_finite(s->xhat, NX) ? s->xhat : initial_state);
}

/* The plain start: every state at its declared initial value, controls at their reference, multipliers 0. */
static void algorithm_reset(solver_t *s)
{
    int k, j;
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            s->u[k][j] = reference_control(s, k, j);
        }
    }
    memcpy(s->xhat, initial_state, sizeof s->xhat);
    s->prepared = 0;
    s->samples = s->failing = 0;
    s->status = (int32_t)OK;
    s->relaxation = (real_t)INFINITY;
    s->stats.violated_row = s->stats.violated_node = -1;
    start_at(s, s->xhat);
}

/* Gap b_k = Phi(x_k, u_k) - x_{k+1} and general rows of node k. */
static void complete_node(const solver_t *s, int k, const real_t *x_next, node_t *node)
{
    int i;
    for (i = 0; i < NX; i++) {
        node->b[i] = x_next[i] - s->x[k + 1][i];
    }
    path_rows(s->x[k], s->u[k], PARAM(s, k), node->h, &node->J[0][0]);
}

/* First derivatives of node k alone: S = [A_k B_k], gradient, gap, general rows. */
static void linearize_node(const solver_t *s, int k, node_t *node)
{
    real_t x_next[NX];
    integrator_interval(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], x_next, &node->S[0][0]);
    path_gradient(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], YREF(s, k), WEIGHT(s, k), node->g);
    complete_node(s, k, x_next, node);
}

static void linearize_terminal(const solver_t *s, terminal_t *terminal)
{
    terminal_gradient(s->x[N], PARAM_N(s), YREF_N(s), WEIGHT_N(s), terminal->g);
    terminal_rows(s->x[N], PARAM_N(s), terminal->h, &terminal->J[0][0]);
}

static void linearize_coupled(const solver_t *s, coupled_t *coupled)
{
    coupled_rows(s->x[0], s->x[N], coupled->r, &coupled->J_0[0][0], &coupled->J_N[0][0]);
}

/* All nodes, from the last to the first, with what the Hessian takes from the same evaluation. */
static void linearize(solver_t *s)
{
    real_t x_next[NX];
    int k;
    linearize_terminal(s, &s->terminal);
    linearize_coupled(s, &s->coupled);
    for (k = N - 1; k >= 0; k--) {
        expand_node(s, k, x_next);
        complete_node(s, k, x_next, &s->node[k]);
    }
}

/* References entered after prepare: gradients anew, everything else stands. */
static void renew_gradients(solver_t *s)
{
    int k;
    for (k = 0; k < N; k++) {
        path_gradient(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], YREF(s, k), WEIGHT(s, k), s->node[k].g);
    }
    terminal_gradient(s->x[N], PARAM_N(s), YREF_N(s), WEIGHT_N(s), s->terminal.g);
    condense_gradient(s);
    s->reference_changed = 0;
}

/* The control that is returned whenever no new one could be computed: the plan's, or its reference, inside the bounds. */
static void safe_control(const solver_t *s, real_t *u0)
{
    int j;
    for (j = 0; j < NU; j++) {
        const real_t u = s->u[0][j];
        u0[j] = isfinite(u) ? clip(u, control_lower(s, 0, j), control_upper(s, 0, j)) : reference_control(s, 0, j);
    }
}

static status_t finish(solver_t *s, status_t status)
{
    s->status = (int32_t)status;
    return status;
}

/* Linearise, Hessian, condense, factorise. */
static status_t prepare_here(solver_t *s)
{
    linearize(s);
    hessian(s);
    s->reference_changed = 0;
    return condense_prepare(s);
}

status_t API(prepare)(solver_t *s)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (SHIFT && s->samples > 0 && !s->prepared) {
        API(shift)(s);
        if (s->failing == 2) { /* states that a shift has integrated from the measured one would be as lost as the plan */
            start_at_measured(s);
        }
    }
    status = prepare_here(s);
    s->prepared = 1;
    return finish(s, status);
}

/* lam_N = q_N + Q_N dx_N + (rows)_N,  lam_k = q_k + Q_k dx_k + S_k' du_k + A_k' lam_{k+1} + (rows)_k. */
static void recover_multipliers(solver_t *s)
{
    real_t w[NZ];
    int k, i, j;
    terminal_adjoint(&s->terminal, s->hessian.Q_N, s->step.dx[N], w);
    for (k = N;; k--) {
        for (i = 0; i < NX; i++) {
            w[i] += s->mu_x[k][i];
            for (j = 0; j < NE; j++) {
                w[i] += ((k == N) ? s->coupled.J_N[j][i] * s->eta[j] : R(0)) +
                    ((k == 0) ? s->coupled.J_0[j][i] * s->eta[j] : R(0));
            }
            for (j = 0; k < N && j < NH; j++) {
                w[i] += s->node[k].J[j][i] * s->mu[k][j];
            }
            for (j = 0; k == N && j < NH_N; j++) {
                w[i] += s->terminal.J[j][i] * s->mu_N[j];
            }
            s->lam[k][i] = w[i];
        }
        if (k == 0) {
            break;
        }
        adjoint_step(&s->node[k - 1], s->hessian.Q[NQ == 1 ? 0 : k - 1], s->step.dx[k - 1],
            s->step.du[k - 1], w);
    }
    for (i = 0; i < NF; i++) {
        s->lam[0][free_state[i]] = R(0);
    }
}

/* Multipliers of the QP to the places of their rows. */
static void scatter_multipliers(solver_t *s)
{
    int m;
    memcpy(s->mu_u, s->step.mult_u, sizeof s->mu_u);
    for (m = 0; m < NG; m++) {
        *row_multiplier_place(s, m) = s->step.mult[m];
    }
}

/* 1 if the QP's step is finite. */
static int step_is_finite(const solver_t *s)
{
    real_t probe = R(0);
    int k, i;
    for (k = 0; k < N; k++) {
        for (i = 0; i < NU; i++) {
            probe += R(0) * s->step.du[k][i];
        }
    }
    for (k = 0; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            probe += R(0) * s->step.dx[k][i];
        }
    }
    return isfinite(probe) != 0;
}

/* x += dx, u += du. The controls are clipped last: u + (upper - u) can exceed the bound by an ulp. */
static void take_step(solver_t *s)
{
    int k, i, j;
    for (k = 0; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            s->x[k][i] += s->step.dx[k][i];
        }
    }
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            const real_t u = s->u[k][j] + s->step.du[k][j];
            s->u[k][j] = clip(u, control_lower(s, k, j), control_upper(s, k, j));
        }
    }
}

/* s->xhat = xhat where it is measured, 0 for accumulators, the plan's own value where x_0 is free; 0 is returned if a
 * measured entry is not finite. */
static int take_state(solver_t *s, const real_t *xhat)
{
    int i;
    for (i = 0; i < NX; i++) {
        if (is_measured[i] && !isfinite(xhat[i])) {
            return 0;
        }
    }
    for (i = 0; i < NX; i++) {
        s->xhat[i] = is_measured[i] ? xhat[i] : (is_accumulator[i] ? R(0) : s->x[0][i]);
    }
    return 1;
}

/* The QP for dx_0 = xhat - x_0 and the present bounds, and its counters. */
static status_t run_qp(solver_t *s)
{
    status_t status;
    int i;
    for (i = 0; i < NX; i++) {
        s->step.dx[0][i] = s->xhat[i] - s->x[0][i];
    }
    status = condense_solve(s);
    s->stats.qp_iterations = s->qp.iterations;
    s->stats.active_set_changes = s->qp.changes;
    s->stats.dropped_rows = s->qp.dropped;
    s->stats.relaxed_rows = s->qp.relaxed;
    return status;
}

#include "algorithms/failure.c"

/* Embed s->xhat, solve the QP, take the full step. The iterate changes only if all went well. */
static status_t feedback_here(solver_t *s)
{
    status_t status;
    if (s->reference_changed) {
        renew_gradients(s);
    }
    status = run_qp(s);
    if (status == INFEASIBLE) {
        status = relax_qp(s);
    }
    if (status != OK && status != RELAXED) {
        return status;
    }
    if (!step_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
    scatter_multipliers(s);
    recover_multipliers(s);
    take_step(s);
    return status;
}

status_t API(feedback)(solver_t *s, const real_t xhat[NX], real_t u0[NU])
{
    status_t status;
    int measured, j;
    if (s->magic != MAGIC) {
        for (j = 0; j < NU; j++) {
            u0[j] = default_control[j];
        }
        return NOT_INITIALIZED;
    }
    measured = take_state(s, xhat);
    forget_violation(s);
    if (!s->prepared) {
        status = NOT_PREPARED;
    } else if (!measured) {
        status = NOT_FINITE;
    } else if (s->status != OK) {
        status = (status_t)s->status;
    } else {
        status = feedback_here(s);
    }
    s->prepared = 0;
    s->samples += (s->samples < MANY);
    safe_control(s, u0);
    recover(s, status);
    return finish(s, status);
}

status_t API(step)(solver_t *s, const real_t xhat[NX], real_t u0[NU])
{
    (void)API(prepare)(s);
    return API(feedback)(s, xhat, u0);
}

#if SHIFT_RESAMPLE
#include "algorithms/shift_resample.c"
#else
#include "algorithms/shift_by_one.c"

#if SHIFT_PERIODIC
#include "algorithms/shift_periodic.c"
#else
#include "algorithms/shift_repeat.c"
#endif
#endif


status_t API(shift)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    shift_plan(s);
    s->prepared = 0;
    return OK;
}

/* max |a|, a NaN wins. */
static void enlarge(real_t *largest, real_t value)
{
    const real_t a = FABS(value);
    if (!(a <= *largest)) {
        *largest = a;
    }
}

/* One row lower <= value <= upper with multiplier mu: violation, and |mu| times the distance to the bound it pushes at. */
static void kkt_row(kkt_t *kkt, real_t value, real_t lower, real_t upper, real_t mu)
{
    if (!(value >= lower)) {
        enlarge(&kkt->inequality, lower - value);
    }
    if (!(value <= upper)) {
        enlarge(&kkt->inequality, value - upper);
    }
    if (lower < upper && mu > R(0)) {
        enlarge(&kkt->complementarity, mu * (upper - value));
    }
    if (lower < upper && mu < R(0)) {
        enlarge(&kkt->complementarity, mu * (value - lower));
    }
}

/* One side of a soft row, excess over its bound and multiplier m >= 0: conditions of min l1 v + l2/2 v^2, v >= excess, v >= 0
 * at v = max(0, excess); nu = l1 + l2 v - m >= 0 is the multiplier of v >= 0. */
static void kkt_soft_side(kkt_t *kkt, real_t excess, real_t m, real_t l1, real_t l2)
{
    const real_t v = (excess > R(0)) ? excess : R(0);
    const real_t nu = l1 + l2 * v - m;
    enlarge(&kkt->complementarity, nu * v);
    if (!(nu >= R(0))) {
        enlarge(&kkt->complementarity, nu);
    }
    if (m > R(0)) {
        enlarge(&kkt->complementarity, m * (excess - v));
    }
}

/* Violation and complementarity of the rows of node k; h are its general rows, r the coupled ones. */
static void kkt_rows(const solver_t *s, int k, const real_t *h, const real_t *r, kkt_t *kkt)
{
    int m, j;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        const real_t l1 = row_l1[row_id[m]], value = row_value(s, m, h, r);
        if (l1 < (real_t)INFINITY) {
            const real_t mu = row_multiplier(s, m), l2 = row_curvature(m);
            kkt_soft_side(kkt, value - row_upper(s, m), (mu > R(0)) ? mu : R(0), l1, l2);
            kkt_soft_side(kkt, row_lower(s, m) - value, (mu < R(0)) ? -mu : R(0), l1, l2);
        } else {
            kkt_row(kkt, value, row_lower(s, m), row_upper(s, m), row_multiplier(s, m));
        }
    }
    for (j = 0; k < N && j < NU; j++) {
        kkt_row(kkt, s->u[k][j], control_lower(s, k, j), control_upper(s, k, j), s->mu_u[k][j]);
    }
}

/* Node k: gradient of the Lagrangian (q, r) + [A B]' lam_{k+1} - (lam_k, 0) + mu_x, mu_u + J' mu, and the gap. */
static void kkt_node(const solver_t *s, int k, const node_t *node, const coupled_t *coupled, kkt_t *kkt)
{
    int i, j;
    for (i = 0; i < NZ; i++) {
        real_t sum = node->g[i];
        for (j = 0; j < NX; j++) {
            sum += node->S[j][i] * s->lam[k + 1][j];
        }
        for (j = 0; j < NH; j++) {
            sum += node->J[j][i] * s->mu[k][j];
        }
        for (j = 0; k == 0 && i < NX && j < NE; j++) {
            sum += coupled->J_0[j][i] * s->eta[j];
        }
        sum += (i < NX) ? s->mu_x[k][i] - s->lam[k][i] : s->mu_u[k][i - NX];
        enlarge(&kkt->stationarity, sum);
    }
    for (i = 0; i < NX; i++) {
        enlarge(&kkt->equality, node->b[i]);
    }
    kkt_rows(s, k, node->h, coupled->r, kkt);
}

static void kkt_terminal(const solver_t *s, const terminal_t *terminal, const coupled_t *coupled,
    kkt_t *kkt)
{
    int i, j;
    for (i = 0; i < NX; i++) {
        real_t sum = terminal->g[i] + s->mu_x[N][i] - s->lam[N][i];
        for (j = 0; j < NH_N; j++) {
            sum += terminal->J[j][i] * s->mu_N[j];
        }
        for (j = 0; j < NE; j++) {
            sum += coupled->J_N[j][i] * s->eta[j];
        }
        enlarge(&kkt->stationarity, sum);
        if (is_measured[i] || is_accumulator[i]) {
            enlarge(&kkt->equality, s->xhat[i] - s->x[0][i]);
        }
    }
    kkt_rows(s, N, terminal->h, coupled->r, kkt);
}

/* KKT residuals of the present iterate, linearised afresh (on the stack: one node). */
void API(kkt)(const solver_t *s, kkt_t *out)
{
    node_t node;
    terminal_t terminal;
    coupled_t coupled;
    int k;
    memset(out, 0, sizeof *out);
    memset(&node, 0, sizeof node);
    memset(&terminal, 0, sizeof terminal);
    memset(&coupled, 0, sizeof coupled);
    linearize_coupled(s, &coupled);
    for (k = 0; k < N; k++) {
        linearize_node(s, k, &node);
        kkt_node(s, k, &node, &coupled, out);
    }
    linearize_terminal(s, &terminal);
    kkt_terminal(s, &terminal, &coupled, out);
}

/* KKT residuals from the linearisation that prepare has just left; 1 if all are at most tol. */
static int kkt_converged(solver_t *s, real_t tol)
{
    kkt_t *kkt = &s->kkt;
    int k;
    memset(kkt, 0, sizeof *kkt);
    for (k = 0; k < N; k++) {
        kkt_node(s, k, &s->node[k], &s->coupled, kkt);
    }
    kkt_terminal(s, &s->terminal, &s->coupled, kkt);
    return kkt->stationarity <= tol && kkt->equality <= tol && kkt->inequality <= tol && kkt->complementarity <= tol;
}

#include "algorithms/solve.c"

status_t API(solve)(solver_t *s, const real_t xhat[NX], real_t tol, int max_iterations)
{
    status_t status;
    int i;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    s->prepared = 0;
    if (!take_state(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    if (!(tol > R(0)) || max_iterations < 0) {
        return finish(s, BAD_ARGUMENT);
    }
    for (i = 0; i < NF; i++) {
        const real_t guess = xhat[free_state[i]];
        s->x[0][free_state[i]] = isfinite(guess) ? guess : s->x[0][free_state[i]];
    }
    forget_violation(s);
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    status = solve_here(s, tol, max_iterations);
    if (status == INFEASIBLE) {
        name_violation(s);
    }
    s->samples += (s->samples < MANY);
    return finish(s, status);
}
