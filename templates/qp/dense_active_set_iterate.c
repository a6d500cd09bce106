/* Contract of this part: dual iterations from a predicted working set to the solution or a certificate. */

/* Member with the most wrong multiplier, -1 if none: outside [0, limit] (equality: [-limit, limit]) by more than rounding,
 * excess |m| > tolerance (|y0| + |y|). */
static int qp_wrong_multiplier(const qp_t *q)
{
    int worst = -1;
    real_t most = R(0.0);
    for (int k = 0; k < q->nw; ++k) {
        const int c = q->row[k];
        const real_t lam = q->side[c] > 0 ? q->lam[k] : -q->lam[k];
        real_t excess = q->lower[c] < q->upper[c] ? -lam : R(0.0);
        if (q->elastic) {
            const real_t above = FABS(lam) - qp_limit(q, c);
            excess = above > excess ? above : excess;
        }
        if (excess > R(0.0)) {
            const real_t weighted = excess * SQRT(qp_dot(q->work.basis.R[k], q->work.basis.R[k], (k + 4) / 4 * 4));
            const real_t rounding = q->scale + q->shift + SQRT(qp_dot(q->y, q->y, LDV));
            if (weighted > most && weighted > TOL_QP_SIGN * rounding) {
                most = weighted;
                worst = k;
            }
        }
    }
    return worst;
}

/* Minimises on the working set; wrong multipliers are dropped or saturated, the worst first, until there is none. */
static status_t qp_restore_dual_feasibility(qp_t *q)
{
    for (;;) {
        qp_minimize_on_working_set(q);
        const int k = qp_wrong_multiplier(q);
        if (k < 0) {
            return OK;
        }
        if (q->iterations >= QP_MAX_ITERATIONS) {
            return ITERATION_LIMIT;
        }
        ++q->iterations;
        const int c = q->row[k], side = q->lam[k] > R(0.0) ? 1 : -1;
        if (q->lower[c] < q->upper[c] && side != q->side[c]) {
            qp_remove(q, k);
        } else {
            qp_saturate(q, k, side);
        }
    }
}

/* norm: |D^{-1/2} a_c|, an estimate of |m|; size: of the terms whose sum is a_c'z (a lower bound). */
static void qp_row_scale(const qp_t *q, int c, real_t *norm, real_t *size)
{
    if (c < NV) {
        *norm = q->inverse[c];
        *size = FABS(q->x[c]) + q->inverse[c] * FABS(q->y[c]);
    } else {
        const real_t *a = q->A[c - NV];
        real_t s = R(0.0), squares = R(0.0);
        for (int j = 0; j < NV; ++j) {
            s += FABS(a[j] * q->x[j]);
            squares += (a[j] * q->inverse[j]) * (a[j] * q->inverse[j]);
        }
        *norm = SQRT(squares);
        *size = s;
    }
}

/* How far the value of the saturated row c lies inside the bound at which it is saturated: there its multiplier goes back. */
static void qp_inside(const qp_t *q, int c, real_t *over, real_t *under)
{
    if (q->side[c] > 0) {
        *under = -*over;
        *over = -(real_t)INFINITY;
    } else {
        *over = -*under;
        *under = -(real_t)INFINITY;
    }
}

/* The row that is violated most, measured in y by 1/|D^{-1/2} a_c|, and by how much; -1 if none. A value that is not finite
 * is returned as the violation. Tolerated: the rounding error of a_c'z, and what qp_enforce accepted. */
static int qp_most_violated(const qp_t *q, int *side, real_t *violation)
{
    int worst = -1;
    real_t most = R(0.0);
    for (int c = 0; c < NV + NG; ++c) {
        if (q->side[c] != 0 && !qp_saturated(q, c)) {
            continue;
        }
        const real_t value = c < NV ? q->x[c] : qp_dot(q->A[c - NV], q->x, LDV);
        real_t over = value - q->upper[c], under = q->lower[c] - value;
        if (q->side[c] != 0) {
            qp_inside(q, c, &over, &under);
        }
        if (!(over <= q->slack[c] && under <= q->slack[c])) {
            const real_t amount = over > under ? over : under;
            real_t norm, size;
            if (!isfinite(value)) {
                *violation = value;
                return c;
            }
            qp_row_scale(q, c, &norm, &size);
            if (amount > TOL_QP_FEASIBILITY * size && amount > most * norm) {
                most = amount / norm;
                worst = c;
                *side = over > under ? 1 : -1;
                *violation = amount;
            }
        }
    }
    return worst;
}

/* How far side * lam of member k may move at the given rate: down to 0 (equality: -limit), up to limit. leave: the side at
 * which it saturates there, 0 if it is dropped. */
