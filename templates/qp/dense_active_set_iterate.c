/* Dual iterations lead from a predicted working set to the solution, or to a certificate of infeasibility. */

/* Returns the member with the largest violation of the sign condition, lam outside [0, limit] (equality: [-limit,
 * limit]) by more than rounding, excess |m| > tolerance (|y0| + |y|); -1 if there is none. */
static int qp_wrong_multiplier(const qp_t *q)
{
    int worst = -1;
    real_t most = R(0);
    for (int k = 0; k < q->nw; ++k) {
        const int c = q->row[k];
        const real_t lam = q->side[c] > 0 ? q->lam[k] : -q->lam[k];
        real_t excess = qp_is_equality(q, c) ? R(0) : -lam;
        if (ELASTIC) {
            excess = FABS(lam) - q->penalty[c] > excess ? FABS(lam) - q->penalty[c] : excess;
        }
        if (excess > R(0)) {
            const real_t weighted = excess * SQRT(qp_square(q, k));
            if (weighted > most && weighted > TOL_QP_SIGN * (q->scale + norm(q->work.basis.y))) {
                most = weighted;
                worst = k;
            }
        }
    }
    return worst;
}

/* Minimises on the working set and removes or saturates members with wrong multipliers, the worst first, until there is
 * none. */
static status_t qp_restore_dual_feasibility(qp_t *q)
{
    for (;;) { /* at most QP_MAX_ITERATIONS passes in qp_solve */
        qp_minimize_on_working_set(q);
        const int k = qp_wrong_multiplier(q);
        if (k < 0) {
            return OK;
        }
        if (q->iterations >= QP_MAX_ITERATIONS) {
            return ITERATION_LIMIT;
        }
        ++q->iterations;
        if (ELASTIC) {
            qp_release(q, k, (q->lam[k] > R(0)) != (q->side[q->row[k]] > 0));
        } else {
            qp_remove(q, k);
        }
    }
}

/* Computes the amounts by which the value of row c, which is not a member, exceeds its upper bound and falls below its
 * lower bound; for a saturated row, the distance from the bound towards the inside, where its multiplier has to move
 * back. Returns the value. */
static inline real_t qp_violations(const qp_t *q, int c, const real_t *z, real_t *over, real_t *under)
{
    const real_t value = qp_value(q, c, z);
    *over = value - q->upper[c];
    *under = q->lower[c] - value;
    if (ELASTIC) {
        if (q->side[c] > 0) {
            *under = -*over;
            *over = -INF;
        } else if (q->side[c] < 0) {
            *over = -*under;
            *under = -INF;
        }
    }
    return value;
}

/* Returns the row with the largest violation, scaled by 1 / |D^{-1/2} a_c|, with its side and its violation; -1 if
 * there is none, -2 if a value is not finite. Tolerated are the rounding error of a_c'z and violations that qp_enforce
 * has accepted. */
static int qp_most_violated(const qp_t *q, int *side, real_t *violation)
{
    int worst = -1;
    real_t over, under, most = R(0);
    for (int c = 0; c < NV + NG; ++c) {
        if (qp_is_member(q, c)) {
            continue;
        }
        const real_t value = qp_violations(q, c, q->x, &over, &under);
        if (over <= q->accepted[c] && under <= q->accepted[c]) {
            continue;
        }
        if (!isfinite(value)) {
            return -2;
        }
        const real_t amount = over > under ? over : under;
        if (amount > TOL_QP_FEASIBILITY * qp_row_size(q, c) && amount > most * qp_row_norm(q, c)) {
            most = amount / qp_row_norm(q, c);
            worst = c;
            *side = over > under ? AT_UPPER : AT_LOWER;
            *violation = amount;
        }
    }
    return worst;
}

/* Returns 1 if the multiplier of member k moves towards 0 when that of the entering row increases on the given side. */
static int qp_falls(const qp_t *q, const real_t *r, int k, int side)
{
    return ((q->side[q->row[k]] > 0) == (side > 0)) == (r[k] > R(0));
}

/* Returns the distance that the multiplier of member k may move: down to 0 (equality: -limit), or up to its limit. */
static real_t qp_room(const qp_t *q, int k, int falls)
{
    const int c = q->row[k];
    const real_t lam = q->side[c] > 0 ? q->lam[k] : -q->lam[k];
    if (falls && !qp_is_equality(q, c)) {
        return lam;
    }
    if (ELASTIC) {
        return falls ? q->penalty[c] + lam : q->penalty[c] - lam;
    } else {
        return INF;
    }
}

