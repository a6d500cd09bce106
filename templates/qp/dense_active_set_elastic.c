/* This part treats elastic rows. A finite penalty[c] >= 0 replaces row c by the cost penalty[c] (violation of the row),
 * so that |mult| <= penalty. A row whose multiplier is at the limit is saturated (side +-2) and may be violated;
 * `relaxed` is the number of violated ones. Without crossed bounds and hard rows the result is never INFEASIBLE. A
 * saturated row belongs to the cost: y0 = -C^{-1} (g + sum_saturated mult_c a_c). The multipliers of the dual problem
 * are then between 0 and the penalty, and every step increases its objective as before. */

enum { SATURATED_LOWER = -2, SATURATED_UPPER = 2 };

static int qp_is_saturated(const qp_t *q, int c)
{
    return q->side[c] == SATURATED_UPPER || q->side[c] == SATURATED_LOWER;
}

/* y += t a_c. */
static void qp_add_row(const qp_t *q, int c, real_t t, real_t *y)
{
    if (c < NV) {
        y[c] += t;
        return;
    }
    for (int i = 0; i < LDH; ++i) {
        y[i] += t * q->A[c - NV][i];
    }
}

/* Returns the multiplier of row c, which is not a member. */
static real_t qp_outside_multiplier(const qp_t *q, int c)
{
    return q->side[c] == INACTIVE ? R(0) : q->side[c] > 0 ? q->penalty[c] : -q->penalty[c];
}

/* y0 -= mult m for a row with normal m that joins the cost, or with the opposite sign of mult for a row that leaves
 * it. */
static void qp_shift_origin(qp_t *q, real_t mult)
{
    for (int j = 0; j < LDV; ++j) {
        q->y0[j] -= mult * q->work.basis.m[j];
    }
    q->scale += FABS(mult) * norm(q->work.basis.m);
}

/* Moves member k from the working set to the cost, with its multiplier at the limit of the given side; m = Q'R. */
static void qp_saturate(qp_t *q, int k, int side)
{
    /* 0 <= k <= NV - 1 */
    const int c = q->row[k];
    const basis_t *w = &q->work.basis;
    if (NSL) {
        if (qp_can_yield(q, c)) {
            qp_yield(q, k, side);
            return;
        }
    }
    for (int i = 0; i <= k; ++i) {
        for (int j = 0; j < LDV; ++j) {
            q->y0[j] -= (side > 0 ? q->penalty[c] : -q->penalty[c]) * w->R[k][i] * w->Q[i][j];
        }
    }
    q->scale += q->penalty[c] * SQRT(qp_square(q, k));
    qp_remove(q, k);
    q->side[c] = 2 * side;
}

/* Removes member k, whose multiplier is at an end of its range: it becomes inactive if the multiplier falls to 0,
 * otherwise saturated. */
static void qp_release(qp_t *q, int k, int falls)
{
    const int c = q->row[k], side = q->side[c];
    if (falls && !qp_is_equality(q, c)) {
        qp_remove(q, k);
    } else {
        qp_saturate(q, k, falls ? -side : side);
    }
}

/* y0 -= sum_saturated mult_c a_c; scale += sum of |mult_c| |D^{-1/2} a_c|, an estimate of |mult_c m|. */
static void qp_add_saturated(qp_t *q)
{
    for (int c = 0; q->elastic && c < NV + NG; ++c) {
        if (qp_is_saturated(q, c)) {
            qp_add_row(q, c, -qp_outside_multiplier(q, c), q->y0);
            q->scale += q->penalty[c] * qp_row_norm(q, c);
        }
    }
}

/* Ends the dual step of row c, which is not a member, after its multiplier has changed by `moved`: the row becomes a
 * member, saturated or inactive. */
static void qp_settle(qp_t *q, int c, int side, int member, real_t moved, real_t vv)
{
    const int state = q->side[c];
    const real_t before = qp_outside_multiplier(q, c), lam = side > 0 ? before + moved : before - moved;
    if (member) {
        qp_append(q, c, state == INACTIVE ? side : state > 0 ? AT_UPPER : AT_LOWER, vv, lam);
    } else {
        q->side[c] = state == INACTIVE || qp_is_equality(q, c) ? 2 * side : INACTIVE;
        ++q->changes;
    }
    if (q->penalty[c] < INF) {
        qp_shift_origin(q, (member ? R(0) : lam) - before);
    }
}

/* Sets `elastic` and ends the saturation of rows that have become hard or whose bound has become infinite. */
static void qp_take_penalties(qp_t *q, int elastic)
{
    for (int c = 0; (elastic || q->elastic) && c < NV + NG; ++c) {
        if (qp_is_saturated(q, c) && !(q->penalty[c] < INF && isfinite(qp_bound(q, c)))) {
            q->side[c] = INACTIVE;
        }
    }
    q->elastic = elastic;
}

/* Returns the violation of row c, which is saturated, or whose violation is a variable that moves. */
static real_t qp_relaxation(const qp_t *q, int c)
{
    if (NSL) {
        if (c >= NV && qp_moving_slack(q, c) >= 0) {
            return q->x[qp_slack(c)];
        }
        if (qp_is_slack(c)) {
            return R(0);
        }
    }
    return qp_is_saturated(q, c) ? qp_value(q, c, q->x) - qp_bound(q, c) : R(0);
}

/* Writes the multipliers of the saturated rows and counts the rows that are violated by more than rounding. */
static void qp_write_saturated(qp_t *q)
{
    for (int c = 0; q->elastic && c < NV + NG; ++c) {
        if (qp_is_saturated(q, c)) {
            q->mult[c] = qp_outside_multiplier(q, c);
            if (c < NV && (q->x[c] < qp_bound(q, c)) == (q->side[c] > 0)) { /* inside its bound by rounding */
                q->x[c] = qp_bound(q, c);
            }
        }
        const real_t excess = FABS(qp_relaxation(q, c));
        if (excess > R(0)) {
            q->relaxed += excess > TOL_QP_REDUNDANT * (qp_row_size(q, c) + FABS(qp_bound(q, c)));
        }
    }
}
