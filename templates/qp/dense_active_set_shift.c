/* Prepares the warm start of a shifted problem: control i takes the predicted side of control i + n; the last n
 * controls keep theirs. */
static void qp_shift_controls(qp_t *q, int n)
{
    for (int i = 0; i + n < NVU; ++i) {
        q->side[i] = q->side[i + n];
    }
}

/* Moves the predicted side of row source[j] >= j to general row j. */
static void qp_shift_rows(qp_t *q, const int *source)
{
    for (int j = 0; j < NG; ++j) {
        q->side[NV + j] = q->side[NV + source[j]];
    }
}
