/* Contract of this part: what is done when no working set is found: a second attempt. */

/* From the empty working set, with units of this QP. OK; ITERATION_LIMIT: no working set is found, be it that there is none;
 * NUMERICAL_FAILURE. */
static status_t qp_fall_back(solver_t *s)
{
    qp_t *q = &s->qp;
    status_t status;
    memset(q->side, 0, sizeof q->side);
    memset(q->mult, 0, sizeof q->mult);
#if NG
    qp_scale_rows(s);
#endif
    qp_enter(s);
    status = qp_iterate(s, QP_MAX_ITERATIONS);
    return status == STALLED ? ITERATION_LIMIT : status;
}
