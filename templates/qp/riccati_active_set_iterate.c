/* Contract of this part: from a working set to the next, all changes at once (primal-dual active set). */

/* What is taken as rounding: as long as the minimiser is not refined, errors of the root of the precision too. */
static inline real_t qp_tolerance(const qp_t *q, real_t exact)
{
    const real_t rough = R(16) * SQRT(TOL_UNIT);
    return q->rough ? rough : exact;
}

/* The side that bounds say: v is the value of what is no member. */
static inline int qp_side_of_value(const qp_t *q, int c, real_t v, real_t size)
{
    const real_t tolerance = qp_tolerance(q, TOL_RICCATI_FEASIBILITY);
    if (v - q->upper[c] > tolerance * (size + FABS(q->upper[c]))) {
        return 1;
    }
    return (q->lower[c] - v > tolerance * (size + FABS(q->lower[c]))) ? -1 : 0;
}

/* The side of control c. A member leaves if its multiplier has the wrong sign by more than rounding. */
static int qp_side_of_control(const solver_t *s, int c)
{
    const qp_t *q = &s->qp;
    const riccati_t *r = &s->riccati;
    const int side = q->side[c], k = c / NUS, j = c % NUS;
    real_t mult, size;
    if (side == 0) {
        return qp_side_of_value(q, c, q->z[c], q->scale[NXS + j]);
    }
    if (q->lower[c] >= q->upper[c]) {
        return side;
    }
    mult = side > 0 ? q->mult[c] : -q->mult[c];
    size = q->size[NXS + j];
    if (!q->refined) {
        size = r->M[k][j][NXS + j] * q->scale[NXS + j] + FABS(r->h[k][j]);
    }
    return mult >= -TOL_RICCATI_SIGN * size ? side : 0;
}

#if NG
/* The side of row m: members leave by the sign of their multiplier, soft ones become violated at the limit of it, and
 * violated ones come back when they are not. */
static int qp_side_of_row(const solver_t *s, int m)
{
    const qp_t *q = &s->qp;
    const int c = NV + m, side = q->side[c], sign = side > 0 ? 1 : -1;
    const real_t size = qp_row_size(s, m), mult = side > 0 ? q->mult[c] : -q->mult[c];
    const real_t terms = q->root[m] * q->largest < q->largest_mult ? q->root[m] * q->largest : q->largest_mult;
    const real_t stiff = q->refined ? R(0) : q->root[m] * q->root[m] * size;
    const real_t rounding = qp_tolerance(q, TOL_RICCATI_SIGN) * (terms + stiff);
    if (side == 0) {
        return qp_side_of_value(q, c, q->value[m], size);
    }
    if (side != sign) {
        const real_t violation = side > 0 ? q->value[m] - q->upper[c] : q->lower[c] - q->value[m];
        return violation >= -qp_tolerance(q, TOL_RICCATI_FEASIBILITY) * (size + FABS(q->target[c])) ? side : sign;
    }
    if (mult > q->penalty[m] + rounding) {
        return 2 * sign;
    }
    if (mult >= -rounding) {
        return side;
    }
    if (q->lower[c] < q->upper[c]) {
        return 0;
    }
    return -mult > q->penalty[m] + rounding ? -2 * sign : side;
}

#endif
#if NG
/* Violation of row m, which is no member, relative to what its value sums and its bound. */
static real_t qp_violation(const solver_t *s, int m)
{
    const qp_t *q = &s->qp;
    const int c = NV + m;
    const real_t over = q->value[m] - q->upper[c], under = q->lower[c] - q->value[m];
    const real_t bound = FABS(over > under ? q->upper[c] : q->lower[c]);
    return (over > under ? over : under) / (qp_row_size(s, m) + bound);
}

#endif
/* Every side anew; returns the number of changes. Of the rows only the most violated ones enter: when one of them is met its
 * neighbours in time are too, as a rule, and more members than controls contradict each other. */
static int qp_revise(solver_t *s)
{
    qp_t *q = &s->qp;
    const int before = q->changes;
    int c;
#if NG
    real_t worst = R(0);
    q->largest = q->largest_mult = R(0);
    for (int m = 0; m < NG; m++) {
        const real_t force = FABS(q->mult[NV + m]);
        q->largest_mult = force > q->largest_mult ? force : q->largest_mult;
        q->largest = force > q->largest * q->root[m] ? force / q->root[m] : q->largest;
        if (q->side[NV + m] == 0) {
            const real_t violation = qp_violation(s, m);
            worst = violation > worst ? violation : worst;
        }
    }
    for (int m = 0; m < NG; m++) {
        c = NV + m;
        if (q->side[c] != 0 || qp_violation(s, m) >= R(0.5) * worst) {
            qp_set_row(s, m, qp_allowed(q, c, qp_side_of_row(s, m), q->penalty[m]));
        }
    }
#endif
    for (c = 0; c < NV; c++) {
        qp_set_control(s, c, qp_side_of_control(s, c));
    }
    return q->changes - before;
}

