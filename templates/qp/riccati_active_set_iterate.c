/* This part makes the step from one working set to the next, with all changes at once (primal-dual active set). */

/* Returns the tolerance for rounding errors: `exact`, or a multiple of sqrt(machine epsilon) while the minimiser is not
 * refined. */
static inline real_t qp_tolerance(const qp_t *q, real_t exact)
{
    return q->rough ? FACTOR_RICCATI_UNREFINED * SQRT(TOL_UNIT) : exact;
}

/* Returns the side of row c, which is not in the working set: the bound that its value v violates, or INACTIVE. `size`:
 * magnitude of the terms of v, and its scale. */
static inline int qp_side_of_value(const qp_t *q, int c, real_t v, real_t size)
{
    const real_t tolerance = qp_tolerance(q, TOL_RICCATI_FEASIBILITY);
    if (v - q->upper[c] > tolerance * (size + FABS(q->upper[c]))) {
        return AT_UPPER;
    }
    return (q->lower[c] - v > tolerance * (size + FABS(q->lower[c]))) ? AT_LOWER : INACTIVE;
}

/* Returns the new side of control j of stage k. A member leaves if its multiplier has the wrong sign by more than
 * rounding. */
static int qp_side_of_control(const solver_t *s, int k, int j)
{
    const qp_t *q = &s->qp;
    const riccati_t *r = &s->riccati;
    const int c = k * NU + j, side = q->side[c];
    real_t mult, size;
    if (side == INACTIVE) {
        return qp_side_of_value(q, c, q->z[c], q->scale[NX + j] + z_scale[NX + j]);
    }
    if (q->lower[c] >= q->upper[c]) {
        return side;
    }
    mult = side > 0 ? q->mult[c] : -q->mult[c];
    size = q->size[NX + j];
    if (!q->refined) {
        size = r->M[k][j][NX + j] * q->scale[NX + j] + FABS(r->h[k][j]);
    }
    return mult >= -TOL_RICCATI_SIGN * size - TOL_ROUNDING * force_size[NX + j] ? side : INACTIVE;
}

#if NG
/* The largest multiplier of the rows, and the largest quotient of a multiplier by q->root of its row. */
typedef struct {
    real_t mult;
    real_t scaled;
} largest_t;

static largest_t qp_largest_multipliers(const qp_t *q)
{
    largest_t largest = {R(0), R(0)};
    for (int m = 0; m < NG; m++) {
        const real_t force = FABS(q->mult[NV + m]);
        largest.mult = force > largest.mult ? force : largest.mult;
        largest.scaled = force > largest.scaled * q->root[m] ? force / q->root[m] : largest.scaled;
    }
    return largest;
}

/* Returns the new side of the member row m from its multiplier: it leaves if the sign is wrong. */
static int qp_side_of_member(const qp_t *q, int m, real_t rounding)
{
    const int c = NV + m, side = q->side[c];
    const real_t mult = side > 0 ? q->mult[c] : -q->mult[c];
    if (mult > q->penalty[m] + rounding) { /* the row becomes violated */
        return side > 0 ? ABOVE : BELOW;
    }
    if (mult >= -rounding) {
        return side;
    }
    if (q->lower[c] < q->upper[c]) {
        return INACTIVE;
    }
    if (-mult > q->penalty[m] + rounding) {
        return side > 0 ? BELOW : ABOVE;
    }
    return side;
}

/* Returns the new side of row m; a violated row becomes a member once its violation vanishes. */
static int qp_side_of_row(const solver_t *s, int m, const largest_t *largest)
{
    const qp_t *q = &s->qp;
    const int c = NV + m, side = q->side[c];
    const real_t size = qp_row_size(s, m);
    if (side == INACTIVE) {
        return qp_side_of_value(q, c, q->value[m], size + row_magnitude[row_id(m)]);
    }
    if (qp_is_violated(side)) {
        const real_t violation = side > 0 ? q->value[m] - q->upper[c] : q->lower[c] - q->value[m];
        const real_t rounding = qp_tolerance(q, TOL_RICCATI_FEASIBILITY) * (size + FABS(q->target[m]));
        const int member = side > 0 ? AT_UPPER : AT_LOWER;
        return violation >= -rounding ? side : member;
    }
    const real_t terms = q->root[m] * largest->scaled < largest->mult ? q->root[m] * largest->scaled : largest->mult;
    const real_t stiff = q->refined ? R(0) : q->root[m] * q->root[m] * size;
    return qp_side_of_member(q, m, qp_tolerance(q, TOL_RICCATI_SIGN) * (terms + stiff));
}

