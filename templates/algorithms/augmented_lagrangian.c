/* Component "algorithm". Contract: algorithm_reset, API(prepare), _feedback, _step, _shift, _kkt and, if SOLVE, _solve.
 * Here: ITERATIONS trust-region Newton iterations on the bound-constrained augmented Lagrangian, then one update of the
 * multipliers, per sample. Gaps, the initial condition and all rows are relaxed, except bounds of controls and hard
 * bounds of states. */

#include "algorithms/plan.c"

/* Resets the plan: every state at its declared initial value, controls at their references, multipliers 0. */
static void algorithm_reset(solver_t *s)
{
    forget_plan(s);
    s->prepared = 0;
#if SHIFT
    s->samples = 0;
#endif
    s->failing = FINE;
    s->status = (int32_t)OK;
    s->auglag.penalty = penalty_weight[0];
    start_at(s, initial_state);
    memcpy(s->xhat, s->x[0], sizeof s->xhat);
}

#include "algorithms/linearize.c"

#if SET_REFERENCE
/* Values of renewal: whether data have changed since prepare, which linearises again then. */
enum { UP_TO_DATE, REFERENCE_CHANGED, HELD };

#if SET_WEIGHT || SET_PARAMETER
static void hold_gradients(solver_t *s)
{
    s->renewal = HELD;
}
#endif
#endif

#include "algorithms/finish.c"

#include "algorithms/enlarge.c"

#include "algorithms/take_state.c"

#include "algorithms/recover.c"

#include "algorithms/augmented_terms.c"

#include "algorithms/augmented_model.c"

#include "algorithms/augmented_factors.c"

#include "algorithms/augmented_search.c"

/* Linearises the plan with the estimates of the multipliers. */
static void linearize_plan(solver_t *s)
{
    linearize(s);
#if HAS_PATH_HESSIAN || HAS_TERMINAL_HESSIAN || HAS_START_HESSIAN
    hessian(s);
#endif
}

/* Evaluates and linearises the plan; its multipliers are those of the augmented Lagrangian. */
static status_t prepare_here(solver_t *s)
{
    (void)project_plan(s);
#if NE
    COUPLED_ROWS(s, s->coupled.r, &s->coupled.J_0[0][0], &s->coupled.J_N[0][0]);
    couple_start(s, -R(1));
#endif
    update_multipliers(s);
    evaluate_path(s);
    evaluate_ends(s);
    estimate_multipliers(s);
    linearize_plan(s);
#if SET_REFERENCE
    s->renewal = UP_TO_DATE;
#endif
    return isfinite(merit(s)) ? OK : NUMERICAL_FAILURE;
}

status_t API(prepare)(solver_t *s)
{
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
    if (s->prepared) {
        restore_multipliers(s);
    }
    s->prepared = 1;
    return finish(s, prepare_here(s));
}

/* The multipliers of the bounds: minus the gradient of the augmented Lagrangian, where a bound holds it. */
static void set_bound_multipliers(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = s->u[k][j], force = -(a->g[k][NX + j] + a->Hd[k][NX + j]);
            const int holds = (force > R(0)) ? !(u < CONTROL_UPPER(s, k, j)) : !(u > CONTROL_LOWER(s, k, j));
            s->mu_u[k][j] = holds ? force : R(0);
        }
    }
#if STATE_ROWS
    for (int m = 0; m < NG; m++) {
        if (!row_relaxed[m]) {
            const int k = row_node[m], i = row_index[m];
            const real_t x = s->x[k][i], force = -(a->g[k][i] + a->Hd[k][i]);
            const int holds = (force > R(0)) ? !(x < ROW_UPPER(s, m)) : !(x > ROW_LOWER(s, m));
            s->mu_x[k][i] = holds ? force : R(0);
        }
    }
#endif
}

/* The estimates become the multipliers of the plan. */
static void finish_multipliers(solver_t *s)
{
    set_bound_multipliers(s);
#if NE
    couple_start(s, R(1));
#endif
}

#if NG
/* most = max(most, violation of every relaxed row in its scale). */
static void enlarge_by_rows(const solver_t *s, real_t *most)
{
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m] == 1) {
            enlarge(most, outside(s, m, s->auglag.value[m]) * SQRT(row_weight[m]));
        }
    }
}

#endif
/* Largest gap and violation of a relaxed row, in their scales. */
static real_t violation_of(const solver_t *s)
{
    const auglag_t *a = &s->auglag;
    real_t most = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&most, a->gap[k][i] * SQRT(variable_weight[i]));
        }
    }
#if NG
    enlarge_by_rows(s, &most);
#endif
    return most;
}

#include "algorithms/scales.c"

/* The residual of the plan: its largest gap and violation of a relaxed row, in the scales of states and rows. */
static real_t plan_residual(const solver_t *s)
{
    const auglag_t *a = &s->auglag;
    real_t size[NX], most = R(0);
    state_scales(s, size);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
#if NF
            if (k == 0 && !is_measured[i] && !is_accumulator[i]) {
                continue;
            }
#endif
            enlarge(&most, a->gap[k][i] / size[i]);
        }
    }
#if NG
    enlarge_by_rows(s, &most);
#endif
    return most;
}

static status_t judge(const solver_t *s, status_t status)
{
    return judged(status, s->stats.residual);
}

/* Feedback phase for the measured state s->xhat. The plan changes only if it stays finite. */
static status_t feedback_here(solver_t *s)
{
    int moved = 0, renewed = project_plan(s); /* it may have been left, or its bounds changed, since prepare */
    memset(&s->stats, 0, sizeof s->stats);
    s->auglag.radius = initial_radius[0];
    s->auglag.proximal = proximal_weight[0];
    s->auglag.precision = FACTOR_PRECISION;
    evaluate_ends(s);
    estimate_multipliers(s);
#if NE
    COUPLED_ROWS(s, s->coupled.r, &s->coupled.J_0[0][0], &s->coupled.J_N[0][0]);
#endif
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
    if (!isfinite(merit(s))) {
        return NUMERICAL_FAILURE;
    }
    assemble(s);
    if (!gradient_is_finite(&s->auglag)) {
        return NUMERICAL_FAILURE;
    }
    for (int n = 0; n < ITERATIONS; n++) {
        if (moved) {
            linearize_plan(s);
            assemble(s);
        }
        s->stats.newton_iterations++;
        moved = descend(s, MAX_FACES);
    }
    s->stats.violation = violation_of(s);
    s->stats.residual = plan_residual(s);
    finish_multipliers(s);
    return plan_is_finite(s) && all_finite(s->lam[0], (N + 1) * NX) ? OK : NUMERICAL_FAILURE;
}

#include "algorithms/feedback.c"

#include "algorithms/shift.c"

#include "algorithms/kkt.c"
#if SOLVE

#include "algorithms/augmented_solve.c"
#endif
