/* Contract of this part: the innovation is the error of a measurement in standard deviations of its prediction.
 * judge_measurements() compares the measurements of a sample with the prediction, is_lost() detects that the filter has
 * diverged, renew_filter() restarts it, and judge_innovation() gives the status. */

/* Clears all innovations. */
static void forget_innovations(solver_t *s)
{
    s->stats.innovation = R(0);
    s->stats.error = R(0);
    s->stats.measurement = -1;
}

/* Starts the counters before the first sample. */
static void begin_watch(solver_t *s)
{
    (void)memset(&s->watch, 0, sizeof s->watch);
    forget_innovations(s);
}

/* Returns the sum of `count` squared normal numbers that is exceeded once in 3e5 samples (Wilson and Hilferty). */
static real_t largest_sum(real_t count)
{
    const real_t width = FACTOR_INNOVATION_CUBE_ROOT / count;
    const real_t root = R(1) - width + FACTOR_INNOVATION_QUANTILE * SQRT(width);
    return count * root * root * root;
}

/* Returns the magnitude of the innovation with this error and standard deviation `size`; records measurement m if it is
 * the largest one. */
static real_t note_innovation(solver_t *s, int m, real_t error, real_t size)
{
    const real_t found = FABS(error) / size;
    const real_t magnitude = (found < FACTOR_INNOVATION_LARGEST) ? found : FACTOR_INNOVATION_LARGEST;
    if (s->stats.measurement < 0 || magnitude > s->stats.innovation) {
        s->stats.innovation = magnitude;
        s->stats.error = error;
        s->stats.measurement = m;
    }
    return magnitude;
}

/* Records the innovation of a sample that has taken measurement m, limited to the accepted range. */
static void keep_innovation(watch_t *w, int m, real_t innovation)
{
    const real_t memory = FACTOR_INNOVATION_MEMORY_OF_SIGNS;
    w->surprise += innovation * innovation;
    w->count += R(1);
    w->sum[m] = memory * w->sum[m] + innovation;
    w->variance[m] = memory * memory * w->variance[m] + R(1);
}

/* Returns 1 if neither the squared innovations nor their sums are larger than noise explains. */
static int is_expected(const watch_t *w)
{
    int expected = w->surprise <= largest_sum(w->count);
    for (int m = 0; m < NM; m++) {
        expected &= FABS(w->sum[m]) <= FACTOR_INNOVATION_QUANTILE * SQRT(w->variance[m]);
    }
    return expected;
}

/* Counts consecutive samples that are as expected, or that are not. After several unexpected ones, the estimate is in
 * doubt. The first samples are not counted, because the filter still converges through states where the model is
 * nonlinear. */
static void count_sample(watch_t *w, int left_out, int taken)
{
    w->seen += (taken && w->seen < EXPECTED_SAMPLES);
    if (left_out || (taken && !is_expected(w))) {
        w->expected = left_out ? w->expected : 0;
        w->doubted += (w->doubted < MANY && (left_out || w->seen == EXPECTED_SAMPLES));
    } else if (taken) {
        w->trial = (w->doubted > EXPECTED_OUTLIERS + 1) ? TRIAL_SAMPLES : w->trial - (w->trial > 0);
        w->expected += (w->expected < MANY);
        w->doubted = 0;
        w->restarts = (w->expected < FORGIVING_SAMPLES) ? w->restarts : 0;
    }
}

/* Compares the measurements of node k with the prediction f of the state x[k], and updates f with them. A measurement
 * far from its prediction counts as missing while those before it were as expected; an absurd one always does. */
static void judge_measurements(solver_t *s, int k, filter_t *f)
{
    watch_t *w = &s->watch;
    const real_t most = (w->expected >= EXPECTED_SAMPLES) ? FACTOR_INNOVATION_FAR : FACTOR_INNOVATION_WIDEST;
    real_t *p = s->p[k], y[NM], H[NM][NX] = {{R(0)}};
    int left_out = 0, taken = 0;
    w->surprise *= FACTOR_INNOVATION_MEMORY;
    w->count *= FACTOR_INNOVATION_MEMORY;
    forget_innovations(s);
    MEASUREMENT(s->x[k], PARAM(s, k), y, H);
    for (int m = 0; m < NM; m++) {
        const real_t own = R(1) / accuracy[m];
        if (!(p[AT_ACCURACY + m] > R(0))) {
            continue;
        }
        const real_t error = error_at_mean(f, s->x[k], H[m], p[AT_Y + m] - y[m]);
        real_t innovation = note_innovation(s, m, error, expected_deviation(f, H[m], own));
        if (innovation > most) {
            p[AT_ACCURACY + m] = R(0);
            left_out = 1;
            continue;
        }
        take_measurement(f, H[m], error, own * own);
        innovation = (innovation < FACTOR_INNOVATION_FAR) ? innovation : FACTOR_INNOVATION_FAR;
        keep_innovation(w, m, (error > R(0)) ? innovation : -innovation);
        taken = 1;
    }
    w->left_out = left_out;
    count_sample(w, left_out, taken);
}

/* Returns 1 if measurements have been unexpected for so long that the estimate must be wrong. The limit doubles after
 * each restart that has not helped. */
static int is_lost(const solver_t *s)
{
    return (s->watch.doubted >> s->watch.restarts) >= DOUBTED_SAMPLES;
}

/* Clears the counters after the estimate has been discarded; the next estimate is in doubt. */
static void watch_again(solver_t *s)
{
    const int32_t restarts = s->watch.restarts;
    (void)memset(&s->watch, 0, sizeof s->watch);
    s->watch.restarts = restarts + (restarts < MOST_RESTARTS);
    s->watch.trial = TRIAL_SAMPLES;
}

/* Restarts the filter at node k with the measurements y: at x or, if that has not helped, at the declared initial
 * state, with the declared covariance or a larger one that explains them. */
static void renew_filter(solver_t *s, int k, const real_t *x, const real_t *y, filter_t *f)
{
    real_t told[NM], H[NM][NX] = {{R(0)}}, wide = R(1);
    restart_filter(f);
    (void)memcpy(f->mean, (s->watch.restarts & 1) ? initial_state : x, sizeof f->mean);
    (void)memcpy(s->x[k], f->mean, sizeof s->x[k]);
    watch_again(s);
    put_measurements(s, k, y);
    MEASUREMENT(s->x[k], PARAM(s, k), told, H);
    for (int m = 0; m < NM; m++) {
        if (s->p[k][AT_ACCURACY + m] > R(0)) {
            enlarge(&wide, (s->p[k][AT_Y + m] - told[m]) / expected_deviation(f, H[m], R(1) / accuracy[m]));
        }
    }
    wide = (wide < FACTOR_INNOVATION_WIDEST) ? wide : FACTOR_INNOVATION_WIDEST;
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            f->L[i][j] *= wide;
        }
    }
}

/* Returns NOT_CONVERGED instead of OK while the estimate is in doubt. */
static status_t judge_innovation(const solver_t *s, status_t status)
{
    const watch_t *w = &s->watch;
    return (status == OK && (w->doubted > EXPECTED_OUTLIERS || w->trial > 0)) ? NOT_CONVERGED : status;
}
