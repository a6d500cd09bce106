/* Prepares the warm start of a shifted problem: control c takes the predicted side of control c + n; the last n
 * controls keep theirs. */
static void qp_shift_controls(solver_t *s, int n)
{
    qp_t *q = &s->qp;
    for (int c = 0; c + n < NV; c++) {
        q->side[c] = q->side[c + n];
        q->mult[c] = q->mult[c + n];
    }
}

/* Moves the predicted side of row source[m] >= m to row m. */
static void qp_shift_rows(solver_t *s, const int *source)
{
    qp_t *q = &s->qp;
    for (int m = 0; m < NG; m++) {
        q->side[NV + m] = q->side[NV + source[m]];
        q->mult[NV + m] = q->mult[NV + source[m]];
    }
}
