/* A round of a sample makes ITERATIONS steps of the trust-region method and one dual update. Other rounds repair a plan
 * before a sample. The plan changes only if it stays finite. */

/* Sets the multipliers of the bounds to minus the gradient of the augmented Lagrangian where a bound holds it. */
static void set_bound_multipliers(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = s->u[k][j], force = -(a->g[k][NX + j] + a->Hd[k][NX + j]);
            const int holds = (force > R(0)) ? !(u < control_upper(s, k, j)) : !(u > control_lower(s, k, j));
            s->mu_u[k][j] = holds ? force : R(0);
        }
    }
    for (int m = 0; m < NG; m++) {
        if (!row_relaxed[m]) {
            const int k = row_node(m), i = row_index(m);
            const real_t x = s->x[k][i], force = -(a->g[k][i] + a->Hd[k][i]);
            const int holds = (force > R(0)) ? !(x < row_upper(s, m)) : !(x > row_lower(s, m));
            s->mult[m] = holds ? force : R(0);
        }
    }
}

/* Makes the estimates the multipliers of the plan. */
static void finish_multipliers(solver_t *s)
{
    set_bound_multipliers(s);
    couple_start(s, R(1));
}

/* most = max(most, violation of every relaxed row in its scale). */
static void enlarge_by_rows(const solver_t *s, real_t *most)
{
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m] == 1) {
            enlarge(most, outside(s, m, s->auglag.value[m]) / row_size[m]);
        }
    }
}

/* Returns the largest gap in the given scales of the states, or violation of a relaxed row in its own scale. */
static real_t violation_in(const solver_t *s, const real_t *size)
{
    const auglag_t *a = &s->auglag;
    real_t part[NX], most = R(0);
    for (int i = 0; i < NX; i++) {
        part[i] = R(1) / size[i];
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&most, a->gap[k][i] * part[i]);
        }
    }
    enlarge_by_rows(s, &most);
    return most;
}

/* Returns the largest gap in the scales of the variables, or violation of a relaxed row in its own scale. */
static real_t violation_of(const solver_t *s)
{
    return violation_in(s, variable_scale);
}

#include "algorithms/shared/scales.c"

/* Returns the residual of the plan: the largest gap in the state scales, or violation of a relaxed row in its own
 * scale. */
static real_t plan_residual(const solver_t *s)
{
    real_t size[NX];
    state_scales(s, size);
    return violation_in(s, size);
}

/* Linearises the plan, which has been evaluated. Second derivatives take the estimates of the multipliers or, where
 * gaps are large and make the estimates large, the multipliers of the last update. */
static void linearize_plan(solver_t *s)
{
    int far = 0;
    if (LAGRANGIAN) {
        far = is_far(plan_residual(s));
        if (far) {
            restore_multipliers(s);
        }
    }
    linearize(s);
    hessian(s);
    if (LAGRANGIAN && far) {
        estimate_multipliers(s);
    }
}

/* Evaluates and linearises the plan; its multipliers become those of the augmented Lagrangian. */
static status_t prepare_here(solver_t *s)
{
    (void)project_plan(s);
    COUPLED_ROWS(s, s->coupled.r, s->coupled.J_0, s->coupled.J_N);
    couple_start(s, -R(1));
    update_multipliers(s);
    evaluate_path(s);
    evaluate_ends(s);
    estimate_multipliers(s);
    linearize_plan(s);
    s->renewal = UP_TO_DATE;
    return isfinite(merit(s)) ? OK : NUMERICAL_FAILURE;
}

/* Increases the penalty, up to its limit. */
static void stiffen(solver_t *s)
{
    const real_t more = FACTOR_PENALTY_RATIO * s->auglag.penalty,
                 most = FACTOR_AUGMENTED_MOST_PENALTY * penalty_weight[0];
    s->auglag.penalty = (more < most) ? more : most;
}

/* Ends a round with the multiplier update. The multipliers stay as they are if no step was accepted, or if gaps and
 * rows are large and hardly smaller than `before`. The penalty grows from its first value to that of later samples, and
 * beyond it where accepted steps have not reduced the residual; it returns once the residual is small. */
