/* This part treats rows with a slack variable. Such a row is lower <= a'z - sigma <= upper with the cost curvature / 2
 * sigma^2, and its slack has the elastic bound sigma = 0. H and A have no entries for slacks. As long as the multiplier
 * of the row is below the penalty, its slack is fixed: it is zero, neither its coordinate nor its bound occurs in the
 * working set, its side is INACTIVE, and the row has the penalty in its place. */

/* Returns the slack variable of general row c, or -1. */
static inline int qp_slack(int c)
{
    return row_slack[c - NV];
}

/* Returns the slack variable of general row c if it is not fixed, or -1. */
static inline int qp_moving_slack(const qp_t *q, int c)
{
    return qp_slack(c) >= 0 && q->side[qp_slack(c)] != INACTIVE ? qp_slack(c) : -1;
}

/* Returns the part of |m|^2 that the slack of general row c adds: 1 / curvature, or 0. */
static real_t qp_compliance(const qp_t *q, int c)
{
    const int slack = qp_moving_slack(q, c);
    return slack < 0 ? R(0) : q->inverse[slack] * q->inverse[slack];
}
