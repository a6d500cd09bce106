/* What the step left behind of hard rows that are not linear. */

static void bent_rows_on_success(solver_t *s, status_t status)
{
    (void)status;
    s->row_residual = row_residual(s, R(1));
}
