/* Single shooting treats its rows as logarithmic barriers. */

/* Returns -log t above the margin and, below it, the parabola with the same value, slope and curvature there, so that a
 * plan outside has finite terms, too. The derivatives with respect to v are added, t = distance * unit with the sign of
 * dt / dv. */
static real_t barrier(real_t t, real_t margin, real_t unit, real_t weight, real_t *slope, real_t *curvature)
{
    const int above = t > margin;
    const real_t z = above ? R(1) : t / margin - R(2), size = above ? t : margin;
    *slope += weight * unit * (above ? -z : z) / size;
    *curvature += weight * unit * unit / (size * size);
    return weight * (above ? -LOG(t) : R(0.5) * (z * z - R(1)) - LOG(margin));
}

/* Returns the distance from a bound, in the scale of the row, at which the parabola begins. */
static real_t row_margin(const solver_t *s)
{
    return barrier_margin[0] * penalty_of_rows(s) / barrier_weight[0];
}

/* psi_m(v) = weight (b(upper - v) + b(v - lower)) - tilt_m v with the logarithmic barrier b. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = row_lower(s, m), upper = row_upper(s, m);
    const real_t unit = SQRT(row_weight[m]), margin = row_margin(s), weight = penalty_of_rows(s);
    real_t value = -s->shooting.tilt[m] * v;
    *slope = -s->shooting.tilt[m];
    *curvature = R(0);
    if (upper < INF) {
        value += barrier(unit * (upper - v), margin, -unit, weight, slope, curvature);
    }
    if (lower > -INF) {
        value += barrier(unit * (v - lower), margin, unit, weight, slope, curvature);
    }
    return value;
}

/* Recentres the barriers: psi_m' = 0 at the end of the plan, so that a plant at rest stays at its set point. The centre
 * of row m is its value at the last node that has it, moved inside the margins. */
static void barrier_rows_before_steps(solver_t *s)
{
    real_t value[NG], curvature;
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t margin = row_margin(s) / SQRT(row_weight[m]);
        real_t centre = value[m], slope;
        for (int n = m + 1; n < NG; n++) {
            centre = (row_id(n) == row_id(m)) ? value[n] : centre;
        }
        centre = clip(centre, row_lower(s, m) + margin, row_upper(s, m) - margin);
        s->shooting.tilt[m] = R(0);
        (void)row_term(s, m, centre, &slope, &curvature);
        s->shooting.tilt[m] = isfinite(slope) ? slope : R(0);
    }
}

/* Returns the multiplier of row m after an update; the margin of a barrier limits its slope. */
static real_t updated_multiplier(const solver_t *s, int m, real_t slope, real_t most)
{
    return clip(slope, (row_lower(s, m) > -INF) ? -INF : R(0), (row_upper(s, m) < INF) ? INF : R(0));
}

/* Decreases the weight. Returns 0 if it is at its limit. */
static int sharpen_terms(solver_t *s)
{
    if (!(s->shooting.penalty > barrier_weight[2])) {
        return 0;
    }
    s->shooting.penalty *= FACTOR_ROWS_CENTRAL;
    return 1;
}

/* Updates the multipliers in solve(). */
static int update_terms(solver_t *s, real_t tol, real_t *violation)
{
    *violation = s->stats.violation;
    update_rows(s, INF);
    return sharpen(s);
}

static void barrier_rows_place_terms(solver_t *s, int closest)
{
    s->shooting.penalty = barrier_weight[closest];
}

static void barrier_rows_before_solve(solver_t *s)
{
    (void)memset(s->shooting.tilt, 0, sizeof s->shooting.tilt);
}

/* Makes the terms approximate the rows more closely after an easy sample, and less closely otherwise. */
static void barrier_rows_follow_terms(solver_t *s, int easy)
{
    s->shooting.penalty = clip(s->shooting.penalty / (easy ? FACTOR_ROWS_APPROACH : FACTOR_ROWS_RETREAT),
        barrier_weight[1], barrier_weight[0]);
}
