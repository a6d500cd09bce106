/* A plan that no sample has changed is prepared at the measured state. */

static void first_sample_before_sample(solver_t *s, const real_t *xhat)
{
    if (s->magic == MAGIC && s->samples == 0 && !s->prepared && take_state(s, xhat)) {
        if (!HAS_QP && is_untouched(s)) {
            start_at_measured(s);
        }
        (void)memcpy(s->x[0], s->xhat, sizeof s->xhat);
    }
}
