/* Single shooting treats its rows as terms of an augmented Lagrangian. */

/* psi_m(v) = min_y P_m(y) + mu_m (v - y) + rho_m / 2 (v - y)^2, where P_m is 0 between the bounds of row m and,
 * outside, its penalty or infinite. psi_m' is the first-order estimate of the multiplier. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = row_lower(s, m), upper = row_upper(s, m);
    const real_t mu = s->row[m];
    real_t weight = penalty_of_rows(s) * row_weight[m];
    if (terminal_index[m] >= 0) {
        weight = s->shooting.omega[terminal_index[m]];
    }
    const real_t moved = v + mu / weight;
    const int inside = moved > lower && moved < upper;
    real_t y = inside ? moved : clip(moved, lower, upper), penalty = R(0);
    *slope = inside ? R(0) : mu + weight * (v - y);
    *curvature = inside ? R(0) : weight;
    if (SOFT_ROWS > 0 && FABS(*slope) > row_l1(s, m)) {
        const real_t l1 = row_l1(s, m), l2 = row_l2(s, m);
        const real_t side = (*slope > R(0)) ? R(1) : -R(1), bound = (*slope > R(0)) ? upper : lower;
        const real_t excess = (side * (mu + weight * (v - bound)) - l1) / (weight + l2);
        y = bound + side * excess;
        penalty = (l1 + R(0.5) * l2 * excess) * excess;
        *slope = side * (l1 + l2 * excess);
        *curvature = weight * l2 / (weight + l2);
    }
    return penalty + (mu + R(0.5) * weight * (v - y)) * (v - y);
}

/* Returns the multiplier of row m after an update: the slope of its term, in magnitude at most `most` units more than
 * before. */
static real_t updated_multiplier(const solver_t *s, int m, real_t slope, real_t most)
{
    const real_t size = FABS(s->row[m]) + most * multiplier_unit(s, m);
    return clip(slope, -size, size);
}

/* Increases the penalty. Returns 0 if it is at its limit. */
static int sharpen_terms(solver_t *s)
{
    if (!(s->shooting.penalty < MOST_PENALTY)) {
        return 0;
    }
    s->shooting.penalty *= FACTOR_PENALTY_RATIO;
    return 1;
}

/* Returns the largest |v_m - y_m| in the scale of a row, where y_m minimises psi_m. This is the violation of an active
 * hard row, and for other rows what the next update of the multiplier would change. */
static real_t dual_residual(const solver_t *s)
{
    real_t value[NG], most = s->stats.violation, slope, curvature;
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (terminal_index[m] >= 0) {
            continue;
        }
        (void)row_term(s, m, value[m], &slope, &curvature);
        enlarge(&most, (slope - s->row[m]) / multiplier_unit(s, m));
    }
    return most;
}

/* Updates the multipliers in solve(). *violation: the residual of the rows, before and after the update. */
static int update_terms(solver_t *s, real_t tol, real_t *violation)
{
    const real_t now = dual_residual(s);
    int grown = 0;
    update_rows(s, R(1));
    if (!(now < FACTOR_ROWS_ENOUGH * *violation) && now > FACTOR_ROWS_INNER * tol) {
        grown = sharpen(s);
    }
    grown |= now < *violation;
    *violation = now;
    return grown;
}
