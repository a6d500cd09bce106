/* Component "algorithm". Contract: algorithm_reset, API(estimate), _correct, _covariance, _restart. Here: moving
 * horizon estimation. A sample moves the window by one node, linearises it at the last estimate and solves a QP, and
 * further ones while the estimate still moves far. */

#include "generated/hooks.c"

#include "algorithms/shared/plan.c"

#include "algorithms/shared/enlarge.c"

#include "algorithms/shared/forget_sizes.c"

#include "algorithms/shared/linearize.c"

#include "algorithms/shared/finish.c"

#include "algorithms/shared/scales.c"

#include "algorithms/real_time_iteration/curvature_at.c"

#include "algorithms/real_time_iteration/apply.c"

#include "algorithms/shared/shift_by_one.c"

#include "algorithms/estimation/filter.c"

#include "algorithms/estimation/data.c"

#include "algorithms/estimation/innovation.c"

#include "algorithms/estimation/window.c"

/* Starts with the declared initial state. */
static void algorithm_reset(solver_t *s)
{
    forget_plan(s);
    s->status = (int32_t)OK;
    s->relaxation = INF;
    (void)memset(s->row_scale, 0, sizeof s->row_scale);
    forget_sizes(s);
    restart_filter(&s->arrival);
    restart_window(s);
}

/* Takes one step towards the estimate with the data of the window. */
static status_t improve_estimate(solver_t *s)
{
    status_t status;
    if (HUBER) {
        weigh_by_window(s);
    }
    take_penalties(s);
    (void)memcpy(s->xhat, s->x[0], sizeof s->xhat);
    linearize(s);
    hessian(s);
    hold_future(s);
    status = condense_prepare(s);
    status = (status == OK) ? feedback_here(s) : status;
    clip_window(s);
    return status;
}

/* Computes the present state from the data of the window. */
static status_t estimate_here(solver_t *s, real_t *xhat)
{
    status_t status = OK;
    int moves = 1;
    s->newton = NEWTON;
    for (int n = 0; n < ITERATIONS && moves && status == OK; n++) {
        real_t size[NX];
        status = improve_estimate(s);
        if (status == OK) {
            state_scales(s, size);
            s->stats.residual = gap_of_window(s, size);
            moves = is_far(s->stats.residual) || is_far(change_of_estimate(s, size));
        }
    }
    status = judge_residual(status, s->stats.residual);
    learn_sizes(s, status);
    if (status == OK) {
        (void)memcpy(s->known, s->x[s->window], sizeof s->known);
    } else {
        filter_window(s);
    }
    (void)memcpy(xhat, s->x[s->window], sizeof s->x[s->window]);
    return finish(s, judge_innovation(s, status));
}

/* Runs a sample whose controls, if they are known, have been stored. */
static status_t take_sample(solver_t *s, const real_t *y, int known, real_t *xhat)
{
    status_t status;
    if (s->samples > 0) {
        move_window(s);
    }
    keep_controls(s, s->window);
    put_parameters(s, s->window);
    s->samples += (s->samples < MANY);
    put_measurements(s, s->window, y);
    judge_measurements(s, s->window, &s->expected);
    if (is_lost(s)) {
        renew_window(s, y);
    }
    status = estimate_here(s, xhat);
    return (known || (status != OK && status != NOT_CONVERGED)) ? status : finish(s, NOT_FINITE);
}

#if NIN
status_t API(estimate)(solver_t *s, const real_t y[NM], const real_t u[NIN], real_t xhat[NX])
{
    if (s->magic != MAGIC) {
        return refuse(xhat);
    }
    return take_sample(s, y, put_controls(s, s->window, u) || s->samples == 0, xhat);
}
#else
status_t API(estimate)(solver_t *s, const real_t y[NM], real_t xhat[NX])
{
    return (s->magic == MAGIC) ? take_sample(s, y, 1, xhat) : refuse(xhat);
}
#endif

status_t API(correct)(solver_t *s, const real_t y[NM], int age, real_t xhat[NX])
{
    if (s->magic != MAGIC) {
        return refuse(xhat);
    }
    (void)memcpy(xhat, s->x[s->window], sizeof s->x[s->window]);
    if (age < 0 || age > s->window || s->samples == 0) {
        return BAD_INDEX;
    }
    put_measurements(s, s->window - age, y);
    return estimate_here(s, xhat);
}

status_t API(covariance)(solver_t *s, real_t P[NX * NX])
{
    filter_t f;
    status_t status = OK;
    if (s->magic != MAGIC) {
        (void)memset(P, 0, NX * NX * sizeof *P);
        return NOT_INITIALIZED;
    }
    f = s->arrival;
    for (int k = 0; k < s->window; k++) {
        update_filter(s, k, &f);
        predict_filter(s, k, &f);
    }
    update_filter(s, s->window, &f);
    if (!filter_is_sane(&f)) {
        restart_filter(&f);
        status = NUMERICAL_FAILURE;
    }
    multiply_factors(&f, P);
    return status;
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
    algorithm_reset(s);
    s->arrival = f;
    restart_window(s);
    return OK;
}

#include "generated/hooked.c"
