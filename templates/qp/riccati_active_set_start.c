/* This part runs the recursion for the first working set of the iterations, and computes the scales of rows. */

/* Passes the working set, corrected for the present bounds, to the recursion and marks all factors and vectors as
 * stale. */
static void qp_enter(solver_t *s)
{
    qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    (void)memset(r->diagonal, 0, sizeof r->diagonal);
    (void)memset(r->diagonal_free, 0, sizeof r->diagonal_free);
    r->regularize = 1;
    r->regularize_zero = riccati_least_pivot(s);
    for (int c = 0; c < NV; c++) {
        q->side[c] = qp_admissible_side(q, c, q->side[c]);
        r->fixed[c] = q->side[c] != INACTIVE;
    }
    for (int m = 0; m < NG; m++) {
        q->side[NV + m] = qp_allowed_row(q, m, q->side[NV + m]);
        r->weight[m] = qp_weight(s, m, q->side[NV + m]);
    }
    q->stale = N;
    q->stale_vectors = N;
    s->schur.swept = 0;
}

/* Gives weights to the rows of the working set, which were equations, in this QP and some of the next ones. */
static void qp_dissolve(solver_t *s)
{
    s->schur.active = 0;
    s->schur.weighted = WEIGHTED_QPS;
    qp_enter(s);
}

/* Sets the units of the rows, in which a move by one costs at least root^2 / 2. The weight of a member is root^2 /
 * sqrt(machine epsilon): one correction then removes the error of the weighting, and the rounding error due to the
 * weight is no larger than that. */
static void qp_set_units(solver_t *s)
{
    qp_t *q = &s->qp;
    for (int m = 0; m < NG; m++) {
        const real_t reach = s->units.reach[NV + m];
        q->root[m] = (reach > R(0) && isfinite(reach)) ? R(1) / reach : R(1);
        q->weight[m] = q->root[m] * q->root[m] / SQRT(TOL_UNIT);
        q->raised[m] = 0;
    }
    q->scaled = SCALES_OWN;
}

/* Computes the scales of the rows, from the recursion without members. */
static void qp_scale_rows(solver_t *s)
{
    riccati_t *r = &s->riccati;
    qp_enter(s);
    (void)memset(r->fixed, 0, sizeof r->fixed);
    (void)memset(r->weight, 0, sizeof r->weight);
    if (riccati_factorize(s, N)) {
        riccati_set_reach(s);
        qp_set_units(s);
    }
}

/* Starts from the empty working set with the scales of this QP. */
static void qp_start_empty(solver_t *s)
{
    (void)memset(s->qp.side, 0, sizeof s->qp.side);
    (void)memset(s->qp.mult, 0, sizeof s->qp.mult);
    if (NG) {
        s->schur.active = 0;
        qp_scale_rows(s);
    }
    qp_enter(s);
}
