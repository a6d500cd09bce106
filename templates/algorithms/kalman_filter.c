/* Component "algorithm". Contract: algorithm_reset, API(estimate), _covariance, _restart.
 * Here: the extended Kalman filter, linearised at its own estimates. */

#include "algorithms/shared/enlarge.c"

#include "algorithms/shared/finish.c"

#include "algorithms/estimation/filter.c"

#include "algorithms/estimation/data.c"

#include "algorithms/estimation/innovation.c"

/* Starts with the present state of the filter. */
static void begin_filter(solver_t *s)
{
    s->samples = 0;
    (void)memcpy(s->known, s->filter.mean, sizeof s->known);
    s->status = (int32_t)OK;
    (void)memset(s->u, 0, sizeof s->u);
    begin_watch(s);
    forget_measurements(s, 0);
    forget_controls(s, 0);
}

/* Starts with the declared initial state. */
static void algorithm_reset(solver_t *s)
{
    restart_filter(&s->filter);
    begin_filter(s);
}

/* Moves the filter to the present sample; its last estimate can be integrated. */
static void follow_model(solver_t *s)
{
    (void)memcpy(s->x[0], s->filter.mean, sizeof s->x[0]);
    predict_filter(s, 0, &s->filter);
    clip_to_bounds(s, s->filter.mean);
    if (filter_is_sane(&s->filter)) {
        (void)memcpy(s->known, s->x[0], sizeof s->known);
    }
    forget_measurements(s, 0);
}

/* Runs a sample whose controls, if they are known, have been stored. */
static status_t take_sample(solver_t *s, const real_t *y, int known, real_t *xhat)
{
    filter_t *f = &s->filter, expected;
    status_t status = known ? OK : NOT_FINITE;
    s->newton = NEWTON;
    if (s->samples > 0) {
        follow_model(s);
    }
    keep_controls(s, 0);
    put_parameters(s, 0);
    s->samples += (s->samples < MANY);
    put_measurements(s, 0, y);
    (void)memcpy(s->x[0], f->mean, sizeof s->x[0]);
    expected = *f;
    judge_measurements(s, 0, &expected);
    if (is_lost(s)) {
        renew_filter(s, 0, s->x[0], y, f);
    }
    if (HUBER) {
        weigh_by_filter(s, 0, f);
    }
    update_filter(s, 0, f);
    clip_to_bounds(s, f->mean);
    if (!filter_is_sane(f)) {
        restart_filter(f);
        (void)memcpy(f->mean, s->known, sizeof f->mean);
        watch_again(s);
        status = NUMERICAL_FAILURE;
    }
    (void)memcpy(xhat, f->mean, sizeof f->mean);
    return finish(s, judge_innovation(s, status));
}

#if NIN
status_t API(estimate)(solver_t *s, const real_t y[NM], const real_t u[NIN], real_t xhat[NX])
{
    if (s->magic != MAGIC) {
        return refuse(xhat);
    }
    return take_sample(s, y, put_controls(s, 0, u) || s->samples == 0, xhat);
}
#else
status_t API(estimate)(solver_t *s, const real_t y[NM], real_t xhat[NX])
{
    return (s->magic == MAGIC) ? take_sample(s, y, 1, xhat) : refuse(xhat);
}
#endif

status_t API(covariance)(solver_t *s, real_t P[NX * NX])
{
    if (s->magic != MAGIC) {
        (void)memset(P, 0, NX * NX * sizeof *P);
        return NOT_INITIALIZED;
    }
    multiply_factors(&s->filter, P);
    return OK;
}

status_t API(restart)(solver_t *s, const real_t x0[NX], const real_t P0[NX * NX])
{
    filter_t f;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    (void)memcpy(f.mean, x0, sizeof f.mean);
    if (!all_finite(x0, NX) || !factorize_covariance(P0, f.L)) {
        return BAD_ARGUMENT;
    }
    s->filter = f;
    begin_filter(s);
    return OK;
}
