/* Contract of this part: what is done when no working set is found: a second attempt. */

/* From the empty working set. OK; ITERATION_LIMIT: no working set is found, be it that there is none; NUMERICAL_FAILURE. */
static status_t qp_fall_back(solver_t *s)
{
    qp_start_empty(s);
    const status_t status = qp_iterate(s, QP_MAX_ITERATIONS);
    return status == STALLED ? ITERATION_LIMIT : status;
}
