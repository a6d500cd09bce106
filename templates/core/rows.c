/* Rows are the constraints other than control bounds, sorted by node: bounds of states, then rows h, then rows that
 * read both ends. */

#include "generated/rows.c"

#include "core/clip.c"

#if SCALAR
#include "core/vectors_scalar.c"
#else
#include "core/vectors.c"
#endif

static inline real_t control_lower(const solver_t *s, int k, int j)
{
    if (control_row[j] < 0) {
        return -INF;
    }
    if (NHELD > 0 && BOUNDS_BY_NODE) {
        return PATH_LOWER(s, block_node[k * NU + j], control_row[j]);
    }
    return PATH_LOWER(s, k, control_row[j]);
}

static inline real_t control_upper(const solver_t *s, int k, int j)
{
    if (control_row[j] < 0) {
        return INF;
    }
    if (NHELD > 0 && BOUNDS_BY_NODE) {
        return PATH_UPPER(s, block_node[k * NU + j], control_row[j]);
    }
    return PATH_UPPER(s, k, control_row[j]);
}

/* Returns the reference of control j in the cost, or 0. */
static inline real_t reference_of_control(const solver_t *s, int k, int j)
{
    if (HAS_CONTROL_START) {
        real_t start[NU] = {R(0)};
        CONTROL_START(s, k, start);
        return isfinite(start[j]) ? start[j] : R(0);
    }
    if (control_reference[j] < 0) {
        return R(0);
    }
    return YREF(s, k)[control_reference[j]];
}

/* Returns the value of row m at the linearisation point. */
static inline real_t row_constant(const solver_t *s, int m)
{
    if (row_is_state(m)) {
        return s->x[row_node(m)][row_index(m)];
    }
    if (NE > 0 && (NH + NH_N == 0 || row_is_coupled(m))) {
        return s->coupled.r[row_index(m)];
    }
    if (NH_N > 0 && (NH == 0 || row_node(m) == N)) {
        return s->terminal.h[row_index(m)];
    }
    return s->node[row_node(m)].h[row_index(m)];
}

/* Returns the stored gradient of row m, which is no bound: NZ entries at a path node, the entries of x_N at the
 * terminal node. */
static inline const real_t *row_gradient(const solver_t *s, int m)
{
    if (NE > 0 && (NH + NH_N == 0 || row_is_coupled(m))) {
        return s->coupled.J_N[row_index(m)];
    }
    if (NH_N > 0 && (NH == 0 || row_node(m) == N)) {
        return s->terminal.J[row_index(m)];
    }
    return s->node[row_node(m)].J[row_index(m)];
}

/* Copies the gradient of any row m, in all NZ variables of a path node. */
static void copy_row_gradient(const solver_t *s, int m, real_t *a)
{
    (void)memset(a, 0, NZ * sizeof *a);
    if (row_is_state(m)) {
        a[row_index(m)] = R(1);
        return;
    }
    (void)memcpy(a, row_gradient(s, m), (size_t)nz_at(row_node(m)) * sizeof *a);
}

/* Writes mu of the general rows at path node k, 0 where one does not hold. */
static void path_multipliers(const solver_t *s, int k, real_t *mu)
{
    (void)memset(mu, 0, NH * sizeof *mu);
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (!row_is_state(m)) {
            mu[row_index(m)] = s->mult[m];
        }
    }
}

/* Returns the factor of the penalties of soft row i at a node: the length of its interval, at node N that of the last
 * interval, or 1. */
static inline real_t penalty_factor(int i, int k)
{
    if (SCALED_PENALTIES == 0) {
        return R(1);
    }
    return penalty_scaled[i] ? interval_length[(k < N) ? k : N - 1] : R(1);
}

/* Returns l1 of the penalty l1 v of a violation v of row m; infinite for a hard row. */
static inline real_t row_l1(const solver_t *s, int m)
{
    if (SOFT_ROWS == 0) {
        return INF;
    }
    const int i = soft_place[row_id(m)], k = row_node(m);
    if (i < 0) {
        return INF;
    }
    return SOFT_L1(s, k)[i] * penalty_factor(i, k);
}