static real_t qp_room(const qp_t *q, int k, int falls, int *leave)
{
    const int c = q->row[k], side = q->side[c] > 0 ? 1 : -1;
    const real_t lam = side > 0 ? q->lam[k] : -q->lam[k];
    if (falls && q->lower[c] < q->upper[c]) {
        *leave = 0;
        return lam;
    }
    *leave = falls ? -side : side;
    return falls ? qp_limit(q, c) + lam : qp_limit(q, c) - lam;
}

/* The first member whose multiplier reaches an end of its range when the one of the entering row grows by t on the given
 * side: lam - side t r, r = R^{-1} d. Returns -1 if none; mm: squared norm of the entering normal. */
static int qp_blocking(const qp_t *q, const real_t *r, int side, real_t mm, real_t *step, int *leave)
{
    int first = -1;
    for (int k = 0; k < q->nw; ++k) {
        const int falls = ((q->side[q->row[k]] > 0) == (side > 0)) == (r[k] > R(0.0));
        const real_t rate = FABS(r[k]);
        int end;
        const real_t room = qp_room(q, k, falls, &end);
        if (rate > R(0.0) && room < (real_t)INFINITY) {
            const real_t norm2 = qp_dot(q->work.basis.R[k], q->work.basis.R[k], (k + 4) / 4 * 4);
            if (rate * rate * norm2 > TOL_QP_DEPENDENT * TOL_QP_DEPENDENT * mm &&
                (first < 0 || room < *step * rate)) {
                first = k;
                *leave = end;
                *step = room > R(0.0) ? room / rate : R(0.0);
            }
        }
    }
    return first;
}

/* lam -= step r, and y -= step v if the normal has a part v outside the span of the working set. */
static void qp_move(qp_t *q, const real_t *r, real_t step, int primal)
{
    for (int k = 0; k < q->nw; ++k) {
        q->lam[k] -= step * r[k];
    }
    if (primal) {
        for (int j = 0; j < LDV; ++j) {
            q->y[j] -= step * q->v[j];
        }
    }
}

/* Violation of the row with normal m = Q'R r + v that is taken as rounding. The members' part is a multiple of
 * size = |bound| + |t|'|r| + |m| (|y| / 4 + a little |y0|); entering would move y by violation / |v|, so it grows with
 * |m| / |v|, up to that of a row that cannot enter. The other part is that of v'y, which y0 dominates: a multiple of |v| |y0|. */
static real_t qp_rounding(const qp_t *q, const real_t *r, real_t bound, real_t mm, real_t vv)
{
    const real_t most = TOL_QP_REDUNDANT, least = TOL_QP_FEASIBILITY;
    const real_t outside = TOL_UNIT * SQRT(vv) * (q->scale + q->shift);
    real_t size = R(0.25) * SQRT(qp_dot(q->y, q->y, LDV));
    size = FABS(bound) + SQRT(mm) * (size + R(1.0 / 1048576) * (q->scale + q->shift));
    for (int k = 0; k < q->nw; ++k) {
        size += FABS(qp_active_bound(q, k) * r[k]);
    }
    return outside + size * (vv * (most * most) > mm * (least * least) ? least * SQRT(mm / vv) : most);
}

/* The rows c and row[k] contradict each other: certificate = side (e_c - sum_k r_k e_k), normalised, rounding left out. */
static void qp_certify(qp_t *q, int c, int side, const real_t *r, real_t mm)
{
    real_t most = R(1.0);
    for (int i = 0; i < NV + NG; ++i) {
        q->certificate[i] = R(0.0);
    }
    q->certificate[c] = side > 0 ? R(1.0) : -R(1.0);
    for (int k = 0; k < q->nw; ++k) {
        const real_t norm2 = qp_dot(q->work.basis.R[k], q->work.basis.R[k], (k + 4) / 4 * 4);
        if (r[k] * r[k] * norm2 > TOL_QP_DEPENDENT * TOL_QP_DEPENDENT * mm) {
            q->certificate[q->row[k]] = side > 0 ? -r[k] : r[k];
            most = FABS(r[k]) > most ? FABS(r[k]) : most;
        }
    }
    for (int i = 0; i < NV + NG; ++i) {
        q->certificate[i] = q->certificate[i] / most;
    }
}

/* y0 -= mult m for the row with normal m that joins the cost, or leaves it (mult with the other sign). */
static void qp_shift_origin(qp_t *q, real_t mult, real_t mm)
{
    for (int j = 0; j < LDV; ++j) {
        q->y0[j] -= mult * q->m[j];
    }
    q->shift += FABS(mult) * SQRT(mm);
}

