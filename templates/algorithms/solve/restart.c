/* Starts of a search: from the plan, and from other points after a search that has ended where the constraints cannot
 * be satisfied. */

/* Starts from the plan with an empty filter and unknown scales. */
static void start_search(solver_t *s, int attempts)
{
    if (!plan_is_finite(s)) {
        start_at(s, s->xhat);
    }
    (void)memset(&s->sqp, 0, sizeof s->sqp);
    (void)memset(&s->trial, 0, sizeof s->trial);
    (void)memset(&s->step, 0, sizeof s->step);
    (void)memset(s->row_scale, 0, sizeof s->row_scale);
    s->row_residual = R(0);
    s->sqp.attempts = (int32_t)attempts;
    s->curved.proximal = FACTOR_SQP_FIRST_PROXIMAL;
    s->curved.damping = (attempts % 2 == 0) ? R(0) : FACTOR_SQP_SECOND_START;
    s->sqp.most_violation = INF;
    s->sqp.base.violation = INF;
    if (SADDLES && SOLVE) {
        s->saddle.departed = 0;
    }
    s->sqp.row_weight = FACTOR_SQP_ELASTIC_WEIGHT;
}

/* Returns 1 if the cost is unbounded below: far beyond its scale, along a variable far beyond its own. */
static int cost_is_unbounded(const solver_t *s)
{
    if (!(s->sqp.base.cost < -FACTOR_SQP_UNBOUNDED * cost_size[0])) {
        return 0;
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            if (FABS(point_at(s, k, i)) > FACTOR_SQP_UNBOUNDED * z_scale[i]) {
                return 1;
            }
        }
    }
    return 0;
}

/* Returns 1 if the states of a node are far beyond all sizes, as those of an unstable plant soon are. */
static int is_escaping(const solver_t *s, const real_t *x)
{
    int escapes = 0;
    for (int i = 0; i < NX; i++) {
        escapes |= !(FABS(x[i]) <= FACTOR_SCALE_STATE_GROWTH * (z_scale[i] + FABS(s->xhat[i])));
    }
    return escapes;
}

/* Finds a possible end of a plan from x_0: x_0 clipped to the bounds of node N. Returns 0 if that is x_0 itself. */
static int find_end(const solver_t *s, real_t *end)
{
    int moved = 0;
    (void)memcpy(end, s->xhat, sizeof s->xhat);
    for (int m = row_first[N]; m < row_first[N + 1]; m++) {
        if (row_is_state(m)) {
            end[row_index(m)] = clip(end[row_index(m)], row_lower(s, m), row_upper(s, m));
            moved |= end[row_index(m)] < s->xhat[row_index(m)] || end[row_index(m)] > s->xhat[row_index(m)];
        }
    }
    return moved;
}

/* Starts again after a search that has ended where the constraints cannot be satisfied, which does not exclude a
 * solution elsewhere. The first time the states lie on the straight line to where the bounds of node N are met, with
 * the reference controls; if x_0 meets them, the states follow from the controls of the plan. Later the states follow
 * from the reference controls. States that diverge are replaced by the measured state. */
static void restart_search(solver_t *s)
{
    real_t end[NX];
    const int straight = find_end(s, end) && s->sqp.attempts == 0;
    if (straight || s->sqp.attempts > 0) {
        forget_plan(s);
    }
    (void)memcpy(s->x[0], s->xhat, sizeof s->xhat);
    for (int k = 0; k < N; k++) {
        if (straight) {
            for (int i = 0; i < NX; i++) {
                s->x[k + 1][i] = s->xhat[i] + ((real_t)k + R(1)) / (real_t)N * (end[i] - s->xhat[i]);
            }
            continue;
        }
        interval_value(s, k, s->x[k + 1]);
        if (is_escaping(s, s->x[k + 1])) {
            (void)memcpy(s->x[k + 1], s->xhat, sizeof s->xhat);
        }
    }
    forget_multipliers(s);
    const int32_t infeasible = s->sqp.infeasible, hasty = s->sqp.hasty;
    start_search(s, s->sqp.attempts + 1);
    s->sqp.infeasible = infeasible;
    s->sqp.hasty = hasty;
}

/* Returns 1 if all multipliers that the first Hessian may read are finite. */
static int multipliers_are_finite(solver_t *s)
{
    if (NG > 0 && !all_finite(s->mult, NG)) {
        return 0;
    }
    return all_finite(s->lam[0], (N + 1) * NX);
}

/* Clips the controls to their bounds, which may have moved, because steps keep controls inside them. */
static void clip_controls(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = safe_value(s, k, j);
        }
    }
}

/* Starts with the plan and this state. Returns 0 if the state is not finite. */
static int take_over(solver_t *s, const real_t xhat[NXHAT])
{
    s->stats.sqp_iterations = 0;
    if (!take_state(s, xhat)) {
        return 0;
    }
    for (int f = 0; f < NF; f++) {
        const real_t guess = xhat[free_state[f]];
        s->x[0][free_state[f]] = isfinite(guess) ? guess : s->x[0][free_state[f]];
    }
    clip_controls(s);
    if (AUGMENTED) {
        follow_augmented(s);
    }
    forget_violation(s);
    s->samples += (s->samples < MANY);
    if ((CURVED || LAGRANGIAN) && !multipliers_are_finite(s)) {
        forget_multipliers(s);
    }
    start_search(s, 0);
    return 1;
}