/* Returns 1 if member k contributes to the normal of the entering row, whose squared norm is mm. */
static int qp_takes_part(const qp_t *q, const real_t *r, int k, real_t mm)
{
    return r[k] * r[k] * qp_square(q, k) > TOL_QP_DEPENDENT * TOL_QP_DEPENDENT * mm;
}

/* Returns the first member whose multiplier lam - side step r, r = R^{-1} d, reaches an end of its range when that of
 * the entering row increases on the given side, which shortens the step; -1 if there is none within the step. */
static int qp_blocking(const qp_t *q, const real_t *r, int side, real_t mm, real_t *step)
{
    int first = -1;
    for (int k = 0; k < q->nw; ++k) {
        const real_t room = qp_room(q, k, qp_falls(q, r, k, side)), rate = FABS(r[k]);
        if (room < *step * rate && qp_takes_part(q, r, k, mm)) {
            first = k;
            *step = room > R(0) ? room / rate : R(0);
        }
    }
    return first;
}

/* lam -= step r, and y -= step v if the normal has a component v outside the span of the working set. */
static void qp_move(qp_t *q, const real_t *r, real_t step, int primal)
{
    for (int k = 0; k < q->nw; ++k) {
        q->lam[k] -= step * r[k];
    }
    for (int j = 0; primal && j < LDV; ++j) {
        q->work.basis.y[j] -= step * q->work.basis.v[j];
    }
}

/* Returns the violation of row c, with normal m = Q'R r + v, that counts as rounding error. The part of the members is
 * a multiple of size = |bound| + |t|'|r| + |m| (|y| / 4 + a small fraction of |y0|), where a bound t_k counts with the
 * terms that it sums up. As entering would move y by violation / |v|, the multiple grows with |m| / |v| up to that of a
 * row that cannot enter. The part of v'y, which y0 dominates, is a multiple of |v| |y0|. If this has led to a residual
 * that is too large, the terms of the row itself count instead of |m| |y|. */
static real_t qp_rounding(const qp_t *q, int c, const real_t *r, int side, real_t mm, real_t vv)
{
    const real_t most = TOL_QP_REDUNDANT, least = TOL_QP_FEASIBILITY;
    real_t size = qp_bound_size(q, c, q->side[c] == INACTIVE ? side : q->side[c]);
    for (int k = 0; k < q->nw; ++k) {
        size += qp_bound_size(q, q->row[k], q->side[q->row[k]]) * FABS(r[k]);
    }
    if (q->strict) {
        return q->strict > 1 ? FACTOR_DENSE_STRICT * TOL_QP_RESIDUAL * qp_row_size(q, c)
                             : FACTOR_DENSE_STRICT * most * (size + qp_row_size(q, c));
    }
    size += SQRT(mm) * (FACTOR_DENSE_STEP_ROUNDING * norm(q->work.basis.y) + FACTOR_DENSE_PATH_ROUNDING * q->scale);
    size *= vv * (most * most) > mm * (least * least) ? least * SQRT(mm / vv) : most;
    return size + TOL_UNIT * SQRT(vv) * q->scale;
}

/* Writes the certificate of the contradiction between row c and the rows of the working set: f = side (e_c - sum_k r_k
 * e_k), normalised to |f| <= 1, without entries that are rounding errors. With a_c the gradients of the rows,
 *
 *     sum_c f_c a_c = 0   and   sum_c f_c (upper_c if f_c > 0, lower_c if f_c < 0) < 0; f = 0 if bounds cross. */
static void qp_certify(qp_t *q, int c, int side, const real_t *r, real_t mm)
{
    real_t largest = R(1);
    (void)memset(q->certificate, 0, sizeof q->certificate);
    q->certificate[c] = R(side);
    for (int k = 0; k < q->nw; ++k) {
        if (qp_takes_part(q, r, k, mm)) {
            q->certificate[q->row[k]] = -R(side) * r[k];
            largest = FABS(r[k]) > largest ? FABS(r[k]) : largest;
        }
    }
    for (int i = 0; i < NV + NG; ++i) {
        q->certificate[i] = q->certificate[i] / largest;
    }
}

/* Returns the length of the full step, violation / v'v; infinite if the normal lies in the span of the working set. */
static real_t qp_full_step(real_t violation, real_t mm, real_t vv)
{
    if (!(vv > TOL_QP_DEPENDENT * TOL_QP_DEPENDENT * mm)) {
        return INF;
    }
    return violation > R(0) ? violation / vv : R(0);
}

