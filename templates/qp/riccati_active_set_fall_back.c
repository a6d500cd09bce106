/* Contract of this part: the fallback if no working set is found: the interior point method, followed by an attempt
 * from the working set that its complementarity indicates. */

/* Saves the solution of the interior point method in work arrays of that method. */
static void qp_put_aside(solver_t *s)
{
    const qp_t *q = &s->qp;
    for (int k = 0; k <= NS; k++) {
        memcpy(s->ipm.gradient[k], q->x[k], sizeof q->x[k]);
    }
    memcpy(s->ipm.dv, q->z, sizeof q->z);
    memcpy(s->ipm.force, q->mult, sizeof q->mult);
}

/* Restores this solution and sets the sides that belong to it. */
static void qp_take_back(solver_t *s)
{
    qp_t *q = &s->qp;
    for (int k = 0; k <= NS; k++) {
        memcpy(q->x[k], s->ipm.gradient[k], sizeof q->x[k]);
    }
    memcpy(q->z, s->ipm.dv, sizeof q->z);
    memcpy(q->mult, s->ipm.force, sizeof q->mult);
    ipm_write_sides(s);
    q->exact = 0;
}

/* Restarts from the empty working set. If this fails, runs the interior point method and restarts from the working set
 * that it indicates. */
static status_t qp_fall_back(solver_t *s)
{
    qp_t *q = &s->qp;
#if BUDGET
    if (!qp_afford(q, COST_RESTART)) {
        return ITERATION_LIMIT;
    }
#endif
    qp_start_empty(s);
    if (qp_settle(s, QP_MAX_ITERATIONS) == OK) {
        return OK;
    }
    const int before = q->iterations;
    s->ipm.ready = 0;
    const status_t status = ipm_solve(s);
    q->iterations += before;
    q->stale = q->stale_vectors = NS;
    q->factorized = FACTORS_OTHER;
    if (status != OK && status != ITERATION_LIMIT) {
        return status;
    }
#if NG
    qp_set_units(s);
#endif
    qp_put_aside(s);
    qp_enter(s);
    if (qp_settle(s, QP_MAX_POLISH) == OK) {
        return OK;
    }
    qp_take_back(s);
    return status;
}
