/* Component "integrator". Contract: that of explicit_runge_kutta.c.
 * Here: implicit Runge-Kutta with equal steps. A sample takes NEWTON steps of Newton's method per stage; kkt()[if SOLVE:,
 * solve()] and integrate() iterate to rounding errors. */

/* x_next of interval k, and what Newton's method leaves of its stages. */
static void interval_leaving(const solver_t *s, int k, real_t *x_next, real_t *left)
{
    INTEGRATOR_VALUE(s, k, x_next, left);
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, k, s->x[k], s->u[k], x_next);
    }
}

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    real_t left[NX];
    interval_leaving(s, k, x_next, left);
}

/* Names the stage at which an evaluation of the plan fails: interval, step, stage, and the state whose column of the
 * Newton matrix has no pivot or, with NX added, the one that does not converge; -1: none fails. */
static void name_failed_stage(solver_t *s, status_t status)
{
    s->failed_interval = s->failed_step = s->failed_stage = s->failed_state = -1;
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
}

/* What Newton's method leaves of the stages along the plan, for algorithms whose samples do not linearise it. */
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