/* Row c comes to rest: its multiplier has moved by `moved`. It is a member now, or saturated or inactive. */
static void qp_settle(qp_t *q, int c, int side, int member, real_t moved, real_t mm, real_t vv)
{
    const int state = q->side[c];
    const real_t before = qp_outside_multiplier(q, c), lam = side > 0 ? before + moved : before - moved;
    if (member) {
        qp_append(q, c, state == 0 ? side : state > 0 ? 1 : -1, vv, lam);
    } else {
        q->side[c] = state == 0 || q->lower[c] >= q->upper[c] ? 2 * side : 0;
    }
    if (qp_limit(q, c) < (real_t)INFINITY) {
        qp_shift_origin(q, (member ? R(0.0) : lam) - before, mm);
    }
    ++q->changes;
}

/* How far the multiplier of the entering row c may move: from 0 to its limit, from there to 0 (equality: to -limit). */
static real_t qp_reach(const qp_t *q, int c)
{
    const real_t limit = qp_limit(q, c);
    return q->side[c] != 0 && q->lower[c] >= q->upper[c] ? limit + limit : limit;
}

/* Dual steps until the violated row c is satisfied and in the working set, or its multiplier at the end of its range. A
 * violation that may be rounding is accepted instead, and remembered in slack[c]. */
static status_t qp_enforce(qp_t *q, int c, int side, real_t violation)
{
    const int state = q->side[c];
    const real_t mm = qp_normal(q, c), bound = (state == 0 ? side : state) > 0 ? q->upper[c] : q->lower[c];
    const real_t reach = qp_reach(q, c), sign = side > 0 ? R(1.0) : -R(1.0);
    real_t r[LDV], moved = R(0.0);
    if (!isfinite(mm) || !isfinite(violation)) {
        return NUMERICAL_FAILURE;
    }
    while (q->iterations < QP_MAX_ITERATIONS) {
        const real_t vv = qp_project(q, mm);
        const int primal = vv > TOL_QP_DEPENDENT * TOL_QP_DEPENDENT * mm;
        real_t step = R(0.0);
        int leave = 0;
        qp_backward_working_set(q, q->d, r);
        if (!(moved > R(0.0))) {
            q->slack[c] = qp_rounding(q, r, bound, mm, vv);
            if (violation <= q->slack[c]) {
                return OK;
            }
        }
        const int blocking = qp_blocking(q, r, side, mm, &step, &leave);
        if (!primal && blocking < 0 && !(reach < (real_t)INFINITY)) {
            qp_certify(q, c, side, r, mm);
            return INFEASIBLE;
        }
        ++q->iterations;
        violation = sign * (qp_dot(q->m, q->y, LDV) - bound);
        const int full = primal && (blocking < 0 || violation <= step * vv) && violation <= (reach - moved) * vv;
        const int last = full || blocking < 0 || reach - moved <= step;
        if (last) {
            step = !full ? reach - moved : violation > R(0.0) ? violation / vv : R(0.0);
        }
        moved += step;
        qp_move(q, r, sign * step, primal);
        if (last) {
            qp_settle(q, c, side, full, moved, mm, vv);
            return OK;
        }
        if (leave == 0) {
            qp_remove(q, blocking);
        } else {
            qp_saturate(q, blocking, leave);
        }
    }
    return ITERATION_LIMIT;
}

/* Row c enters the predicted working set unless it depends on the rows already there. */
static status_t qp_predict_active(qp_t *q, int c, int side)
{
    const real_t mm = qp_normal(q, c);
    q->side[c] = 0;
    if (!isfinite(mm)) {
        return NUMERICAL_FAILURE;
    }
    if (q->nw < NV && mm > R(0.0)) {
        const real_t vv = qp_project(q, mm);
        if (vv > TOL_QP_DEPENDENT_PREDICTION * TOL_QP_DEPENDENT_PREDICTION * mm) {
            qp_append(q, c, side, vv, R(0.0));
        }
    }
    return OK;
}

/* Saturation ends where the row has become hard, or the bound infinite. */
static void qp_release_saturated(qp_t *q)
{
    for (int c = NV; c < NV + NG; ++c) {
        const int held = qp_limit(q, c) < (real_t)INFINITY && isfinite(q->side[c] > 0 ? q->upper[c] : q->lower[c]);
        if (qp_saturated(q, c) && !held) {
            q->side[c] = 0;
        }
    }
}

/* Sets elastic; returns 0 if a penalty is invalid. */
static int qp_take_penalties(qp_t *q)
{
    int valid = 1, elastic = 0;
    for (int j = 0; j < NV + NG; ++j) {
        valid &= q->penalty[j] >= R(0.0);
        elastic |= q->penalty[j] < (real_t)INFINITY;
    }
    if (elastic || q->elastic) {
        qp_release_saturated(q);
    }
    q->elastic = elastic;
    return valid;
}

