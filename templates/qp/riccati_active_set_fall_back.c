/* Contract of this part: what is done when no working set is found: the interior point method, then the working set that its
 * complementarity names. */

/* The solution of the interior point method goes to its own scratch. */
static void qp_put_aside(solver_t *s)
{
    const qp_t *q = &s->qp;
    for (int k = 0; k <= NS; k++) {
        memcpy(s->ipm.gradient[k], q->x[k], sizeof q->x[k]);
    }
    memcpy(s->ipm.dv, q->z, sizeof q->z);
    memcpy(s->ipm.force, q->mult, sizeof q->mult);
}

/* It comes back, and the sides that belong to it. */
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

/* From the empty working set; where this fails, the interior point method and then the set that it names. */
static status_t qp_fall_back(solver_t *s)
{
    qp_t *q = &s->qp;
    qp_start_empty(s);
    if (qp_iterate(s, QP_MAX_ITERATIONS) == OK) {
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
    if (qp_iterate(s, QP_MAX_POLISH) == OK) {
        return OK;
    }
    qp_take_back(s);
    return status;
}
