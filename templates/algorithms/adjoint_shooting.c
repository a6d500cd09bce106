/* Component "algorithm". Contract: algorithm_reset, API(step) and the other functions of the interface. Here: single
 * shooting. The controls inside their bounds are the only variables, the states follow by simulation, and adjoint and
 * forward sweeps that recompute A_k and B_k at every interval give the derivatives. */

#include "generated/hooks.c"

#include "algorithms/shared/enlarge.c"

#include "algorithms/shared/safe_value.c"

#include "algorithms/shared/finish.c"

#include "algorithms/shared/judge.c"

#include "algorithms/adjoint_shooting/rows.c"

#include "algorithms/adjoint_shooting/sweeps.c"

#include "algorithms/adjoint_shooting/search.c"

#if QUASI_NEWTON
#include "algorithms/adjoint_shooting/quasi_newton.c"
#else
#include "algorithms/adjoint_shooting/model.c"

#include "algorithms/adjoint_shooting/newton.c"
#endif

#include "algorithms/adjoint_shooting/shift.c"

#if SADDLES
#include "algorithms/shared/saddle.c"
#endif

/* Sharpens the penalty or barrier terms so that they approximate the rows more closely. Returns 0 if they are at their
 * limit. */
static int sharpen(solver_t *s)
{
    if (!sharpen_terms(s)) {
        return 0;
    }
    s->shooting.pairs = 0;
    return 1;
}

/* Forgets the multipliers of the rows and the pairs of past steps. */
static void forget_past(solver_t *s)
{
    (void)memset(s->row, 0, sizeof s->row);
    weigh_terminal(s, R(1));
    s->shooting.pairs = 0;
    place_terms(s, 0);
    s->shooting.length = R(1);
}

/* Sets the controls to their references and forgets the past. */
static void forget_plan(solver_t *s)
{
    refer_controls(s);
    forget_past(s);
}

/* Restarts a plan that does not converge. Its controls are replaced by their references if those cost less. Its past is
 * forgotten unless that past brings a plan that violates rows back to them. */
static void start_anew(solver_t *s)
{
    const real_t before = merit(s), violation = s->stats.violation;
    (void)memcpy(s->shooting.p, s->u, sizeof s->shooting.p);
    refer_controls(s);
    const int better = simulate_plan(s) && !(merit(s) >= before);
    if (!better) {
        (void)memcpy(s->u, s->shooting.p, sizeof s->u);
    }
    if (better || judge_residual(OK, violation) == OK) {
        forget_past(s);
    }
}

/* Forgets multipliers that are not finite at once. */
static status_t keep_finite(solver_t *s, status_t status)
{
    if (NG > 0 && !all_finite(s->row, NG)) {
        forget_past(s);
        return NUMERICAL_FAILURE;
    }
    return status;
}

#include "algorithms/shared/watch.c"

/* Sets every state of the plan to x_0. */
static void hold_states(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        (void)memcpy(s->x[k + 1], s->x[k], sizeof s->x[k]);
    }
}

/* Sets the weights of the terms of rows for a sample. */
static void set_weights(solver_t *s)
{
    if (!BARRIER_ROWS) {
        s->shooting.penalty = penalty_weight[0];
    }
    s->shooting.multiplier = penalty_weight[0];
    s->shooting.solving = 0;
}

/* Resets the plan: every state at its declared initial value, controls at their references. */
static void algorithm_reset(solver_t *s)
{
    for (int i = 0; i < NX; i++) { /* not by memcpy: GCC 12 with AVX-512 */
        s->x[0][i] = initial_state[i];
    }
    hold_states(s);
    if (NG > 0) {
        set_weights(s);
    }
    forget_plan(s);
    reset_watch(s);
    (void)memset(&s->stats, 0, sizeof s->stats);
    s->samples = 0;
    s->solved = 0;
    s->status = (int32_t)OK;
    if (AUGMENTED) {
        reset_augmented(s);
    }
}

