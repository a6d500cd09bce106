/* Reports the row that makes a QP infeasible. */

static status_t violation_after_qp(solver_t *s, status_t status)
{
    if (status == INFEASIBLE) {
        name_violation(s);
    }
    return status;
}
