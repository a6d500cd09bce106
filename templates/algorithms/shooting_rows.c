/* Contract of this part: the rows as terms psi_m(v_m) that are added to the cost, v_m = value of row m. */

/* What add_rows() adds for the row m with gradient J_m: psi_m' J_m, mu_m J_m, or psi_m'' J_m (J_m' d). */
enum { ESTIMATE, MULTIPLIER, PRODUCT };

#if NG
/* Weight of a row in its scale: the constant of a sample, or what solve() has made of it. */
static real_t row_penalty(const solver_t *s)
{
#if SOLVE
    return s->shooting.penalty;
#else
    (void)s;
    return penalty_weight[0];
#endif
}

#if SMOOTH_ROWS
/* Sharpness of the smooth max, likewise. */
static real_t row_sharpness(const solver_t *s)
{
#if SOLVE
    return s->shooting.sharpness;
#else
    (void)s;
    return smooth_sharpness[0];
#endif
}

/* max(x, 0) + log(1 + exp(-a |x|)) / a, a smooth max(x, 0); its first and second derivatives times factor are added. */
static real_t smooth_excess(real_t x, real_t a, real_t factor, real_t *slope, real_t *curvature)
{
    const real_t e = EXP(-a * FABS(x)), part = ((x > R(0)) ? R(1) : e) / (R(1) + e);
    *slope += factor * part;
    *curvature += FABS(factor) * a * e / ((R(1) + e) * (R(1) + e));
    return ((x > R(0)) ? x : R(0)) + LOG1P(e) / a;
}

/* psi_m(v) = l1 (max(v - upper, 0) + max(lower - v, 0)), both smooth, + l2 / 2 violation^2. A hard row has the weight
 * of the options in its scale, which is exact if no multiplier is larger. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = ROW_LOWER(s, m), upper = ROW_UPPER(s, m);
    const real_t unit = SQRT(row_weight[m]), sharpness = row_sharpness(s) * unit;
    real_t l1 = row_penalty(s) * unit, value;
#if SOFT_ROWS
    l1 = IS_SOFT(m) ? row_l1[row_id[m]] : l1;
#endif
    *slope = *curvature = value = R(0);
    if (upper < INF) {
        value += l1 * smooth_excess(v - upper, sharpness, l1, slope, curvature);
    }
    if (lower > -INF) {
        value += l1 * smooth_excess(lower - v, sharpness, -l1, slope, curvature);
    }
#if SOFT_ROWS
    if (v < lower || v > upper) {
        const real_t excess = v - clip(v, lower, upper);
        value += R(0.5) * ROW_CURVATURE(m) * excess * excess;
        *slope += ROW_CURVATURE(m) * excess;
        *curvature += ROW_CURVATURE(m);
    }
#endif
    return value;
}
#else
/* psi_m(v) = min_y P_m(y) + mu_m (v - y) + rho_m / 2 (v - y)^2, where P_m is 0 between the bounds of row m and,
 * outside, the penalty of a soft row or infinite. psi_m' is the first-order estimate of the multiplier. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = ROW_LOWER(s, m), upper = ROW_UPPER(s, m);
#if DUAL_ROWS
    const real_t mu = s->row[m];
#else
    const real_t mu = R(0);
#endif
    const real_t weight = row_penalty(s) * row_weight[m], moved = v + mu / weight;
    const int inside = moved > lower && moved < upper;
    real_t y = inside ? moved : clip(moved, lower, upper), penalty = R(0);
    *slope = inside ? R(0) : mu + weight * (v - y);
    *curvature = inside ? R(0) : weight;
#if SOFT_ROWS
    const real_t l1 = row_l1[row_id[m]], l2 = ROW_CURVATURE(m);
    if (FABS(*slope) > l1) {
        const real_t side = (*slope > R(0)) ? R(1) : -R(1), bound = (*slope > R(0)) ? upper : lower;
        const real_t excess = (side * (mu + weight * (v - bound)) - l1) / (weight + l2);
        y = bound + side * excess;
        penalty = (l1 + R(0.5) * l2 * excess) * excess;
        *slope = side * (l1 + l2 * excess);
        *curvature = weight * l2 / (weight + l2);
    }
#endif
    return penalty + (mu + R(0.5) * weight * (v - y)) * (v - y);
}
#endif

#if GENERAL_ROWS || NE
/* Values and gradients of the general and coupled rows of one node; structural zeros are not stored by the kernels. */
typedef struct {
#if GENERAL_ROWS
    real_t h[NH + NH_N], J[(NH + NH_N) * NZ];
#endif
#if NE
    real_t r[NE], J_0[NE * NX], J_N[NE * NX];
#endif
} nodal_rows_t;