/* Returns 1 if the violation of row c may be a rounding error; the bound for it is stored in accepted[c]. */
static int qp_is_rounding(qp_t *q, int c, const real_t *r, int side, real_t mm, real_t vv, real_t violation)
{
    q->accepted[c] = qp_rounding(q, c, r, side, mm, vv);
    return violation <= q->accepted[c];
}

/* Splits the normal m of the entering row, m = Q'R r + v. Returns v'v. */
static real_t qp_split(qp_t *q, real_t *r, real_t mm)
{
    const real_t vv = qp_project(q, mm);
    copy(r, q->work.basis.d);
    qp_solve_triangle(q, r);
    return vv;
}

/* Takes dual steps until the violated row c is satisfied and in the working set, or its multiplier is at the end of its
 * range. A violation that may be a rounding error is accepted instead and stored in accepted[c]. */
static status_t qp_enforce(qp_t *q, int c, int side, real_t violation)
{
    const real_t sign = R(side), bound = (q->side[c] == INACTIVE ? side : q->side[c]) > 0 ? q->upper[c] : q->lower[c];
    real_t r[LDV], moved = R(0), left = INF, mm = qp_normal(q, c);
    if (ELASTIC) {
        left = R(1 + (q->side[c] != INACTIVE && qp_is_equality(q, c))) *
            q->penalty[c]; /* 2: from one limit to the other */
    }
    while (isfinite(mm) && q->iterations < QP_MAX_ITERATIONS) { /* at most QP_MAX_ITERATIONS passes in qp_solve */
        const real_t vv = qp_split(q, r, mm);
        if (!(moved > R(0)) && qp_is_rounding(q, c, r, side, mm, vv, violation)) {
            return OK;
        }
        violation = sign * (dot(q->work.basis.m, q->work.basis.y, LDV) - bound);
        const real_t full = qp_full_step(violation, mm, vv);
        real_t step = left < full ? left : full;
        const int blocking = qp_blocking(q, r, side, mm, &step);
        if (!(step < INF)) {
            if (SOLVE) {
                qp_certify(q, c, side, r, mm);
            }
            return qp_is_rounding(q, c, r, side, mm, vv, violation) ? OK : INFEASIBLE;
        }
        ++q->iterations;
        moved += step;
        left -= step;
        qp_move(q, r, sign * step, full < INF);
        if (NSL) {
            if (step < full && blocking < 0 && qp_yields(q, c, side, &mm, &left)) {
                continue;
            }
        }
        if (blocking < 0) {
            if (ELASTIC) {
                qp_settle(q, c, side, full <= step, moved, vv);
            } else {
                qp_append(q, c, side, vv, sign * moved);
            }
            return OK;
        }
        if (ELASTIC) {
            qp_release(q, blocking, qp_falls(q, r, blocking, side));
        } else {
            qp_remove(q, blocking);
        }
    }
    return isfinite(mm) ? ITERATION_LIMIT : NUMERICAL_FAILURE;
}

/* Adds row c to the predicted working set unless it depends on the rows already in it: a fraction of its normal must be
 * outside their span. Returns 0 if its normal is not finite. */
static int qp_predict_active(qp_t *q, int c, real_t fraction)
{
    const real_t mm = qp_normal(q, c);
    const int side = q->side[c] < 0 ? AT_LOWER : AT_UPPER;
    q->side[c] = INACTIVE;
    if (q->nw < NV && mm > R(0)) {
        const real_t vv = qp_project(q, mm);
        if (vv > fraction * fraction * mm) {
            qp_append(q, c, side, vv, R(0));
        }
    }
    return isfinite(mm);
}

/* Checks the present bounds (crossed bounds: infeasible). A member whose active bound has become infinite is
 * removed. */
static status_t qp_take_bounds(qp_t *q)
{
    int valid = 1, ordered = 1;
    int elastic = 0;
    for (int c = 0; c < NV + NG; ++c) {
        const real_t width = q->upper[c] - q->lower[c]; /* NaN if both are the same infinity */
        valid &= width > -INF;
        ordered &= width >= R(0);
        if (ELASTIC) {
            valid &= q->penalty[c] >= R(0);
            elastic |= q->penalty[c] < INF;
        }
    }
    if (ELASTIC) {
        qp_take_penalties(q, elastic);
    }
    if (!valid || !ordered) {
        return valid ? INFEASIBLE : NUMERICAL_FAILURE;
    }
    for (int k = q->nw - 1; k >= 0; --k) {
        if (!isfinite(qp_bound(q, q->row[k]))) {
            qp_remove(q, k);
        }
    }
    if (NSL) {
        qp_fix_slacks(q);
        qp_share_penalties(q);
    }
    return OK;
}