/* Sets the measured entries of x_0 to xhat. Returns 0, and leaves x_0 as it is, if a measured entry is not finite. */
static int take_state(solver_t *s, const real_t *xhat)
{
    if (!ACCUMULATORS) {
        if (!all_finite(xhat, NXHAT)) {
            return 0;
        }
        for (int i = 0; i < NXHAT; i++) {
            s->x[0][i] = or_zero(xhat[i], i);
        }
        if (AUGMENTED) {
            take_augmented(s, s->x[0]);
        }
        return 1;
    }
    for (int i = 0; i < NXHAT; i++) {
        if (!is_accumulator[i] && !isfinite(xhat[i])) {
            return 0;
        }
    }
    for (int i = 0; i < NXHAT; i++) {
        s->x[0][i] = is_accumulator[i] ? R(0) : or_zero(xhat[i], i);
    }
    if (AUGMENTED) {
        take_augmented(s, s->x[0]);
    }
    return 1;
}

/* Simulates the plan from x_0. If its controls lead to a state that is not finite, the reference controls replace
 * them. */
static status_t start_sample(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = safe_value(s, k, j);
        }
    }
    s->shooting.paired = 0;
    if (!simulate_plan(s)) {
        forget_plan(s);
        if (!simulate_plan(s)) {
            hold_states(s);
            return NUMERICAL_FAILURE;
        }
    }
    if (NG > 0 && LUMPED_ROWS) {
        (void)merit(s);
    }
    return OK;
}

/* Takes ITERATIONS steps from the measured x_0, then updates the multipliers of the rows once. Returns NOT_CONVERGED if
 * the last step should have moved the first control. */
static status_t run_sample(solver_t *s)
{
    status_t status = start_sample(s);
    int moved = MOVED;
    before_steps(s);
    for (int n = 0; n < ITERATIONS + REPAIRS && status != NUMERICAL_FAILURE; n++) {
        /* continues while the last step is long and was not taken in full */
        if (n >= ITERATIONS && (moved == MOVED || !step_is_long(s, N))) {
            break;
        }
        status = improve(s, TRIALS, &moved);
    }
    if (NG > NT && status != NUMERICAL_FAILURE) {
        const int easy = s->stats.simulations <= s->stats.accepted + 1 && s->shooting.length >= R(1);
        update_rows(s, R(1));
        follow_terms(s, easy);
    }
    if (SADDLES) {
        if (status != NUMERICAL_FAILURE && leave_saddle(s)) {
            s->shooting.pairs = 0;
            return is_far(s->saddle.saved) ? NOT_CONVERGED : status;
        }
    }
    return (status == OK && moved < MOVED && step_is_long(s, 1)) ? NOT_CONVERGED : status;
}

#if SOLVE && SHIFT
#include "algorithms/shared/solved.c"
#endif

status_t API(step)(solver_t *s, const real_t xhat[NXHAT], real_t u0[NU])
{
    status_t status = NOT_FINITE;
    if (s->magic != MAGIC) {
        for (int j = 0; j < NU; j++) { /* not by memcpy: GCC 12 with AVX-512 */
            u0[j] = default_control[j];
        }
        return NOT_INITIALIZED;
    }
    s->newton = NEWTON;
    (void)memset(&s->stats, 0, sizeof s->stats);
    if (SOLVE && SHIFT) {
        compare_solved(s, xhat);
        if (s->samples > 0 && !s->solved) {
            shift_plan(s);
        }
        s->solved = 0;
    } else if (SHIFT && s->samples > 0) {
        shift_plan(s);
    }
    s->samples += (s->samples < MANY);
    restart_doubtful_plan(s);
    if (take_state(s, xhat)) {
        status = keep_finite(s, run_sample(s));
    }
    if (IMPLICIT) {
        status = judge_residual(status, stage_residual(s));
    }
    status = judge_residual(status, s->stats.violation);
    watch(s, status, 0);
    safe_control(s, u0);
    if (PULLED_ROWS) {
        pull_control_back(s, u0);
    }
    if (AUGMENTED) {
        keep_sample(s, u0);
    }
    return finish(s, status);
}

#include "algorithms/adjoint_shooting/kkt.c"

#if SOLVE
#include "algorithms/adjoint_shooting/solve.c"
#endif

#include "generated/hooked.c"
