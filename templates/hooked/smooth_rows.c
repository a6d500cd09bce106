/* Single shooting treats its rows as exact penalties with a smooth max, each separately or lumped into one row. */

/* Returns max(x, 0) + log(1 + exp(-a |x|)) / a, a smooth max(x, 0); its first and second derivatives times factor are
 * added. */
static real_t smooth_excess(real_t x, real_t a, real_t factor, real_t *slope, real_t *curvature)
{
    const real_t e = EXP(-a * FABS(x)), part = ((x > R(0)) ? R(1) : e) / (R(1) + e);
    *slope += factor * part;
    *curvature += FABS(factor) * a * e / ((R(1) + e) * (R(1) + e));
    return ((x > R(0)) ? x : R(0)) + LOG1P(e) / a;
}

/* Returns the weight of a hard row in its scale, which is exact if no multiplier is larger. */
static real_t hard_weight(const solver_t *s)
{
    if (LUMPED_ROWS) {
        return s->shooting.lump;
    }
    return penalty_of_rows(s);
}

/* psi_m(v) = l1 (max(v - upper, 0) + max(lower - v, 0)), both smooth, and l2 / 2 violation^2 where the row has this
 * penalty. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = row_lower(s, m), upper = row_upper(s, m);
    const real_t unit = SQRT(row_weight[m]), sharpness = s->shooting.sharpness * unit;
    real_t l1 = hard_weight(s) * unit, value;
    if (row_is_soft(s, m)) {
        l1 = row_l1(s, m);
    }
    *slope = R(0);
    *curvature = R(0);
    value = R(0);
    if (upper < INF) {
        value += l1 * smooth_excess(v - upper, sharpness, l1, slope, curvature);
    }
    if (lower > -INF) {
        value += l1 * smooth_excess(lower - v, sharpness, -l1, slope, curvature);
    }
    if (SOFT_ROWS > 0 && (v < lower || v > upper)) {
        const real_t excess = v - clip(v, lower, upper);
        value += R(0.5) * row_l2(s, m) * excess * excess;
        *slope += row_l2(s, m) * excess;
        *curvature += row_l2(s, m);
    }
    return value;
}

/* Returns the multiplier of row m after an update: the slope of its term, in magnitude at most `most` units more than
 * before. */
static real_t updated_multiplier(const solver_t *s, int m, real_t slope, real_t most)
{
    const real_t size = FABS(s->row[m]) + most * multiplier_unit(s, m);
    return clip(slope, -size, size);
}

/* Sharpens the smooth max. Returns 0 if it is at its limit. */
static int sharpen_terms(solver_t *s)
{
    if (!(s->shooting.sharpness < smooth_sharpness[2])) {
        return 0;
    }
    s->shooting.sharpness *= FACTOR_ROWS_SHARPEN;
    return 1;
}

/* Updates the multipliers in solve(); the weight of a lumped row grows while it does not reduce the violation. */
static int update_terms(solver_t *s, real_t tol, real_t *violation)
{
    const real_t now = s->stats.violation;
    update_rows(s, INF);
    int grown = sharpen(s);
    if (LUMPED_ROWS && now > tol && !(now < R(0.5) * *violation) && s->shooting.multiplier < MOST_PENALTY) {
        const real_t twice = R(2) * s->shooting.multiplier;
        s->shooting.multiplier = (s->shooting.lump > twice) ? s->shooting.lump : twice;
        grown = 1;
    }
    *violation = now;
    return grown;
}

static void smooth_rows_place_terms(solver_t *s, int closest)
{
    s->shooting.sharpness = smooth_sharpness[closest];
}

/* Makes the terms approximate the rows more closely after an easy sample, and less closely otherwise. */
static void smooth_rows_follow_terms(solver_t *s, int easy)
{
    const real_t sharpness = (easy ? FACTOR_ROWS_APPROACH : FACTOR_ROWS_RETREAT) * s->shooting.sharpness;
    s->shooting.sharpness = clip(sharpness, smooth_sharpness[0], smooth_sharpness[1]);
}
