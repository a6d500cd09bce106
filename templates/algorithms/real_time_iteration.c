/* Component "algorithm". Contract: algorithm_reset, API(prepare), _feedback, _step, _shift, _kkt and, if SOLVE, _solve.
 * Here: real-time iteration, one QP and one full step per sample. */

#include "algorithms/plan.c"

#include "algorithms/enlarge.c"

/* Resets the plan: every state at its declared initial value, controls at their references, multipliers 0. */
static void algorithm_reset(solver_t *s)
{
    forget_plan(s);
    s->prepared = 0;
#if SHIFT || REPAIR
    s->samples = 0;
#endif
#if REPAIR
    s->unconverged = 0;
#endif
    s->failing = FINE;
#if LEVELS
    s->levels.valid = 0;
#endif
#if LAGRANGIAN
    s->unsettled = 0;
    memset(s->lam_before, 0, sizeof s->lam_before);
#endif
    s->status = (int32_t)OK;
#if RELAXATION
    s->relaxation = INF;
#endif
#if ROW_SCALES
    memset(s->row_scale, 0, sizeof s->row_scale);
#endif
    s->stats.violated_row = s->stats.violated_node = -1;
    start_at(s, initial_state);
    memcpy(s->xhat, s->x[0], sizeof s->xhat);
}

#include "algorithms/linearize.c"

#if SET_REFERENCE
/* Values of renewal: gradients of the linearisation compared with references, weights and parameters. Weights and
 * parameters act at the next prepare; once one of them has changed, so do further references, as gradients that mix new
 * weights with the old linearisation would belong to no problem. */
enum { UP_TO_DATE, REFERENCE_CHANGED, HELD };

#if LEVELS
static status_t evaluate(solver_t *s, int level);

#endif
/* Recomputes the gradients after references have changed since prepare; the rest of the linearisation remains valid. */
static void renew_gradients(solver_t *s)
{
#if LEVELS
    if (s->levels.last != LEVEL_A) { /* what level C adds to a gradient is not stored on its own */
        (void)evaluate(s, (s->levels.last == LEVEL_C) ? LEVEL_C : LEVEL_B);
        return;
    }
#endif
#if HAS_PATH_GRADIENT
    for (int k = 0; k < N; k++) {
        PATH_GRADIENT(s, k, s->node[k].g);
    }
#if HAS_START_GRADIENT
    add_start_gradient(s, s->node[0].g);
#endif
#endif
#if HAS_TERMINAL_GRADIENT
    TERMINAL_GRADIENT(s, s->terminal.g);
#endif
    condense_gradient(s);
    s->renewal = UP_TO_DATE;
}

#if SET_WEIGHT || SET_PARAMETER
/* Called before a weight or parameter changes: references that have changed before take effect with the old values. */
static void hold_gradients(solver_t *s)
{
    if (s->prepared && s->renewal == REFERENCE_CHANGED) {
        renew_gradients(s);
    }
    s->renewal = HELD;
}
#endif
#endif

#include "algorithms/finish.c"

#if NONLINEAR_ROWS
static real_t nodal_change(const solver_t *s, int m);

#endif
#include "algorithms/residual.c"

/* Linearises the present point and evaluates the Hessian. */
static void evaluate_here(solver_t *s)
{
    linearize(s);
#if HAS_PATH_HESSIAN || HAS_TERMINAL_HESSIAN || HAS_START_HESSIAN || HAS_INITIAL_HESSIAN || REGULARIZE_STAGES
    hessian(s);
#endif
#if SET_REFERENCE
    s->renewal = UP_TO_DATE;
#endif
}

/* Preparation phase: evaluates, condenses and factorises. */
static status_t prepare_here(solver_t *s)
{
    evaluate_here(s);
    return condense_prepare(s);
}

#if SIMULATE
#include "algorithms/simulate.c"

#endif
#if REPAIR
static status_t repair(solver_t *s, status_t status);
static int stays_far(solver_t *s);

#endif
#if LAGRANGIAN
#include "algorithms/settle.c"

#endif
#if FIRST
static void first_prepare(solver_t *s);

#endif
#if LEVELS
#include "algorithms/levels.c"

static status_t prepare_at(solver_t *s, int level)
#else
status_t API(prepare)(solver_t *s)
#endif
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
#if SHIFT
    if (s->samples > 0 && !s->prepared) {
        API(shift)(s);
        if (s->failing >= TWICE) { /* states that the shift integrates may be as far off as the failed plan */
            start_at_measured(s);
        }
    }
