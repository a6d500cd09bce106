/* Contract of this part: the rows as terms psi_m(v_m) that are added to the cost, v_m = value of row m. */

/* What add_rows() adds for the row m with gradient J_m: psi_m' J_m, mu_m J_m, psi_m'' J_m (J_m' d), or, for a hard row,
 * psi_m' J_m. */
enum { ESTIMATE, MULTIPLIER, PRODUCT, HARD };

/* Weight of a row in its scale: the constant of a sample, or what a continuation has made of it. */
static real_t penalty_of_rows(const solver_t *s)
{
    if (SOLVE || BARRIER_ROWS) {
        return s->shooting.penalty;
    }
    return penalty_weight[0];
}

/* The weights of the terminal rows in the merit function: those of other rows, times ``factor``. */
static void weigh_terminal(solver_t *s, real_t factor)
{
    for (int t = 0; t < NT; t++) {
        s->shooting.omega[t] = factor * penalty_of_rows(s) * row_weight[terminal_row[t]];
    }
}

/* By the file of the rows: psi_m(v) with its slope and curvature; updates of multipliers and weights. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature);
static real_t updated_multiplier(const solver_t *s, int m, real_t slope, real_t most);
static int sharpen_terms(solver_t *s);
static int update_terms(solver_t *s, real_t tol, real_t *violation);

/* Values and gradients of the rows of node k that are no bounds; structural zeros are not stored. */
static void evaluate_nodal_rows(const solver_t *s, int k, real_t *h, real_t *J)
{
    if (k < N) {
        PATH_ROWS(s, k, h, (real_t(*)[NZ])J);
    }
    if (k == N) {
        TERMINAL_ROWS(s, h, (real_t(*)[NX])J);
        real_t J_0[NE][NX];
        COUPLED_ROWS(s, h + NH_N, J_0, (real_t(*)[NX])(J + NH_N * NX));
    }
}

/* Place of row m among those of its node that are no bounds. */
static inline int place_of_row(int m)
{
    if (row_is_coupled(m)) {
        return NH_N + row_index(m);
    }
    return row_index(m);
}

/* Gradient of row m, which is no bound, with respect to the variables of its node. */
static const real_t *gradient_of_row(int m, const real_t *J)
{
    const int first = place_of_row(m) * nz_at(row_node(m));
    return J + first;
}

/* The factor of J_m; moved = J_m' d. */
static real_t row_factor(const solver_t *s, int m, real_t v, int what, real_t moved)
{
    real_t slope, curvature;
    if (terminal_index[m] >= 0) {
        return (what == PRODUCT) ? R(0) : s->row[m];
    }
    if (what == MULTIPLIER) {
        return s->row[m];
    }
    (void)row_term(s, m, v, &slope, &curvature);
    if (LUMPED_ROWS && row_is_soft(s, m) && what == HARD) {
        return R(0);
    }
    if (LUMPED_ROWS && !QUASI_NEWTON && !row_is_soft(s, m)) {
        curvature *= moved;
        return (what == PRODUCT) ? curvature + slope * s->shooting.lump_change : slope;
    }
    return (what == PRODUCT) ? curvature * moved : slope;
}

/* Adds the terms of the rows of node k to g, NZ entries, NX at node N. */
static void add_rows(const solver_t *s, int k, int what, const real_t *d, real_t *g)
{
    if (row_first[k] >= row_first[k + 1]) {
        return;
    }
    real_t h[NH + NH_N + NE] = {R(0)}, J[(NH + NH_N + NE) * NZ] = {R(0)};
    evaluate_nodal_rows(s, k, h, J);
    for (int m = row_first[k]; m < row_first[k + 1]; m++) { /* at most NG passes in add_rows */
        if (row_is_state(m)) {
            g[row_index(m)] += row_factor(s, m, s->x[k][row_index(m)], what, d[row_index(m)]);
            continue;
        }
        const real_t *gradient = gradient_of_row(m, J);
        const int n = nz_at(k);
        real_t moved = R(0);
        for (int i = 0; i < n; i++) {
            moved += gradient[i] * d[i];
        }
        const real_t factor = row_factor(s, m, h[place_of_row(m)], what, moved);
        for (int i = 0; i < n; i++) {
            g[i] += factor * gradient[i];
        }
    }
}

/* Multiplier of the lumped row. */
static real_t lump_multiplier(const solver_t *s)
{
    if (SOLVE) {
        return s->shooting.multiplier;
    }
    return penalty_of_rows(s);
}

/* Sum of the terms, and the largest violation of a hard row in its scale. */
static real_t row_terms_of_plan(solver_t *s, real_t *violation)
{
    real_t value[NG], sum = R(0), lump = R(0), slope, curvature;
    s->shooting.lump = R(1);
    evaluate_rows(s, value);
    *violation = R(0);
    for (int m = 0; m < NG; m++) {
        const real_t term = row_term(s, m, value[m], &slope, &curvature);
        if (row_is_soft(s, m)) {
            sum += term;
            continue;
        }
        if (LUMPED_ROWS) {
            lump += term;
        } else {
            sum += term;
        }
        enlarge(violation, SQRT(row_weight[m]) * outside(s, m, value[m]));
    }
    if (LUMPED_ROWS) {
        s->shooting.lump = lump_multiplier(s) + penalty_of_rows(s) * lump;
        sum += R(0.5) * (lump_multiplier(s) + s->shooting.lump) * lump;
    }
    return sum;
}

/* What a violation of one scale of row m costs by its penalty: the unit of its multiplier. */
static real_t multiplier_unit(const solver_t *s, int m)
{
    return penalty_of_rows(s) * SQRT(row_weight[m]);
}

/* The dual update: mu_m = psi_m'(v_m), in size at most ``most`` of its units more than before, so that no single sample
 * has a lasting effect. Terminal rows whose multipliers the model yields keep them. */
static void update_rows(solver_t *s, real_t most)
{
    real_t value[NG], slope, curvature;
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (terminal_index[m] >= 0) {
            continue;
        }
        (void)row_term(s, m, value[m], &slope, &curvature);
        s->row[m] = updated_multiplier(s, m, slope, most);
    }
}
