/* Rows of the QP besides the control bounds, sorted by node: state bounds (kind 0), general rows h (kind 1) and, at the end,
 * coupled rows r(x_0, x_N) (kind 2). */

static real_t clip(real_t value, real_t lower, real_t upper)
{
    if (value < lower) {
        return lower;
    }
    return (value > upper) ? upper : value;
}

static int all_finite(const real_t *v, int n)
{
    int i;
    for (i = 0; i < n; i++) {
        if (!isfinite(v[i])) {
            return 0;
        }
    }
    return 1;
}

/* Bounds of control j at node k; +-infinity where the user stated none. (void): for packages that store one pair for all
 * nodes, or none. */
static real_t control_lower(const solver_t *s, int k, int j)
{
    (void)s;
    (void)k;
    return (control_row[j] >= 0) ? PATH_LOWER(s, k, control_row[j]) : -(real_t)INFINITY;
}

static real_t control_upper(const solver_t *s, int k, int j)
{
    (void)s;
    (void)k;
    return (control_row[j] >= 0) ? PATH_UPPER(s, k, control_row[j]) : (real_t)INFINITY;
}

static real_t row_lower(const solver_t *s, int m)
{
    (void)s;
    return ROW_LOWER(s, row_node[m], row_id[m]);
}

static real_t row_upper(const solver_t *s, int m)
{
    (void)s;
    return ROW_UPPER(s, row_node[m], row_id[m]);
}

#if NG
/* Penalty l1 v + l2/2 v^2 of the violation v of row m: infinite l1 for hard rows, unless the present QP is relaxed. */
static real_t row_penalty(const solver_t *s, int m)
{
    const real_t l1 = row_l1[row_id[m]];
    return (l1 < (real_t)INFINITY) ? l1 : s->relaxation;
}

#endif
static real_t row_curvature(int m)
{
    return row_l2[row_id[m]];
}

/* Where the multiplier of row m lives. */
static real_t *row_multiplier_place(solver_t *s, int m)
{
    const int k = row_node[m];
    if (row_kind[m] == 0) {
        return &s->mu_x[k][row_index[m]];
    }
    if (row_kind[m] == 2) {
        return &s->eta[row_index[m]];
    }
    return (k == N) ? &s->mu_N[row_index[m]] : &s->mu[k][row_index[m]];
}

static real_t row_multiplier(const solver_t *s, int m)
{
    const int k = row_node[m];
    if (row_kind[m] == 0) {
        return s->mu_x[k][row_index[m]];
    }
    if (row_kind[m] == 2) {
        return s->eta[row_index[m]];
    }
    return (k == N) ? s->mu_N[row_index[m]] : s->mu[k][row_index[m]];
}

/* Value of row m at the iterate; h are the general rows of its node, r the coupled rows. */
static real_t row_value(const solver_t *s, int m, const real_t *h, const real_t *r)
{
    if (row_kind[m] == 0) {
        return s->x[row_node[m]][row_index[m]];
    }
    return (row_kind[m] == 1) ? h[row_index[m]] : r[row_index[m]];
}

/* Value of row m in the linearisation. */
static real_t row_constant(const solver_t *s, int m)
{
    const int k = row_node[m];
    if (row_kind[m] == 1) {
        return (k == N) ? s->terminal.h[row_index[m]] : s->node[k].h[row_index[m]];
    }
    return (row_kind[m] == 0) ? s->x[k][row_index[m]] : s->coupled.r[row_index[m]];
}

/* Gradient J = (d row / dx, d row / du) and value of row m in the linearisation; of a coupled row J = d row / dx_N. */
static real_t row_gradient(const solver_t *s, int m, real_t *J)
{
    const int k = row_node[m];
    const int r = row_index[m];
    int i;
    for (i = 0; i < NZ; i++) {
        J[i] = R(0);
    }
    if (row_kind[m] == 0) {
        J[r] = R(1);
    } else if (row_kind[m] == 1 && k < N) {
        for (i = 0; i < NZ; i++) {
            J[i] = s->node[k].J[r][i];
        }
    } else {
        const real_t *last = (row_kind[m] == 1) ? s->terminal.J[r] : s->coupled.J_N[r];
        for (i = 0; i < NX; i++) {
            J[i] = last[i];
        }
    }
    return row_constant(s, m);
}
