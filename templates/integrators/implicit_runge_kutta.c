/* Component "integrator". Contract: that of explicit_runge_kutta.c.
 * Here: implicit Runge-Kutta with equal steps. A sample takes NEWTON steps of Newton's method per stage; kkt()[if SOLVE:,
 * solve()] and integrate() iterate to rounding errors. */

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    INTEGRATOR_VALUE(s, k, x_next);
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, k, s->x[k], s->u[k], x_next);
    }
}

#include "integrators/steps.c"
