/* Seam "integrator", contract: INTEGRATOR_INTERVAL (above); interval_value(): x_next of interval k alone;
 * API(integrate): x_next = x(dt), NaN for a solver or an argument that is not fit.
 * Here: a discrete map; dt is its own, whatever is asked for. */

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    INTEGRATOR_STEP(s, k, s->x[k], s->u[k], 0, x_next); /* a map does not read the length of a step */
}

void API(integrate)(const solver_t *s, const real_t x[NX], const real_t u[NU], real_t dt, real_t x_next[NX])
{
    if (s->magic != MAGIC || !all_finite(x, NX) || !all_finite(u, NU) || !isfinite(dt)) {
        for (int i = 0; i < NX; i++) {
            x_next[i] = (real_t)NAN;
        }
        return;
    }
    INTEGRATOR_STEP(s, 0, x, u, &dt, x_next);
}
