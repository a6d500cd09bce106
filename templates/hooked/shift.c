/* Shifts the plan before it is prepared again. */

static void shift_before_prepare(solver_t *s)
{
    int moves = s->samples > 0 && !s->prepared;
    if (SOLVE) {
        moves = moves && !s->solved;
        s->solved = 0;
    }
    if (moves) {
        if (SHIFTS_BACK) {
            (void)memcpy(s->first_control, s->u[0], sizeof s->first_control);
        }
        (void)API(shift)(s); /* the shift refuses only a solver that is not initialised */
        if (s->failures >= SECOND_FAILURE) { /* states that the shift integrates may be as wrong as the failed plan */
            start_at_measured(s);
        }
    }
}