/* Writes the results from y, lam and the working set. Bounds of variables hold exactly, and multipliers of the wrong
 * sign within rounding become 0. Returns 0 if the results are not finite. */
static int qp_write_result(qp_t *q)
{
    real_t total = dot(q->x, q->x, LDV);
    q->dropped = 0;
    q->relaxed = 0;
    (void)memset(q->mult, 0, sizeof q->mult);
    for (int c = 0; c < NV + NG; ++c) {
        if (q->side[c] == INACTIVE) {
            if (NSL) {
                q->dropped += !qp_is_slack(c) && qp_is_equality(q, c);
            } else {
                q->dropped += qp_is_equality(q, c);
            }
            if (c < NV) {
                q->x[c] = clip(q->x[c], q->lower[c], q->upper[c]);
            }
        }
    }
    if (ELASTIC) {
        qp_write_saturated(q);
    }
    for (int k = 0; k < q->nw; ++k) {
        const int c = q->row[k];
        real_t lam = q->lam[k];
        if (ELASTIC) {
            lam = clip(lam, -q->penalty[c], q->penalty[c]);
        }
        const int side = lam > R(0) ? AT_UPPER : lam < R(0) ? AT_LOWER : q->side[c];
        total += FABS(lam);
        if (NG) {
            if (c < NV) {
                q->x[c] = qp_bound(q, c);
            }
        } else {
            q->x[c] = qp_bound(q, c);
        }
        if (qp_is_equality(q, c)) {
            q->side[c] = side;
        }
        if (side == q->side[c]) {
            q->mult[c] = lam;
        }
    }
    (void)memcpy(q->z, q->x, sizeof q->z);
    return isfinite(total);
}

/* Clears the results and the working set after a failure. */
static status_t qp_fail(qp_t *q, status_t status)
{
    q->nw = 0;
    q->relaxed = 0;
    q->dropped = 0;
    (void)memset(q->z, 0, sizeof q->z);
    (void)memset(q->mult, 0, sizeof q->mult);
    (void)memset(q->certificate, 0, sizeof q->certificate);
    (void)memset(q->side, 0, sizeof q->side);
    return status;
}

/* Returns 1 if the working set has occurred before (Brent's cycle detection: a snapshot after 1, 2, 4, ... changes). */
static int qp_repeats(qp_t *q, int count)
{
    int c = 0;
    while (c < NV + NG && q->side[c] == q->snapshot[c]) {
        ++c;
    }
    if (!(count & (count - 1))) {
        (void)memcpy(q->snapshot, q->side, sizeof q->side);
    }
    return count > 1 && c == NV + NG;
}

/* Alternates between the search for the most violated row and dual steps. At the end y and lam are computed from the
 * factors, not from the updates. */
static status_t qp_iterate(qp_t *q)
{
    int direct = 1, count = 0, side = INACTIVE;
    real_t violation = R(0);
    (void)memset(q->accepted, 0, sizeof q->accepted);
    qp_set_origin(q);
    status_t status = isfinite(q->scale) ? qp_restore_dual_feasibility(q) : NUMERICAL_FAILURE;
    while (status == OK) { /* at most QP_MAX_SEARCHES passes in qp_solve */
        if (q->searches++ >= QP_MAX_SEARCHES) {
            return ITERATION_LIMIT;
        }
        const int changes = q->changes;
        qp_backward(q, q->work.basis.y, q->x);
        const int c = qp_most_violated(q, &side, &violation);
        if (c >= 0) {
            status = qp_enforce(q, c, side, violation);
            direct = 0;
            if (qp_has_cancellation(q)) {
                qp_minimize_on_working_set(q);
            }
            if (status == OK && q->changes > changes && qp_repeats(q, ++count)) {
                status = STALLED;
            }
        } else if (direct || c < -1) {
            return c < -1 ? NUMERICAL_FAILURE : OK;
        } else {
            qp_set_origin(q);
            status = qp_restore_dual_feasibility(q);
            direct = 1;
        }
    }
    qp_backward(q, q->work.basis.y, q->x);
    return status;
}
