/* Seam "integrator", contract: integrator_interval (above); interval_value(): its x_next alone;
 * integrate(): x_next = x(dt) for any dt >= 0.
 * Here: explicit Runge-Kutta; integrate() takes equal steps no longer than the controller's longest one. */

static void interval_value(const real_t *x, const real_t *u, const real_t *p, real_t dt, real_t *x_next)
{
    const real_t h = dt / (real_t)STEPS;
    int n;
    integrator_step(x, u, p, &h, x_next);
    for (n = 1; n < STEPS; n++) {
        integrator_step(x_next, u, p, &h, x_next);
    }
}

static void integrate(const real_t *x, const real_t *u, const real_t *p, real_t dt, real_t *x_next)
{
    const real_t count = CEIL(dt / step_length[0] - TOL_STEP_COUNT);
    const int steps = (count >= R(1)) ? ((count < (real_t)MANY) ? (int)count : MANY) : 1;
    const real_t h = dt / (real_t)steps;
    int n, i;
    for (i = 0; i < NX; i++) {
        x_next[i] = x[i];
    }
    for (n = 0; n < steps; n++) {
        integrator_step(x_next, u, p, &h, x_next);
    }
}
