/* Component "integrator". Contract:
 *   interval_value   x_next of interval k without derivatives
 *   integrate_plan   x_next = x(dt) from x under the control u_k, any dt >= 0
 *   plan_steps       the number of steps of integrate_plan, each by INTEGRATOR_STEP
 *   API(integrate)   x(dt) from x for any control and any dt >= 0, NaN for another dt or if the solver is not
 *   initialised
 * Here: explicit Runge-Kutta with equal steps, none longer than the longest step of the controller. */

#include "integrators/noise.c"

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    const real_t h = interval_length[k] / (real_t)STEPS;
    INTEGRATOR_STEP(s, k, s->x[k], s->u[k], &h, s->newton, x_next);
    for (int n = 1; n < STEPS; n++) {
        INTEGRATOR_STEP(s, k, x_next, s->u[k], &h, s->newton, x_next);
    }
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, k, s->x[k], s->u[k], x_next);
    }
    add_noise(s->u[k], x_next);
}

#include "integrators/steps.c"
