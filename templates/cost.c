/* The cost of the present iterate: the nodes' terms, and penalties l1 v + l2/2 v^2 of violated soft rows. */

/* sum_k l_k + l_N */
static real_t nodal_cost(const solver_t *s)
{
    real_t total, l;
    int k;
    terminal_cost(s->x[N], PARAM_N(s), YREF_N(s), WEIGHT_N(s), &total);
    for (k = 0; k < N; k++) {
        path_cost(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], YREF(s, k), WEIGHT(s, k), &l);
        total += l;
    }
    return total;
}

/* What a violation v >= 0 of row m adds: to the violation of a hard row, to the penalties of a soft one. */
static void add_violation(int m, real_t v, real_t *violation, real_t *penalties)
{
    const real_t l1 = row_l1[row_id[m]];
    if (l1 < (real_t)INFINITY) {
        *penalties += l1 * v + R(0.5) * row_curvature(m) * v * v;
    } else {
        *violation += v;
    }
}

/* The rows of node k at the present iterate; h are its general rows, r the coupled ones. */
static void add_rows_of_node(const solver_t *s, int k, const real_t *h, const real_t *r, real_t *violation,
    real_t *penalties)
{
    int m;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        const real_t value = row_value(s, m, h, r);
        add_violation(m, FABS(value - clip(value, row_lower(s, m), row_upper(s, m))), violation, penalties);
    }
}

/* Penalties of the soft rows, evaluated afresh. */
static real_t soft_penalties(const solver_t *s)
{
    real_t h[NH > 0 ? NH : 1] = {0}, h_N[NH_N > 0 ? NH_N : 1] = {0}, r[NE > 0 ? NE : 1] = {0};
    real_t J[(NH > 0 ? NH : 1) * NZ], J_N[(NH_N > 0 ? NH_N : 1) * NX], J_r[(NE > 0 ? NE : 1) * NX];
    real_t violation = R(0), penalties = R(0);
    int k;
    for (k = 0; SOFT_ROWS > 0 && k < N; k++) {
        path_rows(s->x[k], s->u[k], PARAM(s, k), h, J);
        add_rows_of_node(s, k, h, r, &violation, &penalties);
    }
    if (SOFT_ROWS > 0) {
        terminal_rows(s->x[N], PARAM_N(s), h_N, J_N);
        coupled_rows(s->x[0], s->x[N], r, J_r, J_r);
        add_rows_of_node(s, N, h_N, r, &violation, &penalties);
    }
    return penalties;
}
