/* Seam "integrator", contract: integrator_interval (above); interval_value(): its x_next alone;
 * integrate(): x_next = x(dt).
 * Here: a discrete map; dt is its own and is not used. */

static void interval_value(const real_t *x, const real_t *u, const real_t *p, real_t dt, real_t *x_next)
{
    integrator_step(x, u, p, &dt, x_next);
}

static void integrate(const real_t *x, const real_t *u, const real_t *p, real_t dt, real_t *x_next)
{
    integrator_step(x, u, p, &dt, x_next);
}
