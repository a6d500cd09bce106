/* Contract of this part: what is done when no working set is found: the interior point method, then the working set that its
 * complementarity names. */

/* The solution of the interior point method goes to its own scratch, or comes back. */
static void qp_exchange(solver_t *s, int back)
{
    qp_t *q = &s->qp;
    ipm_t *ipm = &s->ipm;
    memcpy(back ? q->x : ipm->dx, back ? ipm->dx : q->x, sizeof q->x);
    memcpy(back ? q->z : ipm->du, back ? ipm->du : q->z, sizeof q->z);
    memcpy(back ? q->mult : ipm->force, back ? ipm->force : q->mult, sizeof q->mult);
}

/* From the empty working set, with units of this QP; where this fails, the interior point method and then the set that it names. */
static status_t qp_fall_back(solver_t *s)
{
    qp_t *q = &s->qp;
    status_t status;
    int before;
    memset(q->side, 0, sizeof q->side);
    memset(q->mult, 0, sizeof q->mult);
#if NG
    qp_scale_rows(s);
#endif
    qp_enter(s);
    if (qp_iterate(s, QP_MAX_ITERATIONS) == OK) {
        return OK;
    }
    before = q->iterations;
    s->ipm.ready = 0;
    status = ipm_solve(s);
    q->iterations += before;
    q->stale = q->stale_vectors = NS;
    q->factorized = 2;
    if (status != OK && status != ITERATION_LIMIT) {
        return status;
    }
#if NG
    qp_set_units(s);
#endif
    qp_exchange(s, 0);
    qp_enter(s);
    if (qp_iterate(s, QP_MAX_POLISH) == OK) {
        return OK;
    }
    qp_exchange(s, 1);
    ipm_write_sides(s);
    q->exact = 0;
    return status;
}