/* Returns the violation of row m, which is not a member, relative to the terms of its value and its bound. */
static real_t qp_violation(const solver_t *s, int m)
{
    const qp_t *q = &s->qp;
    const int c = NV + m;
    const real_t over = q->value[m] - q->upper[c], under = q->lower[c] - q->value[m];
    const real_t bound = FABS(over > under ? q->upper[c] : q->lower[c]);
    return (over > under ? over : under) / (qp_row_size(s, m) + bound);
}

/* Updates the side of every row. Of the inactive rows only the most violated ones enter: satisfying one of them usually
 * satisfies its neighbours in time as well, and more members than controls contradict one another. */
static void qp_revise_rows(solver_t *s)
{
    const qp_t *q = &s->qp;
    const largest_t largest = qp_largest_multipliers(q);
    real_t worst = R(0);
    for (int m = 0; m < NG; m++) {
        if (q->side[NV + m] == INACTIVE) {
            const real_t violation = qp_violation(s, m);
            worst = violation > worst ? violation : worst;
        }
    }
    for (int m = 0; m < NG; m++) {
        if (q->side[NV + m] != INACTIVE || qp_violation(s, m) >= R(0.5) * worst) {
            qp_set_row(s, m, qp_allowed_row(q, m, qp_side_of_row(s, m, &largest)));
        }
    }
}

#endif
/* Updates all sides; returns the number of changes. */
static int qp_revise(solver_t *s)
{
    const int before = s->qp.changes;
    if (NG) {
        qp_revise_rows(s);
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            qp_set_control(s, k, j, qp_side_of_control(s, k, j));
        }
    }
    return s->qp.changes - before;
}

/* Returns 1 if the working set equals one of the first `tried` sets of this solve, compared by their hashes; records
 * it. */
static int qp_set_repeats(qp_t *q, int tried)
{
    uint32_t hash = 2166136261U;
    for (int c = 0; c < NV + NG; c++) {
        hash = (hash ^ ((uint32_t)q->side[c] + 2U)) * 16777619U;
    }
    q->history[tried] = (int32_t)(hash >> 1);
    for (int i = 0; i < tried; i++) {
        if (q->history[i] == q->history[tried]) {
            return 1;
        }
    }
    return 0;
}

/* Updates the stale part of the recursion and of its vectors. Returns 0 if the factorisation fails. */
static int qp_renew(solver_t *s)
{
    qp_t *q = &s->qp;
    if (q->stale >= 0 && !riccati_factorize(s, q->stale)) {
        return 0;
    }
    if (NG) {
        schur_update(s);
    }
    if (q->stale_vectors >= 0) {
        qp_load(s);
        riccati_backward(s, q->stale_vectors);
        if (NG) {
            schur_set_origin(s);
        }
    }
    q->stale = -1;
    q->stale_vectors = -1;
    return 1;
}

/* Increases the weights of members that are still off their bounds; returns 0 if none can be increased. */
static int qp_raise_weights(solver_t *s)
{
    qp_t *q = &s->qp;
    int raised = 0;
    for (int m = 0; m < NG; m++) {
        const real_t size = qp_row_size(s, m) + FABS(q->target[m]);
        if (qp_is_member(q->side[NV + m]) && q->raised[m] < 2 &&
            FABS(qp_offset(q, m)) > TOL_RICCATI_FEASIBILITY * size) {
            q->raised[m]++;
            q->weight[m] *= FACTOR_RICCATI_WEIGHT_RATIO;
            s->riccati.weight[m] = q->weight[m];
            qp_outdate(q, row_node(m));
            raised = 1;
        }
    }
    return raised;
}

