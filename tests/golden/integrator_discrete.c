/* ==== integrator: discrete ================================================================================ */

/* Seam "integrator", contract: integrator_interval (above); interval_value(): its x_next alone;
 * integrate(): x_next = x(dt).
 * Here: a discrete map; dt is its own and is not used. */

static void interval_value(const golden_real *x, const golden_real *u, const golden_real *p, golden_real dt, golden_real *x_next)
{
    integrator_step(x, u, p, &dt, x_next);
}

static void integrate(const golden_real *x, const golden_real *u, const golden_real *p, golden_real dt, golden_real *x_next)
{
    integrator_step(x, u, p, &dt, x_next);
}
