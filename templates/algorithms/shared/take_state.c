#if ALL_MEASURED
/* s->xhat = xhat. Returns 0 if an entry is not finite. */
static int take_state(solver_t *s, const real_t *xhat)
{
    if (!all_finite(xhat, NXHAT)) {
        return 0;
    }
    for (int i = 0; i < NXHAT; i++) {
        s->xhat[i] = or_zero(xhat[i], i);
    }
    if (AUGMENTED) {
        take_augmented(s, s->xhat);
    }
    return 1;
}
#else
/* Sets s->xhat: measured entries from xhat, accumulated costs to 0, the others from x_0 of the plan. Returns 0 if a
 * measured entry is not finite. */
static int take_state(solver_t *s, const real_t *xhat)
{
    for (int i = 0; i < NXHAT; i++) {
        if (is_measured[i] && !isfinite(xhat[i])) {
            return 0;
        }
    }
    for (int i = 0; i < NXHAT; i++) {
        s->xhat[i] = is_measured[i] ? or_zero(xhat[i], i) : (is_accumulator[i] ? R(0) : s->x[0][i]);
    }
    if (AUGMENTED) {
        take_augmented(s, s->xhat);
    }
    return 1;
}
#endif
