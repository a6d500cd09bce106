/* Component "algorithm". Contract: algorithm_reset, API(prepare) and the other functions of the interface. Here:
 * ITERATIONS trust-region Newton iterations on the bound-constrained augmented Lagrangian, then one update of the
 * multipliers, per sample. Gaps, the initial condition and all rows are relaxed; only bounds of controls and hard
 * bounds of states are not. */

#include "generated/hooks.c"

#include "algorithms/shared/plan.c"

#include "algorithms/shared/forget_sizes.c"

/* Resets penalty and trust region to their first values. */
static void reset_search(solver_t *s)
{
    s->auglag.penalty = FACTOR_AUGMENTED_FIRST_PENALTY * penalty_weight[0];
    s->auglag.radius = FACTOR_AUGMENTED_FIRST_RADIUS;
}

#include "algorithms/shared/watch.c"

/* Resets the plan: every state at its declared initial value, controls at their references, multipliers 0. */
static void algorithm_reset(solver_t *s)
{
    forget_plan(s);
    s->prepared = 0;
    s->samples = 0;
    s->solved = 0;
    reset_watch(s);
    s->status = (int32_t)OK;
    reset_search(s);
    forget_sizes(s);
    start_at(s, initial_state);
    if (AUGMENTED) {
        reset_augmented(s);
    }
    (void)memcpy(s->xhat, s->x[0], sizeof s->xhat);
}

#include "algorithms/shared/linearize.c"

/* Values of renewal: the data are those of prepare; references have changed; the linearisation has to be renewed. */
enum { UP_TO_DATE, REFERENCE_CHANGED, HELD };

static void hold_gradients(solver_t *s)
{
    s->renewal = HELD;
}

#include "algorithms/shared/finish.c"

#include "algorithms/shared/enlarge.c"

#include "algorithms/shared/take_state.c"

#include "algorithms/augmented_lagrangian/terms.c"

#include "algorithms/augmented_lagrangian/model.c"

#include "algorithms/augmented_lagrangian/factors.c"

#include "algorithms/augmented_lagrangian/kinks.c"

#include "algorithms/augmented_lagrangian/search.c"

#if SADDLES
#include "algorithms/shared/saddle.c"
#endif

#include "algorithms/augmented_lagrangian/rounds.c"

status_t API(prepare)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    s->newton = NEWTON;
    before_prepare(s);
    (void)memset(&s->stats, 0, sizeof s->stats);
    if (s->prepared) {
        restore_multipliers(s);
    }
    s->prepared = 1;
    restart_doubtful_plan(s);
    if (AUGMENTED) {
        follow_augmented(s);
    }
    return finish(s, prepare_at_plan(s));
}

/* Returns the status of a sample. */
static status_t judge(solver_t *s, status_t status)
{
    if (IMPLICIT) {
        enlarge(&s->stats.residual, stage_residual(s));
    }
    if (NALG) {
        require_algebraic(s);
    }
    status = judge_residual(status, s->stats.residual);
    if (status == OK && !s->auglag.settled) {
        status = NOT_CONVERGED;
    }
    learn_sizes(s, status);
    return status;
}

/* Runs the feedback phase for the measured state s->xhat. */
static status_t feedback_here(solver_t *s)
{
    int renewed = project_plan(s); /* the plan or its bounds may have changed since prepare */
    evaluate_ends(s);
    estimate_multipliers(s);
    COUPLED_ROWS(s, s->coupled.r, s->coupled.J_0, s->coupled.J_N);
#if SET_REFERENCE
    renewed |= (s->renewal != UP_TO_DATE);
    s->renewal = UP_TO_DATE;
#elif SET_WEIGHT || SET_PARAMETER
    renewed = 1;
#endif
    if (renewed) {
        evaluate_path(s);
        estimate_multipliers(s);
        linearize_plan(s);
    }
    if (s->unconverged > 0 && is_far(plan_residual(s)) && reconsider(s) != OK) {
        return NUMERICAL_FAILURE;
    }
    return run_round(s);
}

#include "algorithms/shared/feedback.c"

#include "algorithms/shared/shift.c"

#include "algorithms/shared/kkt.c"
#if SOLVE

#include "algorithms/augmented_lagrangian/solve.c"
#endif

#include "generated/hooked.c"
