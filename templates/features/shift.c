/* The plan moves before it is prepared again. */

static void shift_before_prepare(solver_t *s)
{
    if (s->samples > 0 && !s->prepared) {
        API(shift)(s);
        if (s->failing >= TWICE) { /* states that the shift integrates may be as far off as the failed plan */
            start_at_measured(s);
        }
    }
}