static void close_round(solver_t *s, real_t before, int accepted)
{
    auglag_t *a = &s->auglag;
    const real_t usual = penalty_weight[0], less = a->penalty / FACTOR_PENALTY_RATIO;
    int far, stuck;
    s->stats.violation = violation_of(s);
    s->stats.residual = plan_residual(s);
    far = is_far(s->stats.residual);
    stuck = far && !(s->stats.violation < FACTOR_AUGMENTED_FALL * before);
    if (a->penalty < usual) {
        a->penalty = usual;
    } else if (!far) {
        a->penalty = (less > usual) ? less : usual;
    } else if (stuck && accepted) {
        stiffen(s);
    }
    finish_multipliers(s);
    if (SADDLES) {
        if (leave_saddle(s)) {
            enlarge(&s->stats.residual, s->saddle.saved);
        }
    }
    if (stuck || !accepted) {
        restore_multipliers(s);
    }
}

/* Runs a round from the evaluated and linearised plan: ITERATIONS steps of the trust-region method and, where it is
 * due, the multiplier update. The plan changes only if it stays finite. */
static status_t run_round(solver_t *s)
{
    auglag_t *a = &s->auglag;
    const real_t before = violation_of(s), least = FACTOR_AUGMENTED_LEAST_RADIUS * FACTOR_AUGMENTED_FIRST_RADIUS;
    int moved = 0, accepted = 0;
    if (!isfinite(merit(s))) {
        return NUMERICAL_FAILURE;
    }
    a->precision = FACTOR_AUGMENTED_PRECISION;
    a->radius = (a->radius > least) ? a->radius : least;
    assemble(s);
    if (!gradient_is_finite(a)) {
        return NUMERICAL_FAILURE;
    }
    for (int n = 0; n < ITERATIONS; n++) {
        if (moved) {
            linearize_plan(s);
            assemble(s);
        }
        a->proximal = proximal_weight[0];
        if (LAGRANGIAN) {
            a->proximal += proximal_weight[1] * a->bend;
        }
        s->stats.newton_iterations++;
        moved = descend(s, MAX_FACES);
        accepted |= moved;
    }
    close_round(s, before, accepted);
    return plan_is_finite(s) && all_finite(s->lam[0], (N + 1) * NX) ? OK : NUMERICAL_FAILURE;
}

/* Prepares the plan at its own x_0. */
static status_t prepare_at_plan(solver_t *s)
{
    real_t measured[NX];
    status_t status;
    measure_plan(s, measured);
    status = prepare_here(s);
    if (REPAIR) {
        /* A plan that is new, has failed or was NOT_CONVERGED is repaired until steps do what their model predicts and
         * gaps are small. */
        int wanted = s->samples == 0 || s->failures > NO_FAILURE || s->unconverged > 0;
        for (int n = 0; n < REPAIRS && status == OK && wanted; n++) {
            status = run_round(s);
            s->stats.repairs++;
            wanted = !s->auglag.settled || is_far(s->stats.residual);
            if (status == OK) {
                status = prepare_here(s);
            }
        }
    }
    (void)memcpy(s->xhat, measured, sizeof s->xhat);
    return status;
}

/* Reconsiders a plan that is still far from the model. If it is farther than a plan at rest at the measured state, it
 * is replaced by that one, as a bad measurement may have spoilt it. Its gaps are known. */
static status_t reconsider(solver_t *s)
{
    const real_t present = violation_of(s);
    keep_plan(s);
    start_anew(s);
    (void)project_plan(s);
    evaluate_path(s);
    evaluate_ends(s);
    if (!(present <= violation_of(s))) {
        reset_search(s);
        return prepare_here(s);
    }
    return_plan(s);
    for (int f = 0; f < NF; f++) {
        s->xhat[free_state[f]] = s->x[0][free_state[f]];
    }
    restore_multipliers(s);
    estimate_multipliers(s);
    return OK;
}

/* Returns 1 if all states of the plan have their declared values. */
static int is_untouched(const solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            if (s->x[k][i] != initial_state[i]) { /* exact comparison: still as initialised */
                return 0;
            }
        }
    }
    return 1;
}
