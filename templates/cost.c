/* The cost of the present iterate: the nodes' terms, and penalties l1 v + l2/2 v^2 of violated soft rows. */

/* sum_k l_k + l_N, and the cost of x_0 by itself */
static real_t nodal_cost(const solver_t *s)
{
    real_t total = R(0);
#if HAS_TERMINAL_COST
    TERMINAL_COST(s, &total);
#endif
#if HAS_START_COST
    real_t l_0;
    START_COST(s, &l_0);
    total += l_0;
#endif
#if HAS_PATH_COST
    for (int k = 0; k < N; k++) {
        real_t l;
        PATH_COST(s, k, &l);
        total += l;
    }
#endif
    return total;
}

#if SOFT_ROWS
/* Penalty of a violation v >= 0 of the soft row m. */
static real_t soft_penalty(int m, real_t v)
{
    return row_l1[row_id[m]] * v + R(0.5) * ROW_CURVATURE(m) * v * v;
}

/* Penalties of the soft rows of the iterate. */
static real_t soft_penalties(const solver_t *s)
{
    real_t value[NG], total = R(0);
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (IS_SOFT(m)) {
            total += soft_penalty(m, FABS(value[m] - clip(value[m], ROW_LOWER(s, m), ROW_UPPER(s, m))));
        }
    }
    return total;
}
#endif