#endif
#if LAGRANGIAN
    settle(s);
#endif
#if REPAIR
    if (s->unconverged >= PATIENCE) { /* repair leads nowhere from here */
        start_anew(s);
        s->unconverged = 0;
    }
#endif
#if SIMULATE
    status = prepare_simulated(s);
#elif LEVELS
    status = evaluate(s, level);
    measure_residual(s);
#else
    status = prepare_here(s);
    measure_residual(s);
#endif
#if REPAIR && LEVELS
    if (s->levels.last == LEVEL_A) {
        status = repair(s, status);
        memcpy(s->levels.x, s->x, sizeof s->levels.x);
        memcpy(s->levels.u, s->u, sizeof s->levels.u);
    }
#elif REPAIR
    status = repair(s, status);
#endif
#if ADVANCED
    status = (status == OK) ? advance(s) : status;
#endif
    s->prepared = 1;
#if FIRST
    first_prepare(s);
#endif
    return finish(s, status);
}

#if LEVELS
status_t API(prepare)(solver_t *s)
{
    return prepare_at(s, LEVEL_A);
}

status_t API(prepare_level)(solver_t *s, int level)
{
    return (level < LEVEL_A || level > LEVEL_D) ? BAD_ARGUMENT : prepare_at(s, level);
}
#endif

/* Copies the multipliers of the QP to the multipliers of the corresponding rows; those of states without a row are 0. */
static void scatter_multipliers(solver_t *s)
{
    memset(s->mu_x, 0, sizeof s->mu_x);
    memcpy(s->mu_u, s->step.mult_u, sizeof s->mu_u);
#if NG
    for (int m = 0; m < NG; m++) {
        ROW_MULTIPLIER(s, m) = s->step.mult[m];
    }
#endif
}

#if SOLVE || !CHECK_STEP
/* Returns 1 if the step of the QP is finite. */
static int step_is_finite(const solver_t *s)
{
    return all_finite(s->step.dx[0], (N + 1) * NX) && all_finite(s->step.du[0], N * NU);
}
#endif

/* x += dx, u += du. The controls are clipped afterwards because u + (upper - u) can exceed the bound by one ulp. */
static void take_step(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] += s->step.dx[k][i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->u[k][j] += s->step.du[k][j];
            s->u[k][j] = safe_value(s, k, j);
        }
    }
}

#include "algorithms/take_state.c"

