/* Cost of the present iterate: the terms of the nodes, and the penalties l1 v + l2/2 v^2 of violated rows that have
 * one. */

/* sum_k l_k + l_N. */
static real_t nodal_cost(const solver_t *s)
{
    real_t total = R(0);
    TERMINAL_COST(s, &total);
    if (HAS_START_COST) {
        /* the cost of x_0 */
        real_t l_0;
        START_COST(s, &l_0);
        total += l_0;
    }
    if (HAS_PATH_COST) {
        for (int k = 0; k < N; k++) {
            real_t l;
            PATH_COST(s, k, &l);
            total += l;
        }
    }
    return total;
}

/* Returns the penalty l1 v + l2/2 v^2 of a violation v >= 0 of the soft row m. */
static real_t soft_penalty(const solver_t *s, int m, real_t v)
{
    return row_l1(s, m) * v + R(0.5) * row_l2(s, m) * v * v;
}

/* Returns the sum of the penalties of all soft rows at the present iterate. */
static real_t soft_penalties(const solver_t *s)
{
    real_t value[NG], total = R(0);
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m)) {
            total += soft_penalty(s, m, outside(s, m, value[m]));
        }
    }
    return total;
}
