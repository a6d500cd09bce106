/* Component "algorithm". Contract: algorithm_reset, API(prepare), _feedback, _step, _shift, _kkt[if SOLVE:, _solve].
 * Here: real-time iteration, one QP and one full step per sample. What else happens stands in functions that are named
 * after it and the place of the call. */

#include "generated/hooks.c"

#include "algorithms/shared/plan.c"

#include "algorithms/shared/enlarge.c"

#include "algorithms/shared/forget_sizes.c"

#include "algorithms/shared/watch.c"

/* Values of renewal: gradients of the linearisation compared with references, weights and parameters. Weights and
 * parameters act at the next prepare; once one of them has changed, so do further references, as gradients that mix new
 * weights with the old linearisation would belong to no problem. */
enum { UP_TO_DATE, REFERENCE_CHANGED, HELD };

/* Resets the plan: every state at its declared initial value, controls at their references, multipliers 0. */
static void algorithm_reset(solver_t *s)
{
    forget_plan(s);
    s->prepared = 0;
    s->samples = 0;
    reset_watch(s);
    s->status = (int32_t)OK;
    s->relaxation = INF;
    memset(s->row_scale, 0, sizeof s->row_scale);
    forget_sizes(s);
    s->stats.violated_row = s->stats.violated_node = -1;
    start_at(s, initial_state);
    if (INNER) {
        reset_inner(s);
    }
    memcpy(s->xhat, s->x[0], sizeof s->xhat);
    on_reset(s);
}

#include "algorithms/shared/linearize.c"

#include "algorithms/shared/finish.c"

#include "algorithms/real_time_iteration/violation.c"

#include "algorithms/real_time_iteration/residual.c"

static void evaluate_bent(solver_t *s);

/* Linearises the present point and evaluates the Hessian. */
static void evaluate_here(solver_t *s)
{
    if (ROW_CURVATURE && s->bent) {
        evaluate_bent(s);
        return;
    }
    linearize(s);
    hessian(s);
    s->renewal = UP_TO_DATE;
}

/* Q += diag(proximal), by which a step of a control without curvature is limited; it vanishes at the solution. */
static void add_proximal(solver_t *s)
{
    for (int k = 0; k < NQ; k++) {
        for (int i = 0; i < NZ; i++) {
            s->hessian.Q[k][i][i] += proximal[i];
        }
    }
}

/* Evaluates, condenses and factorises at the plan. */
static status_t prepare_here(solver_t *s)
{
    evaluate_here(s);
    if (PROXIMAL) {
        add_proximal(s);
    }
    return condense_prepare(s);
}

/* Diagonal entry i of the Hessian of node k that the QP of the sample has. */
static inline real_t curvature_at(const solver_t *s, int k, int i)
{
    if (ROW_CURVATURE) {
        if (s->curved.in_solve) {
            return (k < N) ? s->curved.Q[k][i][i] : s->curved.Q_N[i][i];
        }
    }
    if (k < N) {
        return HESSIAN(s, k)[i][i];
    }
    if (TERMINAL_BLOCK) {
        return s->hessian.Q_N[i][i];
    } else {
        return R(0);
    }
}

/* Preparation phase. */
status_t API(prepare)(solver_t *s)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!LEVELS) {
        take_penalties(s);
    }
    s->newton = NEWTON;
    before_prepare(s);
    restart_doubtful_plan(s);
    if (INNER) {
        follow_inner(s);
    }
    status = prepare_plan(s);
    status = after_prepare(s, status);
    s->prepared = 1;
    return finish(s, status);
}

/* The multipliers of the QP become those of the plan. */
static void copy_multipliers(solver_t *s)
{
    memcpy(s->mu_u, s->step.mult_u, sizeof s->mu_u);
    memcpy(s->mult, s->step.mult, sizeof s->mult);
}

/* Returns 1 if the step of the QP is finite. */
static int step_is_finite(const solver_t *s)
{
    return all_finite(s->step.dx[0], (N + 1) * NX) && all_finite(s->step.du[0], N * NU);
}

/* x += dx, u += du. The controls are clipped afterwards because u + (upper - u) can exceed the bound by one ulp. */
static void take_step(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] = or_zero(s->x[k][i] + s->step.dx[k][i], i);
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->u[k][j] = or_zero(s->u[k][j] + s->step.du[k][j], NX + j);
            s->u[k][j] = safe_value(s, k, j);
        }
    }
}

#include "algorithms/shared/take_state.c"

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

/* The QP of a sample. */
static status_t run_sample_qp(solver_t *s)
{
    status_t status;
    before_qp(s);
    status = run_qp(s);
    status = after_qp(s, status);
    return status;
}

#if CHECK_STEP
#include "algorithms/real_time_iteration/check_step.c"
#else
#include "algorithms/real_time_iteration/check_finite.c"
#endif

#if HAS_ADJOINT_STEP
#include "algorithms/real_time_iteration/multipliers_by_adjoint.c"
#else
#include "algorithms/real_time_iteration/multipliers_of_stages.c"
#endif

/* The multipliers of the dynamics in the QP become those of the plan. Returns 0 if the gradient with respect to the
 * controls is known not to vanish. */
static int recover_multipliers(solver_t *s)
{
    return multipliers_of_qp(s, s->lam, 1);
}

/* The status of a sample; its QP belongs to the plan that was linearised. */
static status_t judge(solver_t *s, status_t status)
{
    status = after_feedback(s, status);
#if NALG
    require_algebraic(s);
#endif
    status = judge_residual(status, s->stats.residual);
    learn_sizes(s, status);
    return status;
}

/* Feedback phase: embeds the measured state s->xhat, solves the QP and takes the full step. States and controls change
 * only on success. */
static status_t feedback_here(solver_t *s)
{
    status_t status = run_sample_qp(s);
    if (status != OK && status != RELAXED) {
        return status;
    }
    if (!step_holds(s, status) || !plan_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
    copy_multipliers(s);
    if (!recover_multipliers(s) && status == OK) { /* those of relaxed rows drown the gradient in their rounding */
        return NUMERICAL_FAILURE;
    }
    take_step(s);
    if (PULLED_ROWS) {
        pull_back(s);
    }
    if (LAGRANGIAN && status == RELAXED) { /* its multipliers are those of the penalty, not of a plan */
        forget_multipliers(s);
    }
    on_success(s, status);
    return status;
}

#include "algorithms/shared/feedback.c"

#include "algorithms/shared/shift.c"

#include "algorithms/shared/kkt.c"

#if SOLVE
#include "algorithms/real_time_iteration/trial.c"

#include "algorithms/solve.c"
#endif

#include "generated/extras.c"