static void evaluate_nodal_rows(const solver_t *s, int k, nodal_rows_t *rows)
{
    memset(rows, 0, sizeof *rows);
#if NH
    if (k < N) {
        PATH_ROWS(s, k, rows->h, rows->J);
    }
#endif
#if NH_N
    if (k == N) {
        TERMINAL_ROWS(s, rows->h, rows->J);
    }
#endif
#if NE
    if (k == N) {
        COUPLED_ROWS(s, rows->r, rows->J_0, rows->J_N);
    }
#endif
}

/* Gradient of the general or coupled row m with respect to the variables of its node. */
static const real_t *row_gradient(const nodal_rows_t *rows, int m)
{
#if NE && GENERAL_ROWS
    if (IS_COUPLED(m)) {
        const int of_coupled = row_index[m] * NX;
        return rows->J_N + of_coupled;
    }
#endif
#if GENERAL_ROWS
    const int first = row_index[m] * ((row_node[m] < N) ? NZ : NX);
    return rows->J + first;
#else
    const int first = row_index[m] * NX;
    return rows->J_N + first;
#endif
}
#endif

/* The factor of J_m; moved = J_m' d. */
static real_t row_factor(const solver_t *s, int m, real_t v, int what, real_t moved)
{
    real_t slope, curvature;
#if NT
    if (terminal_index[m] >= 0) {
        return (what == PRODUCT) ? R(0) : s->row[m];
    }
#endif
    if (what == MULTIPLIER) {
        return s->row[m];
    }
    (void)row_term(s, m, v, &slope, &curvature);
    return (what == ESTIMATE) ? slope : curvature * moved;
}

/* Adds the terms of the rows of node k to g, NZ entries, NX at node N. */
static void add_rows(const solver_t *s, int k, int what, const real_t *d, real_t *g)
{
    if (row_first[k] >= row_first[k + 1]) {
        return;
    }
#if GENERAL_ROWS || NE
    nodal_rows_t rows;
    evaluate_nodal_rows(s, k, &rows);
#endif
    for (int m = row_first[k]; m < row_first[k + 1]; m++) { /* at most NG passes in add_rows */
#if STATE_ROWS
        if (row_bounds_state[m]) {
            g[row_index[m]] += row_factor(s, m, s->x[k][row_index[m]], what, d[row_index[m]]);
            continue;
        }
#endif
#if GENERAL_ROWS || NE
        const real_t *gradient = row_gradient(&rows, m);
        const int n = (k < N) ? NZ : NX;
        real_t moved = R(0);
        for (int i = 0; i < n; i++) {
            moved += gradient[i] * d[i];
        }
        const real_t factor = row_factor(s, m, ROW_VALUE(s, m, rows.h, rows.r), what, moved);
        for (int i = 0; i < n; i++) {
            g[i] += factor * gradient[i];
        }
#endif
    }
}

/* Sum of the terms, and the largest violation of a hard row in its scale. */
static real_t row_terms_of_plan(const solver_t *s, real_t *violation)
{
    real_t value[NG], sum = R(0), slope, curvature;
    evaluate_rows(s, value);
    *violation = R(0);
    for (int m = 0; m < NG; m++) {
        sum += row_term(s, m, value[m], &slope, &curvature);
        if (!IS_SOFT(m)) {
            enlarge(violation, SQRT(row_weight[m]) * (value[m] - clip(value[m], ROW_LOWER(s, m), ROW_UPPER(s, m))));
        }
    }
    return sum;
}

#if NG > NT
/* The dual update: mu_m = psi_m'(v_m), which changes by at most ``most`` times the penalty in the scale of the row, so
 * that no single sample has a lasting effect. Terminal rows whose multipliers the model yields keep them. */
static void update_rows(solver_t *s, real_t most)
{
    real_t value[NG], slope, curvature;
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t limit = most * row_penalty(s) * SQRT(row_weight[m]);
#if NT
        if (terminal_index[m] >= 0) {
            continue;
        }
#endif
        (void)row_term(s, m, value[m], &slope, &curvature);
        s->row[m] = clip(slope, s->row[m] - limit, s->row[m] + limit);
    }
}
#endif
#endif
