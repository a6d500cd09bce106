/* API(measure) makes an estimate. This part stores the data of a sample at its node: controls, measurements and their
 * accuracy. */

/* Stores the measurements y at node k; those that are not finite are missing. */
static void put_measurements(solver_t *s, int k, const real_t *y)
{
    for (int m = 0; m < NM; m++) {
        if (isfinite(y[m])) {
            s->p[k][AT_Y + m] = y[m];
            s->p[k][AT_ACCURACY + m] = accuracy[m];
        }
    }
}

/* Clips states with declared bounds to them. */
static void clip_to_bounds(const solver_t *s, real_t *x)
{
    for (int r = 0; r < NR; r++) {
        const int i = clipped[r];
        if (i >= 0) {
            x[i] = clip(x[i], PATH_LOWER(s, 0, r), PATH_UPPER(s, 0, r));
        }
    }
}

/* Stores the user's parameters at node k, which hold from the present sample on. */
static void put_parameters(solver_t *s, int k)
{
    for (int i = 0; i < AT_U; i++) {
        s->p[k][i] = s->next[i];
    }
}

/* Sets the controls at node k to their declared values. */
static void forget_controls(solver_t *s, int k)
{
    for (int j = 0; j < NIN; j++) {
        s->p[k][AT_U + j] = default_parameter[AT_U + j];
    }
}

/* Marks all measurements at node k as missing. */
static void forget_measurements(solver_t *s, int k)
{
    for (int m = 0; m < NM; m++) {
        s->p[k][AT_Y + m] = R(0);
        s->p[k][AT_ACCURACY + m] = R(0);
    }
}

/* Stores the controls u that have acted since node k. Returns 0, and keeps the previous ones, if one is not finite. */
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

/* Copies the controls of the interval before node k, which its own data still hold, to node k. */
static void keep_controls(solver_t *s, int k)
{
    for (int j = 0; HAS_BEFORE && j < NIN; j++) {
        s->p[k][AT_BEFORE + j] = s->p[k][AT_U + j];
    }
}

/* Fills p with the parameters of the next sample, and with the controls u if sensors depend on them; returns p. */
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

/* Computes the measurements of sensors without noise at the state x and, if sensors depend on them, the controls u.
 * Data of a sample are not read. */
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

/* Returns the declared initial state as the estimate when init() has not been called. */
static status_t refuse(real_t *xhat)
{
    (void)memcpy(xhat, initial_state, sizeof initial_state);
    return NOT_INITIALIZED;
}

#if HUBER
/* Returns the accuracy of a measurement whose error is `deviations` standard deviations, by its weight in Huber's
 * loss. */
static real_t accuracy_with(int m, real_t deviations)
{
    const real_t most = threshold[m], size = FABS(deviations);
    return (most > R(0) && size > most) ? accuracy[m] * SQRT(most / size) : accuracy[m];
}

/* Reduces the accuracy of measurements that the filter does not expect. */
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
