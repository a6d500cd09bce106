/* Component "integrator". Contract: that of explicit_runge_kutta.c. Here: implicit Runge-Kutta with equal steps. A
 * sample takes NEWTON steps of Newton's method per stage; all other calls iterate to rounding errors. */

#include "integrators/noise.c"

/* Computes x_next of interval k, and the residual of Newton's method in its stages. */
static void interval_leaving(const solver_t *s, int k, real_t *x_next, real_t *left)
{
    INTEGRATOR_VALUE(s, k, x_next, left);
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, k, s->x[k], s->u[k], x_next);
    }
    add_noise(s->u[k], x_next);
}

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    real_t left[NX];
    interval_leaving(s, k, x_next, left);
}

#if NALG
/* Sets the algebraic variables to their declared values. */
static void forget_algebraic(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        (void)memcpy(s->z[k], algebraic_start, sizeof s->z[k]);
    }
}

/* Computes the algebraic variables of node k at (x, u), in the point (x, z). Returns -1, or the reason why Newton's
 * method fails. */
static int algebraic_of_node(const solver_t *s, int k, const real_t *x, const real_t *u, real_t *point)
{
    real_t M[NALG][NALG];
    int order[NALG];
    (void)memcpy(point, x, NX * sizeof *x);
    return find_algebraic(point, s->z[k], u, (k < N) ? PARAM(s, k) : PARAM_N(s), M, order);
}

/* Updates the algebraic variables along the plan, where Newton's method starts next. */
static void follow_algebraic(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        real_t point[NXA];
        const int reason = algebraic_of_node(s, k, s->x[k], s->u[(k < N) ? k : N - 1], point);
        (void)memcpy(s->z[k], (reason < 0) ? point + NX : algebraic_start, sizeof s->z[k]);
    }
}

/* Marks the plan of a sample as far from the model if the equations have no solution at its first node. */
static void require_algebraic(solver_t *s)
{
    real_t point[NXA];
    if (algebraic_of_node(s, 0, s->x[0], s->u[0], point) >= 0) {
        s->stats.residual = INF;
    }
}

/* Records the first of the nodes first .. last at which the equations have no solution. Returns 1 if there is one. */
static int name_failed_node(solver_t *s, int first, int last)
{
    for (int k = first; k <= last; k++) {
        real_t point[NXA];
        const int reason = algebraic_of_node(s, k, s->x[k], s->u[(k < N) ? k : N - 1], point);
        if (reason >= 0) {
            s->failed_interval = (int32_t)k;
            s->failed_state = (int32_t)((reason < NALG) ? NX + reason : NXA + NX + reason - NALG);
            return 1;
        }
    }
    return 0;
}
#endif

/* Records the stages at which an evaluation of the plan fails: interval, step, group of stages (both -1 for equations
 * of a node), and the variable whose column of the Newton matrix has no pivot or, with NXA added, the variable that
 * does not converge; -1 if none fails. */
static void name_failed_stage(solver_t *s, status_t status)
{
    s->failed_interval = -1;
    s->failed_step = -1;
    s->failed_stage = -1;
    s->failed_state = -1;
    if (NALG) {
        if ((status == NUMERICAL_FAILURE || status == NOT_CONVERGED) && name_failed_node(s, 0, N - 1)) {
            return;
        }
    }
    for (int k = 0; status == NUMERICAL_FAILURE && k < N; k++) {
        real_t failure[3];
        INTEGRATOR_FAILURE(s, k, failure);
        if (failure[0] >= R(0)) {
            s->failed_interval = (int32_t)k;
            s->failed_state = (int32_t)failure[0];
            s->failed_step = (int32_t)failure[1];
            s->failed_stage = (int32_t)failure[2];
            return;
        }
    }
    if (NALG) {
        if (status == NUMERICAL_FAILURE) {
            (void)name_failed_node(s, N, N);
        }
    }
}

/* Returns the residual of Newton's method in the stages along the plan, for algorithms whose samples do not linearise
 * it. */
static real_t stage_residual(const solver_t *s)
{
    real_t most = R(0);
    for (int k = 0; k < N; k++) {
        real_t x_next[NX], left[NX];
        interval_leaving(s, k, x_next, left);
        for (int i = 0; i < NX; i++) {
            const real_t size = left[i] * state_unit[i];
            most = (size > most) ? size : most;
        }
        if (!all_finite(x_next, NX)) {
            return INF;
        }
    }
    return most;
}

#include "integrators/steps.c"
