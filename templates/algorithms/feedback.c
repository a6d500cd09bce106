status_t API(feedback)(solver_t *s, const real_t xhat[NX], real_t u0[NU])
{
    status_t status;
    int measured, broken;
    if (s->magic != MAGIC) {
        for (int j = 0; j < NU; j++) { /* not by memcpy, see fill_copies() */
            u0[j] = default_control[j];
        }
        return NOT_INITIALIZED;
    }
    measured = take_state(s, xhat);
    broken = s->prepared && s->status != OK;
#if HAS_QP
    forget_violation(s);
#endif
    if (!s->prepared) {
        status = NOT_PREPARED;
    } else if (!measured) {
        status = NOT_FINITE;
    } else if (broken) {
        status = (status_t)s->status;
    } else {
        status = feedback_here(s);
    }
#if !HAS_QP
    if (s->prepared && status != OK) {
        restore_multipliers(s);
        if (!all_finite(s->lam[0], (N + 1) * NX)) {
            forget_multipliers(s);
        }
    }
#endif
    s->prepared = 0;
#if SHIFT || REPAIR
    s->samples += (s->samples < MANY);
#endif
    safe_control(s, u0);
    recover(s, status, broken);
    return finish(s, judge(s, status));
}

#if REPAIR
/* A plan that no sample has changed is prepared, and so repaired, at the measured state. */
static void start_first_sample(solver_t *s, const real_t *xhat)
{
    if (s->magic == MAGIC && s->samples == 0 && !s->prepared && take_state(s, xhat)) {
#if !HAS_QP
        if (is_untouched(s)) {
            start_at_measured(s);
        }
#endif
        memcpy(s->x[0], s->xhat, sizeof s->xhat);
    }
}

#endif
/* If prepare fails, feedback returns its status. */
status_t API(step)(solver_t *s, const real_t xhat[NX], real_t u0[NU])
{
#if REPAIR
    start_first_sample(s, xhat);
#endif
    API(prepare)(s);
    return API(feedback)(s, xhat, u0);
}
