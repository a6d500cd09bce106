/* A sample continues until its plan is near a solution. After a QP that has failed, and after a step that has left
 * large residuals, a search follows from the better one of the plans before and after the step. */

/* Exchanges the plan and the saved plan. */
static void exchange_plans(solver_t *s)
{
    trial_t *kept = &s->trial;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            real_t *a = (i < NX) ? &s->x[k][i] : &s->u[k][i - NX], *b = (i < NX) ? &kept->x[k][i] : &kept->u[k][i - NX];
            const real_t c = *a;
            *a = *b;
            *b = c;
        }
    }
}

/* a = b + length (a - b), n numbers. */
static void shorten(real_t *a, const real_t *b, int n, real_t length)
{
    for (int i = 0; i < n; i++) {
        a[i] = b[i] + length * (a[i] - b[i]);
    }
}

/* Halves the distance between the plan and the saved plan before the step. Multipliers move as well if the Hessian may
 * depend on them. */
static void halve_step(solver_t *s)
{
    const trial_t *kept = &s->trial;
    shorten(s->x[0], kept->x[0], (N + 1) * NX, R(0.5));
    shorten(s->u[0], kept->u[0], N * NU, R(0.5));
    if (KEEPS_MULTIPLIERS) {
        shorten(s->lam[0], kept->lam[0], (N + 1) * NX, R(0.5));
        shorten(s->mu_u[0], kept->step.mult_u[0], N * NU, R(0.5));
        if (NG > 0) {
            shorten(s->mult, kept->step.mult, NG, R(0.5));
        }
    }
}

/* Computes the measures of the saved plan before the step. */
static measures_t measure_kept(solver_t *s)
{
    exchange_plans(s);
    const measures_t at = measure(s);
    exchange_plans(s);
    return at;
}

/* Shortens the step of the sample until the filter accepts it. Returns 1 if the full step remains. */
static int shorten_step(solver_t *s)
{
    sqp_t *q = &s->sqp;
    trial_t *kept = &s->trial;
    q->base = measure_kept(s);
    q->slope = s->near.slope;
    enlarge(&q->cost_scale, q->slope);
    q->most_violation = FACTOR_FILTER_LIMIT * ((q->base.violation > R(1)) ? q->base.violation : R(1));
    if (!isfinite(q->base.violation) || !isfinite(q->base.cost)) {
        return 1;
    }
    kept->length = R(1);
    for (int trial = 0; trial < MAX_TRIALS; trial++) {
        if (accepts(s)) {
            return kept->length >= R(1);
        }
        halve_step(s);
        kept->length *= R(0.5);
    }
    move_back(s);
    return_multipliers(s);
    return 0;
}

/* Moves the plan back by one interval: it is that of the previous sample again, except for x_0. */
static void shift_back(solver_t *s)
{
    for (int k = N; k > 0; k--) {
        (void)memcpy(s->x[k], s->x[k - 1], sizeof s->x[0]);
        (void)memcpy(s->lam[k], s->lam[k - 1], sizeof s->lam[0]);
        if (k < N) {
            (void)memcpy(s->u[k], s->u[k - 1], sizeof s->u[0]);
            (void)memcpy(s->mu_u[k], s->mu_u[k - 1], sizeof s->mu_u[0]);
        }
    }
    (void)memcpy(s->x[0], s->xhat, sizeof s->x[0]);
    (void)memcpy(s->u[0], s->first_control, sizeof s->u[0]);
    if (AUGMENTED) {
        follow_augmented(s);
    }
}

/* Takes the plan of the previous sample if it costs less and does not violate much more. This helps where the last
 * interval, which a shift has added, is a bad guess. */
static void reconsider_shift(solver_t *s)
{
    const measures_t shifted = measure(s);
    keep_plan(s);
    shift_back(s);
    const measures_t before = measure(s);
    if (!(before.cost < shifted.cost) ||
        !(before.violation <= FACTOR_SQP_MOST_GROWTH * shifted.violation + FACTOR_SQP_GROWTH_FLOOR)) {
        move_back(s);
        return_multipliers(s);
    }
}

/* Begins the search at the plan. If `whole`, the sample has taken the full step, and the search begins with its
 * Hessian. */
static void begin_search(solver_t *s, int whole)
{
    if (SHIFTS_BACK && !whole && s->samples > 0) {
        reconsider_shift(s);
    }
    clip_controls(s);
    if ((CURVED || LAGRANGIAN) && !multipliers_are_finite(s)) {
        forget_multipliers(s);
    }
    start_search(s, 0);
    s->stats.sqp_iterations = 0;
    s->newton = NEWTON_LIMIT;
    s->curved.in_solve = !whole;
    s->sqp.linearized = whole;
    s->sqp.hasty = 1;
}

/* Returns the largest violation of a hard row that is no bound of a state, in the scale of the row. */
static real_t rows_outside(solver_t *s)
{
    real_t value[NG], most = R(0);
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (!row_is_soft(s, m) && !row_is_state(m)) {
            enlarge(&most, outside(s, m, value[m]) / scale_of_row(s, m, value[m]));
        }
    }
    return most;
}

/* Returns the status of a sample after its search, which measures how near the plan is to a solution, whatever the
 * status before the search. */
static status_t status_after_search(solver_t *s, status_t status, int stepped)
{
    real_t size[NX];
    state_scales(s, size);
    s->stats.residual = largest_gap(s, size);
    enlarge(&s->stats.residual, s->kkt.relative);
    if (NONLINEAR_ROWS) {
        s->row_residual = R(0);
        enlarge(&s->stats.residual, rows_outside(s));
    }
    if (!is_far(s->stats.residual)) {
        return OK;
    }
    if (HARD_ROWS && s->trial.elastic) {
        return RELAXED;
    }
    return (stepped || (s->stats.sqp_iterations > 0 && isfinite(s->stats.residual))) ? NOT_CONVERGED : status;
}

/* Returns 1 if a sample with this status needs no search: its plan is near a solution, or its violation of hard rows
 * cannot be reduced. */
static int sample_is_done(const solver_t *s, status_t status)
{
    if (status == OK) {
        return !is_far(s->near.left);
    }
    if (status == RELAXED) {
        return !is_far(s->near.left) && s->samples > 0;
    }
    return status == NOT_FINITE || status == NOT_PREPARED;
}

static status_t iterations_after_feedback(solver_t *s, status_t status)
{
    const int stepped = status == OK || status == RELAXED;
    s->stats.iterations = 1;
    if (s->most_iterations <= 1 || sample_is_done(s, status)) {
        return status;
    }
    const int allowed = (s->most_iterations < SAMPLE_ITERATIONS) ? s->most_iterations : SAMPLE_ITERATIONS;
    if (!stepped) {
        (void)memset(&s->sqp, 0, sizeof s->sqp);
        (void)memset(&s->step, 0, sizeof s->step);
        update_scales(s);
    }
    int whole = stepped;
    if (whole && !(SADDLES && s->saddle.saved > R(0))) {
        whole = shorten_step(s);
    }
    begin_search(s, whole);
    (void)solve_here(s, FACTOR_NEAR_ENOUGH * residual_tolerance[0], allowed - 1);
    status = status_after_search(s, status, stepped);
    s->curved.in_solve = 0;
    s->trial.elastic = 0;
    (void)memset(&s->near, 0, sizeof s->near);
    s->stats.iterations += s->stats.sqp_iterations;
    return status;
}
