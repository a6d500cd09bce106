/* Contract of this part: row m adds a term psi_m(v_m) to the cost, where v_m is its value. */

/* Kinds of terms that add_rows() adds for row m with gradient J_m: psi_m' J_m; mu_m J_m; psi_m'' J_m (J_m' d); and
 * psi_m' J_m of a hard row. */
enum { ESTIMATE, MULTIPLIER, PRODUCT, HARD };

/* Returns the weight of a row in its scale: a constant in a sample, a growing number in a continuation. */
static real_t penalty_of_rows(const solver_t *s)
{
    if (SOLVE || BARRIER_ROWS) {
        return s->shooting.penalty;
    }
    return penalty_weight[0];
}

/* Sets the weights of the terminal rows in the merit function to those of the other rows times ``factor``. */
static void weigh_terminal(solver_t *s, real_t factor)
{
    for (int t = 0; t < NT; t++) {
        s->shooting.omega[t] = factor * penalty_of_rows(s) * row_weight[terminal_row[t]];
    }
}

/* Implemented by the file of the rows: returns psi_m(v) with its slope and curvature. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature);
static real_t updated_multiplier(const solver_t *s, int m, real_t slope, real_t most);
static int sharpen_terms(solver_t *s);
static int update_terms(solver_t *s, real_t tol, real_t *violation);

/* Evaluates the rows of node k that are no bounds, and their gradients; structural zeros are not stored. */
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

/* Returns the index of row m among the rows of its node that are no bounds. */
static inline int place_of_row(int m)
{
    if (row_is_coupled(m)) {
        return NH_N + row_index(m);
    }
    return row_index(m);
}

/* Returns the gradient of row m, which is no bound, with respect to the variables of its node. */
static const real_t *gradient_of_row(int m, const real_t *J)
{
    const int first = place_of_row(m) * nz_at(row_node(m));
    return J + first;
}

/* Returns the factor of J_m in the term of the given kind; moved = J_m' d. */
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

/* Adds the terms of the rows of node k to g, which has NZ entries, NX at node N. */
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

/* Returns the multiplier of the lumped row. */
static real_t lump_multiplier(const solver_t *s)
{
    if (SOLVE) {
        return s->shooting.multiplier;
    }
    return penalty_of_rows(s);
}

/* Returns the sum of the terms, and writes the largest violation of a hard row in its scale. */
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

/* Returns the penalty of a violation of row m by its scale, the unit of its multiplier. */
static real_t multiplier_unit(const solver_t *s, int m)
{
    return penalty_of_rows(s) * SQRT(row_weight[m]);
}

/* Updates the multipliers, mu_m = psi_m'(v_m). A magnitude grows by at most ``most`` units, so that no single sample
 * has a lasting effect. Terminal rows whose multipliers come from the model keep them. */
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
