/* solve(): the method of multipliers. The iterations of a sample reduce the augmented Lagrangian until its projected
 * gradient is small compared with the violation of gaps and rows; then the multipliers are updated, and the penalty
 * grows where the violation has not become much smaller. */

/* Returns the largest component of the projected gradient, in scaled variables. */
static real_t projected_gradient(auglag_t *a)
{
    real_t most = R(0);
    (void)steepest_descent(a);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            enlarge(&most, a->p[k][i] / variable_scale[i]);
        }
    }
    return most;
}

/* Writes the KKT residuals of the plan with its own multipliers to s->kkt, then restores the estimates. */
static real_t residual_of(solver_t *s)
{
    (void)memset(s->auglag.Hd, 0, sizeof s->auglag.Hd);
    finish_multipliers(s);
    API(kkt)(s, &s->kkt);
    couple_start(s, -R(1));
    return s->kkt.relative;
}

/* Updates the multipliers; the penalty grows if the violation has hardly decreased since the last update. */
static void advance_multipliers(solver_t *s, real_t tol, real_t *violation)
{
    auglag_t *a = &s->auglag;
    const real_t now = violation_of(s);
    update_multipliers(s);
    if (!(now < FACTOR_AUGMENTED_PROGRESS * *violation) && now > tol) {
        stiffen(s);
    }
    *violation = now;
    estimate_multipliers(s);
    a->radius = (a->radius > FACTOR_AUGMENTED_FIRST_RADIUS) ? a->radius : FACTOR_AUGMENTED_FIRST_RADIUS;
}

/* Iterates from the evaluated and linearised plan. A plan with small residuals gets one more multiplier update and one
 * more iteration, because the remaining gaps change the cost by their multipliers. */
static status_t iterate(solver_t *s, real_t tol, int max_iterations)
{
    auglag_t *a = &s->auglag;
    real_t violation = INF, accuracy = R(1);
    int since = 0, polished = 0;
    for (int n = 0; n < max_iterations; n++) {
        assemble(s);
        if (!gradient_is_finite(a)) {
            return NUMERICAL_FAILURE;
        }
        const int solved = residual_of(s) <= tol;
        if (solved && (polished || n == 0)) {
            if (SADDLES) {
                if (leave_saddle(s)) {
                    evaluate_path(s);
                    evaluate_ends(s);
                    linearize_plan(s);
                    polished = 0;
                    continue;
                }
            }
            return OK;
        }
        polished = solved;
        set_box(s);
        const real_t gradient = projected_gradient(a);
        if (solved || gradient <= accuracy || a->predicted < TOL_UNIT * (R(1) + FABS(a->cost)) || ++since > MAX_INNER) {
            advance_multipliers(s, tol, &violation);
            since = 0;
            accuracy = FACTOR_AUGMENTED_PROGRESS * ((accuracy < violation) ? accuracy : violation);
            accuracy = (accuracy > FACTOR_AUGMENTED_PROGRESS * tol) ? accuracy : FACTOR_AUGMENTED_PROGRESS * tol;
            linearize_plan(s);
            assemble(s);
        }
        a->proximal = R(0);
        s->stats.sqp_iterations++;
        s->stats.newton_iterations++;
        if (descend(s, FACES_OF_SOLVE)) {
            linearize_plan(s);
        }
    }
    assemble(s);
    return (residual_of(s) <= tol) ? OK : ITERATION_LIMIT;
}

status_t API(solve)(solver_t *s, const real_t xhat[NXHAT], real_t tol, int max_iterations)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!(tol > R(0)) || !isfinite(tol) || max_iterations < 1) {
        return finish(s, BAD_ARGUMENT);
    }
    if (s->prepared) {
        restore_multipliers(s);
    }
    s->prepared = 0;
    if (!take_state(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    if (AUGMENTED) {
        follow_augmented(s);
    }
    (void)memset(&s->stats, 0, sizeof s->stats);
    s->auglag.radius = FACTOR_AUGMENTED_FIRST_RADIUS;
    s->auglag.penalty = FACTOR_AUGMENTED_FIRST_PENALTY_OF_SOLVE * penalty_weight[0];
    s->auglag.precision = FACTOR_AUGMENTED_PRECISION_OF_SOLVE;
    s->auglag.predicted = INF;
    status = prepare_here(s);
    if (status == OK) {
        status = iterate(s, tol, max_iterations);
    }
    s->auglag.penalty = penalty_weight[0];
    s->auglag.radius = FACTOR_AUGMENTED_FIRST_RADIUS;
    s->unconverged = 0;
    s->failures = (status == OK) ? NO_FAILURE : s->failures;
    s->probation = (status == OK) ? 0 : s->probation;
    couple_start(s, R(1));
    s->stats.violation = violation_of(s);
    if (PULLED_ROWS && status != OK) {
        pull_plan_back(s);
    }
    s->solved = 1;
    return finish(s, status);
}
