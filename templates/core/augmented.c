/* Sets the added states in x_0. Added states follow the measured ones, from index NXHAT on, and depend on the previous
 * node and the grid only; the struct names them. Their maps are exact, so that a plan has no gaps in them. */
static void take_augmented(const solver_t *s, real_t *x)
{
    if (TIMED) {
        x[NXHAT] = s->time;
    }
    for (int i = 0; i < NMEM; i++) {
        x[NX - NMEM + i] = s->previous[remembered[i]];
    }
}

/* Sets the added states to their values in x_0 of the last sample. */
static inline void recall_augmented(const solver_t *s, real_t *x)
{
#if NODES
    const real_t *known = s->xhat;
#else
    const real_t *known = s->x[0];
#endif
    for (int i = NXHAT; i < NX; i++) {
        x[i] = known[i];
    }
}

/* Sets the added states at all nodes of the plan. */
static void follow_augmented(solver_t *s)
{
    take_augmented(s, s->x[0]);
    for (int k = 1; k < N; k++) {
        for (int i = 0; i < NHELD; i++) {
            if (!block_start[k * NHELD + i]) { /* a control that begins no block has the value of the previous node */
                s->u[k][held_control[i]] = s->u[k - 1][held_control[i]];
            }
        }
    }
    for (int k = 0; k < N; k++) {
        if (TIMED) {
            s->x[k + 1][NXHAT] = s->time + node_time[k + 1];
        }
        for (int i = 0; i < NMEM; i++) {
            s->x[k + 1][NX - NMEM + i] = s->u[k][remembered[i]];
        }
    }
}

/* Resets the added states. The first sample is at time 0, and its previous control is the first control of the plan. */
static void reset_augmented(solver_t *s)
{
    if (PREVIOUS) {
        (void)memcpy(s->previous, s->u[0], sizeof s->previous);
    }
    if (TIMED) {
        s->time = R(0);
        s->time_rest = R(0);
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NDATA; i++) {
            s->p[k][NP - NDATA + i] = node_data[k * NDATA + i];
        }
    }
    follow_augmented(s);
}

/* Saves what the next sample needs: the control, and the time with its rounding error. */
static void keep_sample(solver_t *s, const real_t *u0)
{
    if (PREVIOUS) {
        (void)memcpy(s->previous, u0, sizeof s->previous);
    }
    if (TIMED) {
        const real_t step = sampling_time[0] - s->time_rest, time = s->time + step;
        s->time_rest = (time - s->time) - step;
        s->time = time;
    }
}

#if PREVIOUS
status_t API(set_previous)(solver_t *s, const real_t u[NU])
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!all_finite(u, NU)) {
        return BAD_ARGUMENT;
    }
    (void)memcpy(s->previous, u, sizeof s->previous);
    return OK;
}
#endif

#if TIMED
status_t API(set_time)(solver_t *s, real_t time)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!isfinite(time)) {
        return BAD_ARGUMENT;
    }
    s->time = time;
    s->time_rest = R(0);
    return OK;
}
#endif
