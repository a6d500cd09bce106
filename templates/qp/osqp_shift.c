/* No working set to predict. */
static void qp_shift_working_set(qp_t *q, int n, const int *source)
{
    (void)q;
    (void)n;
    (void)source;
}
