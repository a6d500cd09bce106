/* If no working set is found, this part calls the interior point method, and then starts the iterations from the
 * working set that its complementarity indicates. */

/* Saves the solution of the interior point method in work arrays of that method. */
static void qp_put_aside(solver_t *s)
{
    const qp_t *q = &s->qp;
    for (int k = 0; k <= N; k++) {
        (void)memcpy(s->ipm.gradient[k], q->x[k], sizeof q->x[k]);
    }
    (void)memcpy(s->ipm.dv, q->z, sizeof q->z);
    (void)memcpy(s->ipm.force, q->mult, sizeof q->mult);
}

/* Restores this solution and sets the sides that belong to it. */
static void qp_take_back(solver_t *s)
{
    qp_t *q = &s->qp;
    for (int k = 0; k <= N; k++) {
        (void)memcpy(q->x[k], s->ipm.gradient[k], sizeof q->x[k]);
    }
    (void)memcpy(q->z, s->ipm.dv, sizeof q->z);
    (void)memcpy(q->mult, s->ipm.force, sizeof q->mult);
    ipm_write_sides(s);
    q->exact = 0;
}

/* Iterates from the working set that the interior point iterate indicates. If that fails, the interior point iterate is
 * the result. */
static status_t qp_polish(solver_t *s)
{
    status_t status;
    qp_put_aside(s);
    qp_enter(s);
    status = qp_settle(s, QP_MAX_POLISH);
    if (status != OK) {
        qp_take_back(s);
    }
    return status;
}

/* Runs the interior point method, which ends as soon as it indicates a working set, and continues if this set is not
 * the one of the solution. The scales of the rows become those of this QP. */
static status_t qp_cross_over(solver_t *s)
{
    status_t status;
    s->ipm.ready = 0;
    s->ipm.crossing = CROSS_OVER;
    status = ipm_solve(s);
    qp_set_units(s);
    if (s->ipm.crossing == HANDED_OVER) {
        s->ipm.crossing = TO_THE_END;
        if (qp_polish(s) == OK) {
            return OK;
        }
        status = ipm_resume(s);
    }
    s->ipm.crossing = TO_THE_END;
    if (status == OK || status == ITERATION_LIMIT) {
        status = (qp_polish(s) == OK || ipm_is_solution(s)) ? OK : ITERATION_LIMIT;
    }
    return status;
}

/* Runs the interior point method; if it finds neither a solution nor a contradiction, iterates from the empty working
 * set. */
static status_t qp_fall_back(solver_t *s)
{
    qp_t *q = &s->qp;
    const int before = q->iterations;
    status_t status;
    s->schur.active = 0;
    status = qp_cross_over(s);
    q->iterations += before;
    if (status != OK && status != INFEASIBLE) {
        qp_start_empty(s);
        status = (qp_settle(s, QP_MAX_ITERATIONS) == OK) ? OK : status;
    }
    q->factorized = FACTORS_OTHER;
    return status;
}
