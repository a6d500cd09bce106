/* If no working set is found, this part makes a second attempt. */

/* Restarts from the empty working set. Returns OK; ITERATION_LIMIT if no working set is found, whether or not one
 * exists; NUMERICAL_FAILURE. */
static status_t qp_fall_back(solver_t *s)
{
    qp_start_empty(s);
    const status_t status = qp_settle(s, QP_MAX_ITERATIONS);
    return status == STALLED ? ITERATION_LIMIT : status;
}
