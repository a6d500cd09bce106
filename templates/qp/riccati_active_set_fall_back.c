/* Contract of this part: units of the rows, and what is done when no working set is found: the interior point method, then the
 * working set that its complementarity names. */

/* The recursion gets the working set, bounds as they are now; everything is out of date. */
static void qp_enter(solver_t *s)
{
    qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    int c, m;
    memset(r->diagonal, 0, sizeof r->diagonal);
    r->regularize = 1;
    r->regularize_zero = ipm_least_pivot(s);
    for (c = 0; c < NV; c++) {
        q->side[c] = qp_allowed(q, c, q->side[c], (real_t)INFINITY);
        r->fixed[c] = q->side[c] != 0;
    }
    for (m = 0; m < NG; m++) {
        c = NV + m;
        q->side[c] = qp_allowed(q, c, q->side[c], q->penalty[m]);
        r->weight[m] = qp_weight(q, m, q->side[c]);
    }
    q->stale = q->stale_vectors = NS;
}

/* The cost of moving a row by one is root^2 / 2 or more; as a member it gets a weight that is larger by the root of the precision:
 * one correction makes up for its share in the Hessian, and the rounding that it causes is no larger. */
static void qp_set_units(solver_t *s)
{
    qp_t *q = &s->qp;
    int m;
    for (m = 0; m < NG; m++) {
        const real_t reach = s->ipm.reach[NV + m];
        q->root[m] = (reach > R(0) && isfinite(reach)) ? R(1) / reach : R(1);
        q->weight[m] = q->root[m] * q->root[m] / SQRT(TOL_UNIT);
        q->raised[m] = 0;
    }
    q->scaled = 1;
}

/* Units of the rows, from the recursion without members. */
static void qp_scale_rows(solver_t *s)
{
    riccati_t *r = &s->riccati;
    qp_enter(s);
    memset(r->fixed, 0, sizeof r->fixed);
    memset(r->weight, 0, sizeof r->weight);
    if (NG > 0 && riccati_factorize(s, NS)) {
        ipm_set_reach(s);
        qp_set_units(s);
    }
}

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
    qp_scale_rows(s);
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
    qp_set_units(s);
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