/* Checks the present bounds (crossed: infeasible); a member whose active side became infinite leaves. */
static status_t qp_take_bounds(qp_t *q)
{
    int valid = qp_take_penalties(q), ordered = 1;
    for (int c = 0; c < NV + NG; ++c) {
        valid &= q->lower[c] < ((real_t)INFINITY) && q->upper[c] > -((real_t)INFINITY);
        ordered &= q->lower[c] <= q->upper[c];
        q->slack[c] = R(0.0);
    }
    if (!valid || !ordered) {
        return valid ? INFEASIBLE : NUMERICAL_FAILURE;
    }
    for (int k = q->nw - 1; k >= 0; --k) {
        if (!isfinite(qp_active_bound(q, k))) {
            qp_remove(q, k);
        }
    }
    return OK;
}

/* Multipliers of the saturated rows; counts those that are violated by more than rounding. */
static void qp_write_saturated(qp_t *q)
{
    for (int j = 0; j < NG; ++j) {
        const int c = NV + j;
        if (qp_saturated(q, c)) {
            const real_t bound = q->side[c] > 0 ? q->upper[c] : q->lower[c];
            const real_t excess = qp_dot(q->A[j], q->x, LDV) - bound;
            real_t norm, size;
            qp_row_scale(q, c, &norm, &size);
            q->mult[c] = qp_outside_multiplier(q, c);
            q->relaxed += FABS(excess) > TOL_QP_REDUNDANT * (size + FABS(bound));
        }
    }
}

/* A multiplier that exceeds its limit by rounding. */
static real_t qp_clip_multiplier(const qp_t *q, int c, real_t lam)
{
    const real_t limit = qp_limit(q, c);
    return lam > limit ? limit : lam < -limit ? -limit : lam;
}

/* Results from y, lam and the working set; active bounds hold exactly, wrong signs within rounding become zero. */
static int qp_write_result(qp_t *q)
{
    real_t total = qp_dot(q->x, q->x, LDV);
    q->dropped = q->relaxed = 0;
    for (int i = 0; i < NV; ++i) {
        q->z[i] = q->x[i];
    }
    for (int c = 0; c < NV + NG; ++c) {
        q->mult[c] = R(0.0);
        q->dropped += q->side[c] == 0 && q->lower[c] >= q->upper[c];
    }
    if (q->elastic) {
        qp_write_saturated(q);
    }
    for (int k = 0; k < q->nw; ++k) {
        const int c = q->row[k];
        const real_t lam = q->elastic ? qp_clip_multiplier(q, c, q->lam[k]) : q->lam[k];
        const int side = lam > R(0.0) ? 1 : lam < R(0.0) ? -1 : q->side[c];
        total += FABS(lam);
        if (c < NV) {
            q->z[c] = qp_active_bound(q, k);
        }
        if (q->lower[c] >= q->upper[c]) {
            q->side[c] = side;
        }
        if (side == q->side[c]) {
            q->mult[c] = lam;
        }
    }
    return isfinite(total);
}

/* Nothing of the present data is kept: z = 0, mult = 0, empty working set. */
static status_t qp_fail(qp_t *q, status_t status)
{
    q->nw = q->relaxed = q->dropped = 0;
    for (int i = 0; i < NV; ++i) {
        q->z[i] = R(0.0);
    }
    for (int c = 0; c < NV + NG; ++c) {
        q->mult[c] = q->certificate[c] = R(0.0);
        q->side[c] = 0;
    }
    return status;
}

/* 1 if the working set is one that was there before (Brent's cycle search: a snapshot after 1, 2, 4, ... changes). */
static int qp_repeats(qp_t *q, int count)
{
    int same = count > 1;
    for (int c = 0; c < NV + NG; ++c) {
        same &= q->side[c] == q->snapshot[c];
    }
    for (int c = 0; (count & (count - 1)) == 0 && c < NV + NG; ++c) {
        q->snapshot[c] = q->side[c];
    }
    return same;
}

/* Alternates most violated rows and dual steps; at the end y and lam come from the factors, not from the updates. */
static status_t qp_iterate(qp_t *q)
{
    status_t status = qp_restore_dual_feasibility(q);
    int direct = 1, count = 0;
    while (status == OK) {
        const int changes = q->changes;
        int side = 0;
        real_t violation = R(0.0);
        qp_backward(q, q->y, q->x);
        const int c = qp_most_violated(q, &side, &violation);
        if (c >= 0) {
            status = qp_enforce(q, c, side, violation);
            direct = 0;
            if (qp_cancelled(q)) {
                qp_minimize_on_working_set(q);
            }
            if (status == OK && q->changes > changes && qp_repeats(q, ++count)) {
                status = STALLED;
            }
        } else if (direct) {
            return OK;
        } else {
            if (q->shift > R(0.0)) {
                qp_set_origin(q);
            }
            status = qp_restore_dual_feasibility(q);
            direct = 1;
        }
    }
    qp_backward(q, q->y, q->x);
    return status;
}
