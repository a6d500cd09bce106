/* Contract of this part: feedback_here() solves the QP that has been prepared for s->xhat and takes its full step. */

/* Copies the multipliers of the QP to the plan. */
static void copy_multipliers(solver_t *s)
{
    (void)memcpy(s->mu_u, s->step.mult_u, sizeof s->mu_u);
    (void)memcpy(s->mult, s->step.mult, sizeof s->mult);
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

/* Solves the QP of a sample. */
static status_t run_sample_qp(solver_t *s)
{
    status_t status;
    before_qp(s);
    status = run_qp(s);
    status = after_qp(s, status);
    return status;
}

#if SADDLES
#include "algorithms/shared/saddle.c"
#endif

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

/* Copies the multipliers of the dynamics in the QP to the plan. Returns 0 if the gradient with respect to the controls
 * is known not to vanish. */
static int recover_multipliers(solver_t *s)
{
    return multipliers_of_qp(s, s->lam, 1);
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
    before_step(s, status);
    copy_multipliers(s);
    if (!recover_multipliers(s) && status == OK) { /* multipliers of relaxed rows hide the gradient in rounding */
        return NUMERICAL_FAILURE;
    }
    take_step(s);
    if (PULLED_ROWS) {
        pull_back(s);
    }
    on_success(s, status);
    if (SADDLES) {
        if (leave_saddle(s) && JUDGES) {
            s->near.trusted = 0;
        }
    }
    if (LAGRANGIAN && status == RELAXED) { /* a relaxed QP has the multipliers of the penalty */
        forget_multipliers(s);
    }
    return status;
}
