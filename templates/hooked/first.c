/* Feedback in two parts: the control by a law, then the QP. */

/* States of first.call: no measured state; feedback_first() has used the control law; it has run the whole feedback. */
enum { FIRST_NONE, FIRST_BY_LAW, FIRST_WHOLE };

/* Preparation: the law u_0 = u_0 of the plan + feed + gain (xhat - x_0) of the minimiser on the predicted working
 * set. */
static status_t first_after_prepare(solver_t *s, status_t status)
{
    s->first.call = FIRST_NONE;
    s->first.valid = condense_law(s) && all_finite(s->first.gain[0], NU * NX) && all_finite(s->first.feed, NU);
    if (s->levels.last != LEVEL_A) { /* later levels leave the vectors of the law to the QP solver */
        s->first.valid = 0;
    }
    return status;
}

/* The plan is not that of a sample any more. */
static void first_before_solve(solver_t *s)
{
    s->first.call = FIRST_NONE;
}

/* Returns 1 if the law belongs to the present data. References that have changed since prepare change it. */
static inline int first_is_current(const solver_t *s)
{
    if (SET_REFERENCE && s->renewal == REFERENCE_CHANGED) {
        return 0;
    }
    return s->prepared && s->status == (int32_t)OK && s->first.valid;
}

/* First part of the feedback phase: u0 by the law, clipped. Where there is no law, the whole feedback phase. */
status_t API(feedback_first)(solver_t *s, const real_t xhat[NXHAT], real_t u0[NU])
{
    status_t status = OK;
    if (s->magic == MAGIC && first_is_current(s) && take_state(s, xhat)) {
        for (int j = 0; j < NU; j++) {
            real_t u = s->u[0][j] + s->first.feed[j];
            for (int i = 0; i < NX; i++) {
                u += s->first.gain[j][i] * (s->xhat[i] - s->x[0][i]);
            }
            u0[j] = clip(u, control_lower(s, 0, j), control_upper(s, 0, j));
        }
        if (all_finite(u0, NU)) {
            if (PULLED_ROWS) {
                pull_control_back(s, u0);
            }
            (void)memcpy(s->first.control, u0, sizeof s->first.control);
            s->first.call = FIRST_BY_LAW;
            return OK;
        }
    }
    status = API(feedback)(s, xhat, u0);
    if (status != NOT_INITIALIZED) {
        (void)memcpy(s->first.control, u0, sizeof s->first.control);
        s->first.call = FIRST_WHOLE;
        s->first.status = (int32_t)status;
        s->stats.first_deviation = R(0);
    }
    return status;
}

/* Second part: the QP, the step of the plan, and by how much its control differs from that of the first part. Without a
 * first part it changes nothing. */
status_t API(feedback_finish)(solver_t *s)
{
    real_t xhat[NX], u0[NU];
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    const int32_t call = s->first.call;
    s->first.call = FIRST_NONE;
    if (call != FIRST_BY_LAW) {
        return (call == FIRST_WHOLE) ? (status_t)s->first.status : NOT_PREPARED;
    }
    (void)memcpy(xhat, s->xhat, sizeof xhat);
    status = API(feedback)(s, xhat, u0);
    s->stats.first_deviation = R(0);
    for (int j = 0; j < NU; j++) {
        enlarge(&s->stats.first_deviation, u0[j] - s->first.control[j]);
    }
    if (PREVIOUS) {
        (void)memcpy(s->previous, s->first.control, sizeof s->previous);
    }
    return status;
}
