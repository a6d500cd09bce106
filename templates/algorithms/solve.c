/* SQP to convergence: the steps of the real-time iteration, globalised by a filter line search (Waechter and Biegler
 * 2005, algorithm A). An iteration computes the Hessian, solves the QP and searches along its step; after a search that
 * has failed, another start follows. */

#include "algorithms/solve/measures.c"

/* Linearises the present point, unless that has been done, and evaluates the Hessian of samples. */
static void evaluate_for_sample(solver_t *s)
{
    if (ITERATES && s->sqp.linearized) {
        hessian(s);
    } else {
        evaluate_here(s);
    }
    s->sqp.linearized = 0;
}

#if CURVED
#include "algorithms/solve/curved.c"
#else
#include "algorithms/solve/hessian_of_samples.c"
#endif

#if HARD_ROWS
#include "algorithms/solve/hard_rows.c"
#else
#include "algorithms/solve/no_hard_rows.c"
#endif

#include "algorithms/solve/filter.c"

#include "algorithms/solve/search.c"

#include "algorithms/solve/restart.c"

/* Runs one globalised iteration at a point that has been linearised. */
static status_t sqp_iteration(solver_t *s)
{
    sqp_t *q = &s->sqp;
    update_scales(s); /* a relaxed QP needs them */
    status_t status = form_qp(s);
    status = (status == OK) ? solve_qp(s) : status;
    if (status != OK) {
        restore_gradients(s);
        if (damp_qp(s)) {
            return OK;
        }
        return (status == ITERATION_LIMIT || status == STALLED) ? SUBPROBLEM_FAILED : status;
    }
    put_step_aside(s);
    restore_gradients(s);
    update_scales(s);
    q->base = measure(s);
    if (!step_is_finite(s) || !isfinite(q->base.violation) || !isfinite(q->base.cost)) {
        return NUMERICAL_FAILURE;
    }
    if (!(q->most_violation < INF)) {
        q->most_violation = FACTOR_FILTER_LIMIT * ((q->base.violation > R(1)) ? q->base.violation : R(1));
    }
    (void)memcpy(s->trial.x, s->x, sizeof s->x);
    (void)memcpy(s->trial.u, s->u, sizeof s->u);
    status = search(s);
    if (adapt_shifts(s, status)) {
        return OK;
    }
    if (status == OK && is_damped_for_ever(s)) {
        return SUBPROBLEM_FAILED;
    }
    if (status == OK) {
        take_multipliers(s);
        bound_multipliers(s);
    }
    return status;
}

/* Replaces the Hessian of the sample by the exact one after an iteration that did not take the full step, or that
 * brought the plan little nearer to a solution. Returns the status of the search. */
static status_t take_exact_hessian(solver_t *s, status_t status)
{
    if (CURVED && ITERATES) {
        sqp_t *q = &s->sqp;
        const int slow = s->stats.sqp_iterations > 0 && !(s->kkt.relative <= FACTOR_NEAR_CONTRACTION * q->before);
        q->before = s->kkt.relative;
        if (!s->curved.in_solve && (status != OK || s->trial.length < R(1) || slow)) {
            s->curved.in_solve = 1;
            return OK;
        }
    }
    return status;
}

/* Returns 1 if x_0 of the plan is the measured state. */
static int starts_at_measured(const solver_t *s)
{
    for (int i = 0; i < NX; i++) {
        if ((is_measured[i] || is_accumulator[i]) &&
            !(FABS(s->xhat[i] - s->x[0][i]) <= TOL_ROUNDING * (z_scale[i] + FABS(s->xhat[i])))) {
            return 0;
        }
    }
    return 1;
}

#if SADDLES
#include "algorithms/solve/saddles.c"
#endif

/* Iterates until stats.sqp_iterations = last. */
static status_t iterate(solver_t *s, real_t tol, int last)
{
    for (;; s->stats.sqp_iterations++) {
#if ITERATES
        /* at most SAMPLE_ITERATIONS passes in iterations_after_feedback */
#endif
        evaluate_iterate(s);
#if SADDLES
        const int found = look_for_saddle(s, kkt_is_within(s, tol) && starts_at_measured(s));
        if (found == IS_SOLVED) {
            return OK;
        }
        if (found == HAS_LEFT && s->stats.sqp_iterations < last) {
            continue;
        }
#else
        if (kkt_is_within(s, tol) && starts_at_measured(s)) {
            return OK;
        }
#endif
        if (s->stats.sqp_iterations >= last) {
            return ITERATION_LIMIT;
        }
        status_t status = sqp_iteration(s);
        status = take_exact_hessian(s, status);
        if (SADDLES && SOLVE) {
            if (status != OK && s->saddle.departed > 0) {
                end_departure(s, 0);
                return OK;
            }
        }
        if (status == OK && cost_is_unbounded(s)) {
            return STALLED;
        }
        if (HARD_ROWS) {
            status = raise_row_weight(s, status);
        }
        if (status != OK) {
            return status;
        }
    }
}

static status_t solve_here(solver_t *s, real_t tol, int last)
{
    for (;;) { /* at most MAX_ATTEMPTS + 1 passes */
        const status_t status = iterate(s, tol, last);
        const int ends = status == OK || status == ITERATION_LIMIT ||
            (status == STALLED && !(s->sqp.base.violation > FACTOR_SQP_INFEASIBLE));
        s->sqp.infeasible |= status == INFEASIBLE;
        if (ends || s->sqp.attempts == MAX_ATTEMPTS || s->stats.sqp_iterations++ >= last) {
            if (HARD_ROWS && !ends && s->sqp.infeasible) {
                return INFEASIBLE;
            }
            return status;
        }
        restart_search(s);
    }
}

#if SOLVE
/* Solves from the plan, without its entries that are not finite, or resumes the last search. */
status_t API(solve)(solver_t *s, const real_t xhat[NXHAT], real_t tol, int max_iterations)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    take_penalties(s);
    s->prepared = 0;
    s->unsettled = 0;
    before_solve(s);
    if (!(tol > R(0)) || max_iterations < 0) {
        return finish(s, BAD_ARGUMENT);
    }
    if (!s->sqp.resumes && !take_over(s, xhat)) {
        return finish(s, NOT_FINITE);
    }
    s->curved.in_solve = 1;
    status = solve_here(s, tol, max_iterations);
    s->curved.in_solve = 0;
    s->sqp.resumes = 0;
    s->trial.elastic = 0;
    s->solved = 1;
    if (HARD_ROWS && status == INFEASIBLE) {
        name_violation(s);
    }
    if (PULLED_ROWS && status != OK) {
        pull_plan_back(s);
    }
    return finish(s, status);
}
#endif
