/* References that change between the phases act in the feedback. */

/* Recomputes the gradients after references have changed since prepare; the rest of the linearisation remains valid. */
static void renew_gradients(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        PATH_GRADIENT(s, k, s->node[k].g);
    }
    if (HAS_PATH_GRADIENT && HAS_START_GRADIENT) {
        add_start_gradient(s, s->node[0].g);
    }
    TERMINAL_GRADIENT(s, s->terminal.g);
    condense_gradient(s);
    s->renewal = UP_TO_DATE;
}

/* Applies references that have changed before a weight or parameter changes, with the old weights and parameters. */
static void hold_gradients(solver_t *s)
{
    if (s->prepared && s->renewal == REFERENCE_CHANGED) {
        renew_gradients(s);
    }
    s->renewal = HELD;
}

static void references_before_qp(solver_t *s)
{
    if (s->renewal == REFERENCE_CHANGED) {
        renew_gradients(s);
    }
}
