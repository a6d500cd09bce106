/* The plan is linearised as it is. */

static status_t plain_prepare_plan(solver_t *s)
{
    const status_t status = prepare_here(s);
    measure_residual(s);
    return status;
}
