/* Contract of this part: the rows as terms psi_m(v_m) that are added to the cost, v_m = value of row m. */

/* What add_rows() adds for the row m with gradient J_m: psi_m' J_m, mu_m J_m, psi_m'' J_m (J_m' d), or, for a hard row,
 * psi_m' J_m. */
enum { ESTIMATE, MULTIPLIER, PRODUCT, HARD };

#if NG
/* Weight of a row in its scale: the constant of a sample, or what a continuation has made of it. */
static real_t row_penalty(const solver_t *s)
{
#if SOLVE || BARRIER_ROWS
    return s->shooting.penalty;
#else
    (void)s;
    return penalty_weight[0];
#endif
}

#if NT
/* The weights of the terminal rows in the merit function: those of other rows, times ``factor``. */
static void weigh_terminal(solver_t *s, real_t factor)
{
    for (int t = 0; t < NT; t++) {
        s->shooting.omega[t] = factor * row_penalty(s) * row_weight[terminal_row[t]];
    }
}
#endif

#if SMOOTH_ROWS
/* max(x, 0) + log(1 + exp(-a |x|)) / a, a smooth max(x, 0); its first and second derivatives times factor are added. */
static real_t smooth_excess(real_t x, real_t a, real_t factor, real_t *slope, real_t *curvature)
{
    const real_t e = EXP(-a * FABS(x)), part = ((x > R(0)) ? R(1) : e) / (R(1) + e);
    *slope += factor * part;
    *curvature += FABS(factor) * a * e / ((R(1) + e) * (R(1) + e));
    return ((x > R(0)) ? x : R(0)) + LOG1P(e) / a;
}

/* Weight of a hard row in its scale, which is exact if no multiplier is larger. */
static real_t hard_weight(const solver_t *s)
{
#if LUMPED_ROWS
    return s->shooting.lump;
#else
    return row_penalty(s);
#endif
}

/* psi_m(v) = l1 (max(v - upper, 0) + max(lower - v, 0)), both smooth, + l2 / 2 violation^2 of soft rows. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = ROW_LOWER(s, m), upper = ROW_UPPER(s, m);
    const real_t unit = SQRT(row_weight[m]), sharpness = s->shooting.sharpness * unit;
    real_t l1 = hard_weight(s) * unit, value;
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
#elif BARRIER_ROWS
/* -log t above the margin, below it the parabola with the same value, slope and curvature there: a plan outside has
 * finite terms, too. Value; the derivatives with respect to v, t = distance * unit with the sign of dt / dv, are added. */
static real_t barrier(real_t t, real_t margin, real_t unit, real_t weight, real_t *slope, real_t *curvature)
{
    const int above = t > margin;
    const real_t z = above ? R(1) : t / margin - R(2), size = above ? t : margin;
    *slope += weight * unit * (above ? -z : z) / size;
    *curvature += weight * unit * unit / (size * size);
    return weight * (above ? -LOG(t) : R(0.5) * (z * z - R(1)) - LOG(margin));
}

/* Distance from a bound, in the scale of the row, at which the parabola begins. */
static real_t row_margin(const solver_t *s)
{
    return barrier_margin[0] * row_penalty(s) / barrier_weight[0];
}

/* psi_m(v) = weight (b(upper - v) + b(v - lower)) - tilt_m v with the logarithmic barrier b. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = ROW_LOWER(s, m), upper = ROW_UPPER(s, m);
    const real_t unit = SQRT(row_weight[m]), margin = row_margin(s), weight = row_penalty(s);
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

/* Recentres the barriers: psi_m' = 0 where the plan ends, so that the rest at a set point is not displaced. The centre of
 * row m is its value at the last node that has it, moved inside the margins. */