/* Computes the minimiser on the working set, refined if the working set would otherwise remain unchanged. `changed` is
 * the number of sides that the minimiser changes. */
static status_t qp_minimize(solver_t *s, int *changed)
{
    qp_t *q = &s->qp;
    status_t status = OK;
    *changed = 0;
    if (!qp_renew(s)) {
        return NUMERICAL_FAILURE;
    }
    (void)memcpy(q->x[0], s->step.dx[0], sizeof s->step.dx[0]);
    if (NG) {
        schur_impose(s);
    }
    riccati_forward(s, q->x, q->z);
    if (!qp_measure(q) || !qp_take_multipliers(s)) {
        return NUMERICAL_FAILURE;
    }
    if (NG) {
        if (s->schur.active && !schur_holds(s)) {
            return STALLED;
        }
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

/* Judges a residual that refinement does not reduce: it is rounding, or the weights are too small. */
static status_t qp_at_rest(const qp_t *q)
{
    if (NG) {
        if (q->scaled != SCALES_OWN) {
            return q->residual <= TOL_RICCATI_FEASIBILITY ? OK : STALLED;
        }
    }
    return q->residual <= TOL_RICCATI_ROUNDING ? OK : STALLED;
}

/* Iterates until the working set does not change. Returns OK; STALLED if a working set repeats itself, its members
 * contradict one another, or the number of changes does not fall and the interior point method can take over;
 * ITERATION_LIMIT; NUMERICAL_FAILURE. */
static status_t qp_iterate(solver_t *s, int most)
{
    qp_t *q = &s->qp;
    int before = 0, rises = 0;
    qp_set_repeats(q, 0);
    for (int tried = 1; tried <= most; tried++) {
        int changed;
        const status_t status = qp_minimize(s, &changed);
        if (status == NUMERICAL_FAILURE || (status == OK && changed == 0)) {
            return status;
        }
        if (NG) {
            if (s->schur.active && !s->schur.applies) {
                return STALLED;
            }
            if (changed == 0 && qp_raise_weights(s)) {
                q->iterations++;
                continue;
            }
        }
        if (changed == 0) {
            return qp_at_rest(q);
        }
        if (qp_set_repeats(q, tried)) {
            return STALLED;
        }
        if (INTERIOR_POINT) {
            rises += tried > 1 && changed > 2 && changed >= before;
            before = changed;
            if (rises == QP_MAX_RISES) {
                return STALLED;
            }
        }
        q->iterations++;
    }
    return ITERATION_LIMIT;
}

/* Returns 1 if the multiplier of c has a sign that its side does not allow. */
static inline int qp_wrong_sign(const qp_t *q, int c)
{
    if (q->side[c] == INACTIVE) {
        return 1;
    }
    return q->side[c] > 0 ? q->mult[c] < R(0) : q->mult[c] > R(0);
}

/* Clips the controls to their bounds and sets multipliers of the wrong sign to 0. */
static void qp_finish(qp_t *q)
{
    for (int c = 0; c < NV; c++) {
        q->z[c] = clip(q->z[c], q->lower[c], q->upper[c]);
    }
    for (int c = 0; c < NV + NG; c++) {
        if (q->lower[c] < q->upper[c] && qp_wrong_sign(q, c)) {
            q->mult[c] = R(0);
        }
    }
    q->relaxed = 0;
    for (int m = 0; m < NG; m++) {
        q->relaxed += qp_is_violated(q->side[NV + m]);
    }
}

/* Iterates, completes and checks the result. Returns STALLED if it is not a solution of the original QP. */
static status_t qp_settle(solver_t *s, int most)
{
    const status_t status = qp_iterate(s, most);
    if (status != OK) {
        return status;
    }
    qp_finish(&s->qp);
    s->qp.least = R(0);
    return qp_is_solution(s) ? OK : STALLED;
}
