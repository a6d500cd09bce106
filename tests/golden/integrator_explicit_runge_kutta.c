/* ==== integrator: explicit_runge_kutta ==================================================================== */

/* Seam "integrator", contract: integrator_interval (above); interval_value(): its x_next alone;
 * integrate(): x_next = x(dt) for any dt >= 0.
 * Here: explicit Runge-Kutta; integrate() takes equal steps no longer than the controller's longest one. */

static void interval_value(const golden_real *x, const golden_real *u, const golden_real *p, golden_real dt, golden_real *x_next)
{
    const golden_real h = dt / (golden_real)GOLDEN_STEPS;
    int n;
    integrator_step(x, u, p, &h, x_next);
    for (n = 1; n < GOLDEN_STEPS; n++) {
        integrator_step(x_next, u, p, &h, x_next);
    }
}

static void integrate(const golden_real *x, const golden_real *u, const golden_real *p, golden_real dt, golden_real *x_next)
{
    const golden_real count = ceil(dt / step_length[0] - 9.094947017729282e-13);
    const int steps = (count >= 1.0) ? ((count < (golden_real)GOLDEN_MANY) ? (int)count : GOLDEN_MANY) : 1;
    const golden_real h = dt / (golden_real)steps;
    int n, i;
    for (i = 0; i < GOLDEN_NX; i++) {
        x_next[i] = x[i];
    }
    for (n = 0; n < steps; n++) {
        integrator_step(x_next, u, p, &h, x_next);
    }
}