/* Returns l2 of the quadratic part l2/2 v^2 of the penalty of row m. */
static inline real_t row_l2(const solver_t *s, int m)
{
    if (SOFT_ROWS == 0) {
        return R(0);
    }
    const int i = soft_place[row_id(m)], k = row_node(m);
    if (i < 0) {
        return R(0);
    }
    return SOFT_L2(s, k)[i] * penalty_factor(i, k);
}

/* Takes over the penalties that have been set. */
static void take_penalties(solver_t *s)
{
    if (TAKES_PENALTIES) {
        (void)memcpy(s->penalty_l1, s->soft_l1, sizeof s->soft_l1);
        (void)memcpy(s->penalty_l2, s->soft_l2, sizeof s->soft_l2);
    }
}

static inline int row_is_soft(const solver_t *s, int m)
{
    if (SOFT_ROWS == 0) {
        return 0;
    }
    if (HARD_ROWS == 0) {
        return 1;
    }
    return row_l1(s, m) < INF;
}

/* Returns the factor of the price of a violation of row m at its node. Rows on states only may be cheaper at early
 * nodes, because the way back may lead through larger violations. */
static inline real_t relaxed_price(const solver_t *s, int m)
{
    if (PRICED_ROWS) {
        return on_states[row_id(m)] ? s->price[row_node(m)] : R(1);
    }
    return R(1);
}

/* Returns the penalty of row m in a sample. For a relaxed hard row it is the price of a violation by the scale of the
 * row. */
static inline real_t row_penalty(const solver_t *s, int m)
{
    if (SOFT_ROWS > 0 && (RELAXATION == 0 || row_is_soft(s, m))) {
        return row_l1(s, m);
    }
    if (RELAXATION == 0) {
        return INF;
    }
    if (!(s->relaxation < INF)) {
        return s->relaxation;
    }
    const real_t scale = s->row_scale[row_id(m)], price = s->relaxation * relaxed_price(s, m);
    return (scale > R(0)) ? price / scale : price;
}

/* Returns the distance of a value of row m from its bounds, 0 inside them. */
static inline real_t outside(const solver_t *s, int m, real_t value)
{
    return FABS(value - clip(value, row_lower(s, m), row_upper(s, m)));
}

/* Evaluates all rows at the present iterate. */
static void evaluate_rows(const solver_t *s, real_t *value)
{
    for (int m = 0; m < NG; m++) {
        if (row_is_state(m)) {
            value[m] = s->x[row_node(m)][row_index(m)];
        }
    }
    if (NH + NH_N > 0) {
        real_t h[NH + NH_N] = {R(0)}, J[NH][NZ], J_end[NH_N][NX];
        int last = -1;
        for (int m = 0; m < NG; m++) {
            if (row_is_state(m) || row_is_coupled(m)) {
                continue;
            }
            const int k = row_node(m);
            if (k < N && k != last) {
                PATH_ROWS(s, k, h, J);
            }
            if (k == N && k != last) {
                TERMINAL_ROWS(s, h, J_end);
            }
            last = k;
            value[m] = h[row_index(m)];
        }
    }
    real_t r[NE], J_0[NE][NX], J_N[NE][NX];
    COUPLED_ROWS(s, r, J_0, J_N);
    for (int m = 0; m < NG; m++) {
        if (row_is_coupled(m)) {
            value[m] = r[row_index(m)];
        }
    }
}

/* Returns the sum of the magnitudes of the terms of row m, where size[] holds those of (dx, du). */
static real_t row_terms(const solver_t *s, int m, const real_t *size)
{
    const real_t constant = FABS(row_constant(s, m));
    if (row_is_state(m)) {
        return constant + size[row_index(m)];
    }
    const real_t *J = row_gradient(s, m);
    real_t terms = constant;
    for (int i = 0; i < nz_at(row_node(m)); i++) {
        terms += FABS(J[i]) * size[i];
    }
    return terms;
}
