/* Contract of this part: API(measure), and the data of a node that the sample knows: controls, measurements and their
 * accuracy. */

/* The measurements y that are finite take their place at node k. */
static void put_measurements(solver_t *s, int k, const real_t *y)
{
    for (int m = 0; m < NM; m++) {
        if (isfinite(y[m])) {
            s->p[k][AT_Y + m] = y[m];
            s->p[k][AT_ACCURACY + m] = accuracy[m];
        }
    }
}

/* What is declared to be inside of bounds is. */
static void clip_to_bounds(const solver_t *s, real_t *x)
{
    for (int r = 0; r < NR; r++) {
        const int i = clipped[r];
        if (i >= 0) {
            x[i] = clip(x[i], PATH_LOWER(s, 0, r), PATH_UPPER(s, 0, r));
        }
    }
}

/* The parameters of the user at node k are those that hold from the present sample on. */
static void put_parameters(solver_t *s, int k)
{
    for (int i = 0; i < AT_U; i++) {
        s->p[k][i] = s->next[i];
    }
}

/* The controls at node k have their declared values. */
static void forget_controls(solver_t *s, int k)
{
    for (int j = 0; j < NIN; j++) {
        s->p[k][AT_U + j] = default_parameter[AT_U + j];
    }
}

/* Nothing is measured at node k. */
static void forget_measurements(solver_t *s, int k)
{
    for (int m = 0; m < NM; m++) {
        s->p[k][AT_Y + m] = R(0);
        s->p[k][AT_ACCURACY + m] = R(0);
    }
}

/* The controls u that have acted since node k. Returns 0 if one is not finite; then those before are kept. */
static int put_controls(solver_t *s, int k, const real_t *u)
{
    if (!all_finite(u, NIN)) {
        return 0;
    }
    for (int j = 0; j < NIN; j++) {
        s->p[k][AT_U + j] = u[j];
    }
    return 1;
}

/* Node k knows the controls of the interval before it, which its own data still have. */
static void keep_controls(solver_t *s, int k)
{
    for (int j = 0; HAS_BEFORE && j < NIN; j++) {
        s->p[k][AT_BEFORE + j] = s->p[k][AT_U + j];
    }
}

/* p, filled with the parameters of the next sample, and the controls u where sensors see them. */
static const real_t *seen_parameters(const solver_t *s, const real_t *u, real_t *p)
{
    for (int i = 0; i < AT_U; i++) {
        p[i] = s->next[i];
    }
    for (int j = 0; HAS_BEFORE && j < NIN; j++) {
        p[AT_BEFORE + j] = u[j];
    }
    return p;
}

/* What sensors without noise tell of x, where the controls u act, if there are any. They read no data of a sample. */
static status_t tell_measurements(const solver_t *s, const real_t *x, const real_t *u, real_t *y)
{
    real_t p[NP] = {R(0)}, H[NM][NX];
    if (s->magic != MAGIC) {
        for (int m = 0; m < NM; m++) {
            y[m] = (real_t)NAN;
        }
        return NOT_INITIALIZED;
    }
    MEASUREMENT(x, seen_parameters(s, u, p), y, H);
    return OK;
}

#if NIN
status_t API(measure)(solver_t *s, const real_t x[NX], const real_t u[NIN], real_t y[NM])
{
    return tell_measurements(s, x, u, y);
}
#else
status_t API(measure)(solver_t *s, const real_t x[NX], real_t y[NM])
{
    return tell_measurements(s, x, x, y);
}
#endif

/* Without init() the estimate is the declared initial state. */
static status_t refuse(real_t *xhat)
{
    (void)memcpy(xhat, initial_state, sizeof initial_state);
    return NOT_INITIALIZED;
}

#if HUBER
/* The accuracy of a measurement with an error of so many standard deviations, and its weight in Huber's loss. */
static real_t accuracy_with(int m, real_t deviations)
{
    const real_t most = threshold[m], size = FABS(deviations);
    return (most > R(0) && size > most) ? accuracy[m] * SQRT(most / size) : accuracy[m];
}

/* Outliers are what the filter does not expect. */
static void weigh_by_filter(solver_t *s, int k, const filter_t *f)
{
    real_t y[NM], H[NM][NX] = {{R(0)}};
    MEASUREMENT(s->x[k], PARAM(s, k), y, H);
    for (int m = 0; m < NM; m++) {
        if (s->p[k][AT_ACCURACY + m] > R(0)) {
            const real_t size = expected_deviation(f, H[m], R(1) / accuracy[m]);
            s->p[k][AT_ACCURACY + m] = accuracy_with(m, (s->p[k][AT_Y + m] - y[m]) / size);
        }
    }
}
#endif
