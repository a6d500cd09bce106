/* Component "algorithm". Contract: algorithm_reset, API(prepare) and the other functions of the interface. Here:
 * real-time iteration, one QP and one full step per sample. Further behaviour stands in hooks: functions named after
 * the behaviour and the point at which they are called. */

#include "generated/hooks.c"

#include "algorithms/shared/plan.c"

#include "algorithms/shared/enlarge.c"

#include "algorithms/shared/forget_sizes.c"

#include "algorithms/shared/watch.c"

/* Values of renewal: the gradients belong to the present data; references have changed; further changes are held until
 * the next prepare. Weights and parameters act at the next prepare. Once one of them has changed, so do further
 * references, as gradients that mix new weights with the old linearisation would belong to no problem. */
enum { UP_TO_DATE, REFERENCE_CHANGED, HELD };

/* Resets the plan: every state at its declared initial value, controls at their references, multipliers 0. */
static void algorithm_reset(solver_t *s)
{
    forget_plan(s);
    s->prepared = 0;
    s->samples = 0;
    s->solved = 0;
    reset_watch(s);
    s->status = (int32_t)OK;
    s->relaxation = INF;
    (void)memset(s->row_scale, 0, sizeof s->row_scale);
    forget_sizes(s);
    s->stats.violated_row = -1;
    s->stats.violated_node = -1;
    start_at(s, initial_state);
    if (AUGMENTED) {
        reset_augmented(s);
    }
    (void)memcpy(s->xhat, s->x[0], sizeof s->xhat);
    on_reset(s);
}

#include "algorithms/shared/linearize.c"

#include "algorithms/shared/finish.c"

#include "algorithms/real_time_iteration/violation.c"

#include "algorithms/real_time_iteration/residual.c"

/* Linearises the present point and evaluates the Hessian. */
static void evaluate_here(solver_t *s)
{
    linearize(s);
    hessian(s);
    s->renewal = UP_TO_DATE;
}

/* Q += diag(proximal). It limits the step of a control without curvature and vanishes at the solution. */
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

#include "algorithms/real_time_iteration/curvature_at.c"

/* Runs the preparation phase. */
status_t API(prepare)(solver_t *s)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    take_penalties(s);
    s->newton = NEWTON;
    before_prepare(s);
    restart_doubtful_plan(s);
    if (AUGMENTED) {
        follow_augmented(s);
    }
    status = prepare_here(s);
    measure_residual(s);
    status = after_prepare(s, status);
    s->prepared = 1;
    return finish(s, status);
}

#include "algorithms/real_time_iteration/apply.c"

/* Returns the status of a sample, judged by the plan after its step. */
static status_t judge(solver_t *s, status_t status)
{
    status = after_feedback(s, status);
    if (NALG) {
        require_algebraic(s);
    }
    if (EXACT_QP && status == OK) { /* the solution of the QP has no gaps */
        s->stats.residual = R(0);
    }
    if (SADDLES && !ITERATES && (status == OK || status == RELAXED)) { /* nothing else measures a plan after a probe */
        enlarge(&s->stats.residual, s->saddle.saved);
    }
    status = judge_residual(status, s->stats.residual);
    learn_sizes(s, status);
    return status;
}

#include "algorithms/shared/feedback.c"

#include "algorithms/shared/shift.c"

#include "algorithms/shared/kkt.c"

#if SEARCH
#include "algorithms/real_time_iteration/trial.c"

#include "algorithms/solve.c"
#endif

#include "generated/hooked.c"
