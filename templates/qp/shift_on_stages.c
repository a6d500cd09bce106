/* Warm start of a shifted problem: the side of control c + n becomes the prediction for control c, the last n keep theirs; row m
 * takes that of row source[m] >= m, or none if source[m] < 0. */
static void qp_shift_working_set(solver_t *s, int n, const int *source)
{
    qp_t *q = &s->qp;
    int c, m;
    for (c = 0; c + n < NV; c++) {
        q->side[c] = q->side[c + n];
        q->mult[c] = q->mult[c + n];
    }
    for (m = 0; m < NG; m++) {
        const int from = NV + source[m];
        q->side[NV + m] = source[m] < 0 ? 0 : q->side[from];
        q->mult[NV + m] = source[m] < 0 ? R(0) : q->mult[from];
    }
}
