/* Warm start of a shifted problem: the side of control i + n becomes the prediction for control i, the last n keep theirs;
 * general row j takes that of row source[j] >= j, or none if source[j] < 0. */
static void qp_shift_working_set(qp_t *q, int n, const int *source)
{
    for (int i = 0; i + n < NS * NUS; ++i) {
        q->side[i] = q->side[i + n];
    }
    for (int j = 0; j < NG; ++j) {
        q->side[NV + j] = source[j] < 0 ? 0 : q->side[NV + source[j]];
    }
}
