/* This part keeps the window of the last N intervals. Node `window` belongs to the present sample; later nodes belong
 * to samples to come and are not used. */

/* Computes information = (L L')^-1 of the arrival cost; directions that only rounding errors determine get no
 * information. */
static void weigh_arrival(solver_t *s)
{
    real_t V[NX][NX] = {{R(0)}};
    for (int i = 0; i < NX; i++) {
        const real_t own = FABS(s->arrival.L[i][i]), sign = (s->arrival.L[i][i] < R(0)) ? -R(1) : R(1);
        const real_t of_state = SQRT(square_sum(s->arrival.L[i], NX)), size = z_scale[i];
        const real_t least = FACTOR_ESTIMATE_KNOWN * TOL_UNIT * ((of_state > size) ? of_state : size);
        const real_t pivot = sign * ((own > least) ? own : least);
        for (int j = 0; j <= i; j++) {
            real_t rest = (i == j) ? R(1) : R(0);
            for (int l = j; l < i; l++) {
                rest -= s->arrival.L[i][l] * V[l][j];
            }
            V[i][j] = rest / pivot;
        }
    }
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            real_t sum = R(0);
            for (int l = (i > j) ? i : j; l < NX; l++) {
                sum += V[l][i] * V[l][j];
            }
            s->information[i][j] = sum;
        }
    }
}

/* Restarts the window at its first node, with the arrival cost as its only data. */
static void restart_window(solver_t *s)
{
    s->window = 0;
    s->samples = 0;
    (void)memcpy(s->known, s->arrival.mean, sizeof s->known);
    start_at(s, s->arrival.mean);
    (void)memcpy(s->xhat, s->x[0], sizeof s->xhat);
    for (int k = 0; k <= N; k++) {
        forget_measurements(s, k);
        forget_controls(s, k);
        put_parameters(s, k);
    }
    begin_watch(s);
    s->expected = s->arrival;
    weigh_arrival(s);
}

/* Clips states with declared bounds to them in the whole window. */
static void clip_window(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        clip_to_bounds(s, s->x[k]);
    }
}

/* Updates the arrival cost with the node that leaves the window. */
static void keep_arrival(solver_t *s)
{
    filter_t *f = &s->arrival;
    update_filter(s, 0, f);
    predict_filter(s, 0, f);
    if (!filter_is_sane(f)) {
        restart_filter(f);
        (void)memcpy(f->mean, s->x[1], sizeof f->mean);
    }
    clip_to_bounds(s, f->mean);
    weigh_arrival(s);
}

/* Starts node k at the end of the interval before it, without noise and without measurements. */
static void begin_node(solver_t *s, int k)
{
    filter_t *f = &s->expected;
    (void)memset(s->u[k - 1], 0, sizeof s->u[k - 1]);
    (void)memcpy(f->mean, s->x[k - 1], sizeof f->mean);
    predict_filter(s, k - 1, f);
    if (!filter_is_sane(f)) {
        restart_filter(f);
        (void)memcpy(f->mean, s->x[k - 1], sizeof f->mean);
    }
    (void)memcpy(s->x[k], f->mean, sizeof s->x[k]);
    (void)memcpy(s->p[k], s->p[k - 1], sizeof s->p[k]);
    forget_measurements(s, k);
}

/* Moves the window to the present sample, which is one interval later. */
static void move_window(solver_t *s)
{
    if (s->window == N) {
        keep_arrival(s);
        shift_by_one(s);
        for (int k = 0; k < N; k++) {
            (void)memcpy(s->p[k], s->p[k + 1], sizeof s->p[k]);
        }
    } else {
        s->window++;
    }
    begin_node(s, s->window);
}

/* Holds the states after the window at the ends of their intervals. */
static void hold_future(solver_t *s)
{
    for (int k = s->window; k < N; k++) {
        (void)memset(s->node[k].S, 0, sizeof s->node[k].S);
        (void)memset(s->node[k].b, 0, sizeof s->node[k].b);
    }
}

/* Returns the largest gap of the window, relative to the size of its state. */
static real_t gap_of_window(const solver_t *s, const real_t *size)
{
    real_t most = R(0);
    for (int k = 0; NONLINEAR_MODEL && k < s->window; k++) {
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            enlarge(&most, (x_next[i] - s->x[k + 1][i]) / size[i]);
        }
    }
    return most;
}

/* Returns the largest change of the present estimate by the last step, relative to the size of its state. */
static real_t change_of_estimate(const solver_t *s, const real_t *size)
{
    real_t most = R(0);
    for (int i = 0; i < NX; i++) {
        enlarge(&most, s->step.dx[s->window][i] / size[i]);
    }
    return most;
}

#if HUBER
/* Reduces the accuracy of measurements that the window does not fit. */
static void weigh_by_window(solver_t *s)
{
    for (int k = 0; k <= s->window; k++) {
        real_t y[NM], H[NM][NX];
        MEASUREMENT(s->x[k], PARAM(s, k), y, H);
        for (int m = 0; m < NM; m++) {
            if (s->p[k][AT_ACCURACY + m] > R(0)) {
                s->p[k][AT_ACCURACY + m] = accuracy_with(m, (s->p[k][AT_Y + m] - y[m]) * accuracy[m]);
            }
        }
    }
}
#endif

/* Restarts the window with the present sample as its only node, described by the arrival cost. */
static void begin_window(solver_t *s)
{
    s->window = 0;
    s->expected = s->arrival;
    weigh_arrival(s);
    start_at(s, s->arrival.mean);
}

/* Moves the data of the present sample to the first node, without its measurements. */
static void keep_present_data(solver_t *s)
{
    if (s->window > 0) {
        (void)memcpy(s->p[0], s->p[s->window], sizeof s->p[0]);
    }
    forget_measurements(s, 0);
}

/* Discards all data after a failure, also the present ones, and restarts the window at the last estimate that was
 * OK. */
static void forget_window(solver_t *s)
{
    keep_present_data(s);
    restart_filter(&s->arrival);
    (void)memcpy(s->arrival.mean, s->known, sizeof s->arrival.mean);
    watch_again(s);
    begin_window(s);
}

/* Discards all data but the present measurements y after the estimate has diverged. */
static void renew_window(solver_t *s, const real_t *y)
{
    keep_present_data(s);
    renew_filter(s, 0, s->x[s->window], y, &s->arrival);
    begin_window(s);
    update_filter(s, 0, &s->expected);
    forget_multipliers(s);
}

/* Replaces a failed plan by the filter, run from the arrival cost along the window. */
static void filter_window(solver_t *s)
{
    filter_t f = s->arrival;
    for (int k = 0; k <= s->window; k++) {
        (void)memcpy(s->x[k], f.mean, sizeof s->x[k]);
        if (HUBER) {
            weigh_by_filter(s, k, &f);
        }
        update_filter(s, k, &f);
        (void)memcpy(s->x[k], f.mean, sizeof s->x[k]);
        if (k < s->window) {
            (void)memset(s->u[k], 0, sizeof s->u[k]);
            predict_filter(s, k, &f);
            clip_to_bounds(s, f.mean);
        }
    }
    clip_window(s);
    if (!filter_is_sane(&f)) {
        forget_window(s);
    }
    forget_multipliers(s);
    condense_init(s);
}