static void recentre_rows(solver_t *s)
{
    real_t value[NG], curvature;
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t margin = row_margin(s) / SQRT(row_weight[m]);
        real_t centre = value[m], slope;
        for (int n = m + 1; n < NG; n++) {
            centre = (row_id[n] == row_id[m]) ? value[n] : centre;
        }
        centre = clip(centre, ROW_LOWER(s, m) + margin, ROW_UPPER(s, m) - margin);
        s->shooting.tilt[m] = R(0);
        (void)row_term(s, m, centre, &slope, &curvature);
        s->shooting.tilt[m] = isfinite(slope) ? slope : R(0);
    }
}
#else
/* psi_m(v) = min_y P_m(y) + mu_m (v - y) + rho_m / 2 (v - y)^2, where P_m is 0 between the bounds of row m and,
 * outside, the penalty of a soft row or infinite. psi_m' is the first-order estimate of the multiplier. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = ROW_LOWER(s, m), upper = ROW_UPPER(s, m);
    const real_t mu = s->row[m];
#if NT
    const int t = terminal_index[m];
    const real_t weight = (t >= 0) ? s->shooting.omega[t] : row_penalty(s) * row_weight[m];
#else
    const real_t weight = row_penalty(s) * row_weight[m];
#endif
    const real_t moved = v + mu / weight;
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
#if LUMPED_ROWS
    if (IS_SOFT(m) && what == HARD) {
        return R(0);
    }
#if !QUASI_NEWTON
    if (!IS_SOFT(m)) {
        curvature *= moved;
        return (what == PRODUCT) ? curvature + slope * s->shooting.lump_change : slope;
    }
#endif
#endif
    return (what == PRODUCT) ? curvature * moved : slope;
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

#if LUMPED_ROWS
/* Multiplier of the lumped row. */
static real_t lump_multiplier(const solver_t *s)
{
#if SOLVE
    return s->shooting.multiplier;
#else
    return row_penalty(s);
#endif
}
#endif

/* Sum of the terms, and the largest violation of a hard row in its scale. */
static real_t row_terms_of_plan(solver_t *s, real_t *violation)
{
    real_t value[NG], sum = R(0), slope, curvature;
#if LUMPED_ROWS
    real_t lump = R(0);
    s->shooting.lump = R(1);
#endif
    evaluate_rows(s, value);
    *violation = R(0);
    for (int m = 0; m < NG; m++) {
        const real_t term = row_term(s, m, value[m], &slope, &curvature);
        if (IS_SOFT(m)) {
            sum += term;
            continue;
        }
#if LUMPED_ROWS
        lump += term;
#else
        sum += term;
#endif
        enlarge(violation, SQRT(row_weight[m]) * outside(s, m, value[m]));
    }
#if LUMPED_ROWS
    s->shooting.lump = lump_multiplier(s) + row_penalty(s) * lump;
    sum += R(0.5) * (lump_multiplier(s) + s->shooting.lump) * lump;
#endif
    return sum;
}

#if SMOOTH_ROWS || BARRIER_ROWS
/* The terms as far from the rows (closest = 0), or as close to them, as in a sample. */
static void place_terms(solver_t *s, int closest)
{
#if SMOOTH_ROWS
    s->shooting.sharpness = smooth_sharpness[closest];
#else
    s->shooting.penalty = barrier_weight[closest];
#endif
}

/* Continuation over the samples: the terms come closer to the rows if all steps of the sample have been accepted at
 * once, and retreat otherwise. */
static void follow_terms(solver_t *s)
{
    const int easy = s->stats.simulations <= s->stats.accepted + 1 && s->shooting.length >= R(1);
#if SMOOTH_ROWS
    const real_t sharpness = (easy ? R(2) : R(0.25)) * s->shooting.sharpness;
    s->shooting.sharpness = clip(sharpness, smooth_sharpness[0], smooth_sharpness[1]);
#else
    s->shooting.penalty = clip((easy ? R(0.5) : R(4)) * s->shooting.penalty, barrier_weight[1], barrier_weight[0]);
#endif
}
#endif

#if NG > NT
#if !BARRIER_ROWS
/* What a violation of one scale of row m costs by its penalty: the unit of its multiplier. */
static real_t multiplier_unit(const solver_t *s, int m)
{
    return row_penalty(s) * SQRT(row_weight[m]);
}

#endif
/* The dual update: mu_m = psi_m'(v_m), in size at most ``most`` of its units more than before, so that no single sample
 * has a lasting effect. Terminal rows whose multipliers the model yields keep them. */
static void update_rows(solver_t *s, real_t most)
{
    real_t value[NG], slope, curvature;
#if BARRIER_ROWS
    (void)most; /* the slope of a barrier is bounded by its margin */
#endif
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
#if NT
        if (terminal_index[m] >= 0) {
            continue;
        }
#endif
        (void)row_term(s, m, value[m], &slope, &curvature);
#if BARRIER_ROWS
        s->row[m] = clip(slope, (ROW_LOWER(s, m) > -INF) ? -INF : R(0), (ROW_UPPER(s, m) < INF) ? INF : R(0));
#else
        const real_t size = FABS(s->row[m]) + most * multiplier_unit(s, m);
        s->row[m] = clip(slope, -size, size);
#endif
    }
}
#endif
#endif
