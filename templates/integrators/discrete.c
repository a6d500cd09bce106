/* Component "integrator". Contract: INTEGRATOR_INTERVAL (above); interval_value(): only x_next of interval k;
 * API(integrate): x_next = x(dt), NaN if the solver is not initialised or an argument is not finite.
 * Here: a discrete map, whose sampling time is fixed; the argument dt has no effect. */

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    INTEGRATOR_STEP(s, k, s->x[k], s->u[k], 0, x_next); /* a discrete map does not read the step length */
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
