/* Component "integrator". Contract:
 *   interval_value   x_next of interval k without derivatives
 *   API(integrate)   x_next = x(dt), NaN if the solver is not initialised or an argument is not finite
 * Here: a discrete map. Its sampling time is fixed, and an argument dt has no effect. */

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    INTEGRATOR_STEP(s, k, s->x[k], s->u[k], 0, s->newton, x_next); /* A discrete map does not read the step length. */
}

#if !ESTIMATOR
void API(integrate)(const solver_t *s, const real_t x[NXHAT], const real_t u[NU], real_t dt, real_t x_next[NXHAT])
{
    if (s->magic != MAGIC || !all_finite(x, NXHAT) || !all_finite(u, NU) || !isfinite(dt)) {
        for (int i = 0; i < NXHAT; i++) {
            x_next[i] = (real_t)NAN;
        }
        return;
    }
    if (AUGMENTED) {
        real_t whole[NX], end[NX];
        (void)memcpy(whole, x, NXHAT * sizeof *x);
        recall_augmented(s, whole);
        INTEGRATOR_STEP(s, 0, whole, u, &dt, NEWTON_LIMIT, end);
        (void)memcpy(x_next, end, NXHAT * sizeof *x);
    } else {
        INTEGRATOR_STEP(s, 0, x, u, &dt, NEWTON_LIMIT, x_next);
    }
}
#endif
