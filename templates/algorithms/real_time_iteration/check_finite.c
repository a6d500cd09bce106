/* Returns 1 if the plan may take the step of the QP. */
static int step_holds(const solver_t *s, status_t status)
{
    return step_is_finite(s);
}
