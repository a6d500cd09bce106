/* Warm start of a shifted problem: the side of control i + n becomes the prediction for control i, the last n keep theirs. */
static void qp_shift_controls(qp_t *q, int n)
{
    for (int i = 0; i + n < NS * NUS; ++i) {
        q->side[i] = q->side[i + n];
    }
}

#if NG
/* General row j takes the prediction of row source[j] >= j, or none if source[j] < 0. */
static void qp_shift_rows(qp_t *q, const int *source)
{
    for (int j = 0; j < NG; ++j) {
        q->side[NV + j] = source[j] < 0 ? 0 : q->side[NV + source[j]];
    }
}
#endif
