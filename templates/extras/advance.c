/* Iterations at the predicted state, until the QP has no solution. */

static status_t advance_after_prepare(solver_t *s, status_t status)
{
    for (int n = 0; n < ADVANCE && status == OK && step_at_plan(s) == OK; n++) {
        status = evaluate(s, ADVANCE_LEVEL);
    }
    return status;
}