/* 1 if the working set is among the first `tried` of this solve; remembers it. */
static int qp_seen(qp_t *q, int tried)
{
    uint32_t hash = 2166136261u;
    int c, i;
    for (c = 0; c < NV + NG; c++) {
        hash = (hash ^ (uint32_t)(q->side[c] + 2)) * 16777619u;
    }
    q->history[tried] = (int32_t)(hash >> 1);
    for (i = 0; i < tried; i++) {
        if (q->history[i] == q->history[tried]) {
            return 1;
        }
    }
    return 0;
}

/* Recursion and vectors, as far as they are out of date. */
static int qp_renew(solver_t *s)
{
    qp_t *q = &s->qp;
    if (q->stale >= 0 && !riccati_factorize(s, q->stale)) {
        return 0;
    }
    if (q->stale_vectors >= 0) {
        qp_load(s);
        riccati_backward(s, q->stale_vectors);
    }
    q->stale = q->stale_vectors = -1;
    return 1;
}

#if NG
/* Members that are still off their bounds get a larger weight; 0 if none can. */
static int qp_raise_weights(solver_t *s)
{
    qp_t *q = &s->qp;
    int m, raised = 0;
    for (m = 0; m < NG; m++) {
        const int c = NV + m;
        const real_t size = qp_row_size(s, m) + FABS(q->target[c]);
        if ((q->side[c] == 1 || q->side[c] == -1) && q->raised[m] < 2 &&
            FABS(q->value[m] - q->target[c]) > TOL_RICCATI_FEASIBILITY * size) {
            q->raised[m]++;
            q->weight[m] *= R(1024);
            s->riccati.weight[m] = q->weight[m];
            qp_outdate(q, stage_of_row[m]);
            raised = 1;
        }
    }
    return raised;
}

#endif
/* The minimiser on the working set, refined if nothing but rounding is to be gained otherwise. changed: sides that it changes. */
static status_t qp_minimize(solver_t *s, int *changed)
{
    qp_t *q = &s->qp;
    status_t status = OK;
    *changed = 0;
    if (!qp_renew(s)) {
        return NUMERICAL_FAILURE;
    }
    memcpy(q->x[0], s->step.dx[0], sizeof s->step.dx[0]);
    riccati_forward(s, q->x, q->z);
    if (!qp_measure(q) || !qp_take_multipliers(s)) {
        return NUMERICAL_FAILURE;
    }
    q->refined = 0;
    q->rough = qp_is_approximate(s);
    *changed = qp_revise(s);
    if (*changed == 0 && q->rough) {
        status = qp_refine(s);
        q->rough = 0;
        if (status == OK || status == STALLED) {
            *changed = qp_revise(s);
        }
    }
    return status;
}

/* Working sets until one repeats itself. OK; STALLED: a set came back, or the members of one contradict each other;
 * ITERATION_LIMIT; NUMERICAL_FAILURE. */
static status_t qp_iterate(solver_t *s, int most)
{
    int changed, tried;
    (void)qp_seen(&s->qp, 0);
    for (tried = 1; tried <= most; tried++) {
        const status_t status = qp_minimize(s, &changed);
        if (status == NUMERICAL_FAILURE || (status == OK && changed == 0)) {
            return status;
        }
#if NG
        if (changed == 0 && qp_raise_weights(s)) {
            s->qp.iterations++;
            continue;
        }
#endif
        if (changed == 0) {
            return s->qp.residual <= TOL_RICCATI_ROUNDING ? OK : STALLED;
        }
        if (changed > 0 && qp_seen(&s->qp, tried)) {
            return STALLED;
        }
        s->qp.iterations++;
    }
    return ITERATION_LIMIT;
}

/* Controls inside of their bounds exactly, multipliers of the right sign, soft rows that are violated. */
static void qp_finish(qp_t *q)
{
    int c;
    for (c = 0; c < NV; c++) {
        q->z[c] = q->z[c] < q->lower[c] ? q->lower[c] : q->z[c] > q->upper[c] ? q->upper[c] : q->z[c];
    }
    q->relaxed = 0;
    for (c = 0; c < NV + NG; c++) {
        const int wrong = q->side[c] == 0 || (q->side[c] > 0 ? q->mult[c] < R(0) : q->mult[c] > R(0));
        if (wrong && q->lower[c] < q->upper[c]) {
            q->mult[c] = R(0);
        }
        q->relaxed += q->side[c] > 1 || q->side[c] < -1;
    }
}
