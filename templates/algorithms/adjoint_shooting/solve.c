/* solve(): repeats the steps of a sample until they converge. When the projected gradient is small compared with the
 * violation of the rows, the multipliers of the rows are updated. If the violation has not become much smaller by then,
 * the penalty or the sharpness of the smooth max grows, or the weight of the barriers decreases. */

/* Limits the multipliers of a plan that is no solution to values that one sample could have reached. */
static void limit_rows(solver_t *s)
{
    for (int m = 0; m < NG; m++) {
        const real_t limit = multiplier_unit(s, m);
        s->row[m] = clip(s->row[m], -limit, limit);
    }
}

/* State of the iterations: the violation at the last multiplier update, the stationarity at which the next update takes
 * place, and the number of consecutive iterations without a step or an update. */
typedef struct {
    real_t violation, accuracy;
    int failed;
} progress_t;

/* Updates the multipliers if their update is due. */
static void follow(solver_t *s, real_t tol, real_t stationarity, int moved, progress_t *progress)
{
    if (NG == NT) {
        progress->failed += !moved;
        return;
    }
    if (!moved || stationarity <= progress->accuracy) {
        const int grown = update_terms(s, tol, &progress->violation);
        s->shooting.paired = 0;
        (void)merit(s);
        const real_t least = (progress->accuracy < progress->violation) ? progress->accuracy : progress->violation;
        const int finer = moved && progress->accuracy > FACTOR_ROWS_INNER * tol;
        progress->failed = (grown || finer) ? 0 : progress->failed + 1;
        progress->accuracy = (least > tol) ? FACTOR_ROWS_INNER * least : FACTOR_ROWS_INNER * tol;
    }
}

/* Returns the status of a plan that is not a solution to the tolerance. */
static status_t status_without_solution(status_t of_step, status_t otherwise)
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
    progress.violation = INF;
    progress.accuracy = FACTOR_ROWS_INNER;
    for (int n = 0; n < max_iterations; n++) {
        const real_t stationarity = residual_of(s, ESTIMATE, &s->kkt);
        if (s->kkt.relative <= tol) {
            if (SADDLES) {
                if (leave_saddle(s)) {
                    s->shooting.pairs = 0;
                    (void)merit(s);
                    continue;
                }
            }
            return OK;
        }
        follow(s, tol, stationarity, moved, &progress);
        if (progress.failed > 1) {
            return status_without_solution(status, STALLED);
        }
        s->stats.sqp_iterations++;
        status = improve(s, MOST_TRIALS, &moved);
        if (status == NUMERICAL_FAILURE) {
            return status;
        }
        if (NT > 0 && status == INFEASIBLE && s->shooting.penalty < MOST_PENALTY) {
            s->shooting.penalty *= FACTOR_PENALTY_RATIO;
        }
    }
    (void)residual_of(s, ESTIMATE, &s->kkt);
    return (s->kkt.relative <= tol) ? OK : status_without_solution(status, ITERATION_LIMIT);
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
    (void)memset(&s->stats, 0, sizeof s->stats);
    (void)memset(&s->kkt, 0, sizeof s->kkt);
    if (!take_state(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    s->shooting.length = R(1);
    place_terms(s, 0);
    before_solve(s);
    status = start_sample(s);
    s->shooting.solving = 1;
    if (status == OK) {
        (void)merit(s);
        status = iterate(s, tol, max_iterations);
    }
    if (NG > NT && status == OK) {
        update_rows(s, INF);
    }
    if (NG > 0) {
        set_weights(s);
    }
    if (NG > NT && !BARRIER_ROWS && status != OK) {
        limit_rows(s);
    }
    place_terms(s, status == OK);
    if (PULLED_ROWS && status != OK) {
        pull_plan_back(s);
    }
    s->shooting.pairs = 0; /* the pairs belong to other terms and penalties */
    s->solved = 1;
    return finish(s, keep_finite(s, status));
}
