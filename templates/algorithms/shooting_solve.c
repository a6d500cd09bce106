/* solve(): the steps of a sample to convergence. Where rows have terms, each time the projected gradient is small
 * compared with their violation, their multipliers are updated, and the penalty, or the sharpness of the smooth max,
 * grows where the violation has not become much smaller. */

#if NG > NT
/* Returns 1 if the penalty can grow further. */
static int sharpen(solver_t *s)
{
#if SMOOTH_ROWS
    if (!(s->shooting.sharpness < smooth_sharpness[1])) {
        return 0;
    }
    s->shooting.sharpness *= R(4);
#else
    if (!(s->shooting.penalty < MOST_PENALTY)) {
        return 0;
    }
    s->shooting.penalty *= R(10);
#endif
#if QUASI_NEWTON
    s->shooting.pairs = 0;
#endif
    return 1;
}

#if DUAL_ROWS
/* Largest |v_m - y_m| in the scale of a row, where y_m minimises psi_m: the violation of a hard row that is active, and
 * for others what the next update of its multiplier would change. */
static real_t dual_residual(const solver_t *s)
{
    real_t value[NG], most = s->stats.violation, slope, curvature;
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
#if NT
        if (terminal_index[m] >= 0) {
            continue;
        }
#endif
        (void)row_term(s, m, value[m], &slope, &curvature);
        enlarge(&most, (slope - s->row[m]) / (row_penalty(s) * SQRT(row_weight[m])));
    }
    return most;
}
#endif

/* The dual update. Returns 0 if neither multipliers nor the penalty can improve the rows. */
static int advance_rows(solver_t *s, real_t tol, real_t *violation)
{
    int grown = 0;
#if DUAL_ROWS
    const real_t now = dual_residual(s);
    update_rows(s, INF);
    if (!(now < R(0.25) * *violation) && now > R(0.1) * tol) {
        grown = sharpen(s);
    }
    grown |= now < *violation;
#else
    const real_t now = s->stats.violation;
    update_rows(s, INF);
    (void)tol;
    grown = sharpen(s);
#endif
    *violation = now;
#if QUASI_NEWTON
    s->shooting.paired = 0;
#endif
    (void)merit(s);
    return grown;
}
#endif

/* Iterates from the simulated plan. */
static status_t iterate(solver_t *s, real_t tol, int max_iterations)
{
    real_t stationarity;
    int moved = 1, failed = 0;
    status_t status = OK;
#if NG > NT
    real_t violation = INF, accuracy = R(1);
#endif
    for (int n = 0; n < max_iterations; n++) {
        stationarity = residual_of(s, ESTIMATE, &s->kkt);
        if (s->kkt.relative <= tol) {
            return OK;
        }
#if NG > NT
        if (!moved || stationarity <= accuracy) {
            const int grown = advance_rows(s, tol, &violation);
            failed = moved ? 0 : failed + !grown;
            accuracy = R(0.1) * ((accuracy < violation) ? accuracy : violation);
            accuracy = (accuracy > R(0.1) * tol) ? accuracy : R(0.1) * tol;
        }
#else
        (void)stationarity;
        failed += !moved;
#endif
        if (failed > 1) {
            return (status == INFEASIBLE) ? INFEASIBLE : STALLED;
        }
        s->stats.sqp_iterations++;
        status = improve(s, TRIALS_OF_SOLVE, &moved);
        if (status == NUMERICAL_FAILURE) {
            return status;
        }
#if NT
        if (status == INFEASIBLE && s->shooting.penalty < MOST_PENALTY) {
            s->shooting.penalty *= R(10);
        }
#endif
    }
    (void)residual_of(s, ESTIMATE, &s->kkt);
    return (s->kkt.relative <= tol) ? OK : (status == INFEASIBLE) ? INFEASIBLE : ITERATION_LIMIT;
}

status_t API(solve)(solver_t *s, const real_t xhat[NX], real_t tol, int max_iterations)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!(tol > R(0)) || !isfinite(tol) || max_iterations < 1) {
        return finish(s, BAD_ARGUMENT);
    }
    memset(&s->stats, 0, sizeof s->stats);
    memset(&s->kkt, 0, sizeof s->kkt);
    if (!take_state(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    s->shooting.length = R(1);
    status = start_sample(s);
#if !QUASI_NEWTON
    s->shooting.solving = 1;
#endif
    if (status == OK) {
        (void)merit(s);
        status = iterate(s, tol, max_iterations);
    }
#if NG > NT
    update_rows(s, INF);
#endif
#if NG || !QUASI_NEWTON
    set_weights(s);
#endif
    return finish(s, recover(s, status));
}
