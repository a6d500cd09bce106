/* Nonlinear hard rows: violations that the step leaves. */

static void bent_rows_on_success(solver_t *s, status_t status)
{
    s->row_residual = row_residual(s, R(1));
}

/* Halves the remembered values of rows in every sample, down to the scale of their terms. */
static status_t bent_rows_after_feedback(solver_t *s, status_t status)
{
    if (status == OK) {
        enlarge(&s->stats.residual, s->row_residual);
    }
    for (int r = 0; r < NR; r++) {
        s->row_scale[r] *= (s->row_scale[r] > row_magnitude[r]) ? R(0.5) : R(1);
    }
    return status;
}
