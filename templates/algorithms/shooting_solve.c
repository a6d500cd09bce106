/* solve(): the steps of a sample to convergence. Where rows have terms, each time the projected gradient is small
 * compared with their violation, their multipliers are updated, and the penalty or the sharpness of the smooth max
 * grows, or the weight of the barriers decreases, where the violation has not become much smaller. */

#if NG > NT
/* Returns 1 if the terms of the rows can become closer to the rows themselves. */
static int sharpen(solver_t *s)
{
#if SMOOTH_ROWS
    if (!(s->shooting.sharpness < smooth_sharpness[2])) {
        return 0;
    }
    s->shooting.sharpness *= R(4);
#elif BARRIER_ROWS
    if (!(s->shooting.penalty > barrier_weight[2])) {
        return 0;
    }
    s->shooting.penalty *= R(0.1);
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

#if !SMOOTH_ROWS && !BARRIER_ROWS
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
        enlarge(&most, (slope - s->row[m]) / multiplier_unit(s, m));
    }
    return most;
}
#endif

/* The dual update. Returns 0 if neither multipliers nor the penalty can improve the rows. */
static int advance_rows(solver_t *s, real_t tol, real_t *violation)
{
    int grown = 0;
#if !SMOOTH_ROWS && !BARRIER_ROWS
    const real_t now = dual_residual(s);
    update_rows(s, R(1));
    if (!(now < R(0.25) * *violation) && now > R(0.1) * tol) {
        grown = sharpen(s);
    }
    grown |= now < *violation;
#else
    const real_t now = s->stats.violation;
    update_rows(s, INF);
    grown = sharpen(s);
#if LUMPED_ROWS
    if (now > tol && !(now < R(0.5) * *violation) && s->shooting.multiplier < MOST_PENALTY) {
        const real_t twice = R(2) * s->shooting.multiplier;
        s->shooting.multiplier = (s->shooting.lump > twice) ? s->shooting.lump : twice;
        grown = 1;
    }
#else
    (void)tol;
#endif
#endif
    *violation = now;
#if QUASI_NEWTON
    s->shooting.paired = 0;
#endif
    (void)merit(s);
    return grown;
}
#endif

#if NG > NT && !BARRIER_ROWS
/* The multipliers of a plan that is no solution: what one sample could have made of them. */
static void limit_rows(solver_t *s)
{
    for (int m = 0; m < NG; m++) {
        const real_t limit = multiplier_unit(s, m);
        s->row[m] = clip(s->row[m], -limit, limit);
    }
}

#endif
/* What iterations remember: the violation at the last dual update, the stationarity at which the next one takes place,
 * and how often neither a step nor an update has changed anything. */
typedef struct {
#if NG > NT
    real_t violation, accuracy;
#endif
    int failed;
} progress_t;

/* The dual update, if its time has come. */
static void follow(solver_t *s, real_t tol, real_t stationarity, int moved, progress_t *progress)
{
#if NG > NT
    if (!moved || stationarity <= progress->accuracy) {
        const int grown = advance_rows(s, tol, &progress->violation);
        const real_t least = (progress->accuracy < progress->violation) ? progress->accuracy : progress->violation;
        const int finer = moved && progress->accuracy > R(0.1) * tol;
        progress->failed = (grown || finer) ? 0 : progress->failed + 1;
        progress->accuracy = (least > tol) ? R(0.1) * least : R(0.1) * tol;
    }
#else
    (void)s;
    (void)tol;
    (void)stationarity;
    progress->failed += !moved;
#endif
}

/* The status of a plan that is not a solution to the tolerance. */
static status_t unsolved(status_t of_step, status_t otherwise)
{
    return (of_step == INFEASIBLE) ? INFEASIBLE : otherwise;
}

/* Iterates from the simulated plan. */
static status_t iterate(solver_t *s, real_t tol, int max_iterations)
{
    progress_t progress;
    status_t status = OK;
    int moved = 1;
    progress.failed = 0;
#if NG > NT
    progress.violation = INF;
    progress.accuracy = R(0.1);
#endif
    for (int n = 0; n < max_iterations; n++) {
        const real_t stationarity = residual_of(s, ESTIMATE, &s->kkt);
        if (s->kkt.relative <= tol) {
            return OK;
        }
        follow(s, tol, stationarity, moved, &progress);
        if (progress.failed > 1) {
            return unsolved(status, STALLED);
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
    return (s->kkt.relative <= tol) ? OK : unsolved(status, ITERATION_LIMIT);
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
#if NG && (SMOOTH_ROWS || BARRIER_ROWS)
    place_terms(s, 0);
#if BARRIER_ROWS
    memset(s->shooting.tilt, 0, sizeof s->shooting.tilt);
#endif
#endif
    status = start_sample(s);
#if !QUASI_NEWTON
    s->shooting.solving = 1;
#endif
    if (status == OK) {
        (void)merit(s);
        status = iterate(s, tol, max_iterations);
    }
#if NG > NT
    if (status == OK) {
        update_rows(s, INF);
    }
#endif
#if NG || !QUASI_NEWTON
    set_weights(s);
#endif
#if NG > NT && !BARRIER_ROWS
    if (status != OK) {
        limit_rows(s);
    }
#endif
#if NG && (SMOOTH_ROWS || BARRIER_ROWS)
    place_terms(s, status == OK);
#endif
#if QUASI_NEWTON
    s->shooting.pairs = 0; /* of other terms and penalties */
#endif
    return finish(s, recover(s, status));
}
