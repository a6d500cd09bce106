static int plan_is_finite(const solver_t *s)
{
    return all_finite(s->x[0], (N + 1) * NX) && all_finite(s->u[0], N * NU);
}

/* Prevents a failure from repeating itself. A single failure may come from its sample alone: the plan is kept, and only
 * the working set is discarded if the QP solver did not converge. After the second failure in a row all states of the
 * plan restart at the measured state with the controls of the plan. Nothing of the plan is kept if there is no finite
 * linearisation at it (broken), after the third failure in a row, or after a failure among the first PATIENCE successes
 * after a restart. A plan that is not finite is given up at the first failure. */
static void recover(solver_t *s, status_t status, int broken)
{
    if (status == OK || status == RELAXED) {
        s->failing = (s->failing >= TWICE) ? -PATIENCE : (s->failing < FINE) ? s->failing + 1 : FINE;
    } else if (status != NOT_FINITE && status != NOT_PREPARED) {
        s->failing = (s->failing < FINE) ? FOR_GOOD : s->failing + (s->failing < FOR_GOOD);
        if ((s->failing == TWICE && broken) || !plan_is_finite(s)) {
            s->failing = FOR_GOOD;
        }
        if (s->failing == FOR_GOOD) {
            forget_plan(s);
        }
        if (HAS_QP) {
            if (s->failing >= TWICE) {
                start_at_measured(s);
            } else if (status == ITERATION_LIMIT || status == STALLED) {
                condense_init(s);
            }
        } else {
            if (s->failing >= TWICE) {
                start_at_measured(s);
            }
        }
    }
}
