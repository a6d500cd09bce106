/* A slack becomes free when the multiplier of its row exceeds the penalty. All slacks are fixed again before the next
 * problem. */

/* Returns 1 if c is a general row whose slack is fixed. */
static int qp_can_yield(const qp_t *q, int c)
{
    return c >= NV && qp_slack(c) >= 0 && q->side[qp_slack(c)] == INACTIVE;
}

/* Saturates the bound of the slack of row c, which is not a member, at the multiplier +-penalty of the row. The row
 * becomes hard. */
static void qp_free_slack(qp_t *q, int c, int side)
{
    const int slack = qp_slack(c);
    const real_t size = q->penalty[slack] * q->inverse[slack];
    q->side[slack] = 2 * side;
    q->penalty[c] = INF;
    q->y0[slack] = side > 0 ? -size : size;
    q->scale += size;
    ++q->changes;
}

/* Releases the slack of the entering row c with normal m, if it is fixed: adds the part of the slack to *mm = |m|^2 and
 * removes the limit *left of the multiplier. Returns 0 if the row has no fixed slack. */
static int qp_yields(qp_t *q, int c, int side, real_t *mm, real_t *left)
{
    if (!qp_can_yield(q, c)) {
        return 0;
    }
    qp_free_slack(q, c, side);
    q->work.basis.m[qp_slack(c)] = -q->inverse[qp_slack(c)];
    *mm += qp_compliance(q, c);
    *left = INF;
    return 1;
}

/* Keeps member k, whose multiplier is at the limit of the given side, in the working set, but frees its slack. The
 * normal m of another row is kept. */
static void qp_yield(qp_t *q, int k, int side)
{
    const int c = q->row[k];
    const real_t limit = q->penalty[c];
    real_t other[LDV];
    copy(other, q->work.basis.m);
    qp_remove(q, k);
    qp_free_slack(q, c, side);
    qp_append(q, c, side, qp_project(q, qp_normal(q, c)), side > 0 ? limit : -limit);
    copy(q->work.basis.m, other);
}

/* Fixes every saturated slack unless its row is a member on the side of the slack. Fixes all slacks if the working set
 * is empty. */
static void qp_fix_slacks(qp_t *q)
{
    for (int c = NV; c < NV + NG; ++c) {
        const int slack = qp_slack(c);
        if (slack < 0) {
            continue;
        }
        const int saturated = q->side[slack] == 2 || q->side[slack] == -2;
        if (saturated ? 2 * q->side[c] != q->side[slack] : q->nw == 0) {
            q->side[slack] = INACTIVE;
        }
    }
}

/* Gives every row with a fixed slack the penalty of the slack; a row with a free slack becomes hard. */
static void qp_share_penalties(qp_t *q)
{
    for (int c = NV; c < NV + NG; ++c) {
        if (qp_slack(c) >= 0) {
            q->penalty[c] = qp_can_yield(q, c) ? q->penalty[qp_slack(c)] : INF;
        }
    }
}