/* Solves the QP for dx_0 = xhat - x_0 and the present bounds, and copies its counters to the statistics. */
static status_t run_qp(solver_t *s)
{
    status_t status;
    for (int i = 0; i < NX; i++) {
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

#if CHECK_STEP
#include "algorithms/check_step.c"
#endif

#if HAS_ADJOINT_STEP
#if NE || NH || NH_N
/* w += gradient of the general and coupled rows of node k with respect to its state, times their multipliers. */
static void add_row_forces(const solver_t *s, int k, real_t *w)
{
    for (int i = 0; i < NX; i++) {
#if NE
        for (int j = 0; j < NE && (k == 0 || k == N); j++) {
            w[i] += ((k == N) ? s->coupled.J_N[j][i] : s->coupled.J_0[j][i]) * s->eta[j];
        }
#endif
#if NH
        for (int j = 0; j < NH && k < N; j++) {
            w[i] += s->node[k].J[j][i] * s->mu[k][j];
        }
#endif
#if NH_N
        for (int j = 0; j < NH_N && k == N; j++) {
            w[i] += s->terminal.J[j][i] * s->mu_N[j];
        }
#endif
    }
}
#endif

/* lam_N = q_N + Q_N dx_N + (rows)_N,  lam_k = q_k + Q_k dx_k + S_k' du_k + A_k' lam_{k+1} + (rows)_k. Returns 0 if the
 * gradient with respect to the controls is known not to vanish. */
static int recover_multipliers(solver_t *s)
{
    int held = 1;
    real_t w[NZ];
#if CHECK_GRADIENT
    real_t least = R(0);
#endif
    TERMINAL_ADJOINT(&s->terminal, s->hessian.Q_N, s->step.dx[N], w);
#if CURVED
    if (s->curved.in_solve) {
        add_terminal_curvature(s, s->step.dx[N], w);
    }
#endif
    for (int k = N; k >= 0; k--) {
#if NE || NH || NH_N
        add_row_forces(s, k, w);
#endif
        for (int i = 0; i < NX; i++) {
            w[i] += s->mu_x[k][i];
            s->lam[k][i] = w[i];
        }
        if (k == 0) {
            break;
        }
        ADJOINT_STEP(&s->node[k - 1], HESSIAN(s, k - 1), s->step.dx[k - 1], s->step.du[k - 1], w);
#if CURVED
        if (s->curved.in_solve) {
            add_curvature(s, k - 1, s->step.dx[k - 1], s->step.du[k - 1], w);
        }
#endif
#if CHECK_GRADIENT
        held &= controls_hold(s, k - 1, w, &least);
#endif
    }
#if CHECK_GRADIENT
#if REGULARIZE_REDUCED
    held |= s->condensed.regularized;
#endif
#endif
#if NF
    for (int f = 0; f < NF; f++) {
        s->lam[0][free_state[f]] = R(0);
    }
#endif
    return held;
}
#else
/* lam_k as the QP yields it, whose stages are those of the problem; there, x_0 is not a variable of the coupled rows. */
static void multiplier_of_qp(const solver_t *s, int k, real_t *lam)
{
    memcpy(lam, condense_multiplier(s, k), NX * sizeof *lam);
#if NE
    for (int m = 0; k == 0 && m < NG; m++) {
        for (int i = 0; IS_COUPLED(m) && i < NX; i++) {
            lam[i] += s->coupled.J_0[row_index[m]][i] * s->step.mult[m];
        }
    }
#endif
#if NF
    for (int f = 0; k == 0 && f < NF; f++) {
        lam[free_state[f]] = R(0);
    }
#endif
}

static int recover_multipliers(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        multiplier_of_qp(s, k, s->lam[k]);
    }
    return 1;
}
#endif

/* The status of a sample; its QP belongs to the plan that was linearised. */
static status_t judge(solver_t *s, status_t status)
{
    status = judged(status, s->stats.residual);
#if REPAIR
    status = (status == OK && stays_far(s)) ? NOT_CONVERGED : status;
    s->unconverged = (status == NOT_CONVERGED) ? s->unconverged + 1 : 0;
#endif
    return status;
}

/* Feedback phase: embeds the measured state s->xhat, solves the QP and takes the full step. States and controls change only on
 * success. */
static status_t feedback_here(solver_t *s)
{
#if CHECK_STEP
    real_t size[NZ] = {0};
#endif
    status_t status;
#if SET_REFERENCE
    if (s->renewal == REFERENCE_CHANGED) {
        renew_gradients(s);
    }
#endif
    status = run_sample_qp(s);
    if (status != OK && status != RELAXED) {
        return status;
    }
#if CHECK_STEP
    if (!step_sizes(s, size) || !plan_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
#if HARD_ROWS
    if (status == OK && !rows_hold(s, size)) {
        return NUMERICAL_FAILURE;
    }
#endif
#else
    if (!step_is_finite(s) || !plan_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
#endif
    scatter_multipliers(s);
    if (!recover_multipliers(s)) {
        return NUMERICAL_FAILURE;
    }
#if LAGRANGIAN
    if (status == RELAXED) { /* its multipliers are those of the penalty, not of a plan */
        forget_multipliers(s);
    }
    watch_multipliers(s);
#endif
    take_step(s);
#if NONLINEAR_ROWS
    s->row_residual = row_residual(s, R(1));
#endif
    return status;
}

#include "algorithms/feedback.c"

#if LEVELS
status_t API(iterate)(solver_t *s, int level)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (level < LEVEL_A || level > LEVEL_D) {
        return BAD_ARGUMENT;
    }
    forget_violation(s);
    status = evaluate(s, level);
    measure_residual(s);
    status = (status == OK) ? step_at_plan(s) : status;
    s->levels.valid &= (status == OK || status == RELAXED);
    s->prepared = 0;
    return finish(s, judge(s, status));
}
#endif

#if FIRST
#include "algorithms/feedback_first.c"
#endif

#include "algorithms/shift.c"

#include "algorithms/kkt.c"
#if SOLVE

#include "algorithms/solve.c"
#endif
#if REPAIR

#include "algorithms/repair.c"
#endif
