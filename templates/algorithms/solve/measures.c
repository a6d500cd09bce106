/* Two measures of a point, and their scales:
 *
 *     violation = sum of gaps, of the residual of x_0 and of row violations, each in the scale of its state or row,
 *     cost      = cost of the nodes, and the penalties of violated rows that have one. */

/* Returns the same component of the plan. */
static inline real_t point_at(const solver_t *s, int k, int i)
{
    return (i < NX) ? s->x[k][i] : s->u[k][i - NX];
}

/* Computes the measures of the present iterate, without derivatives. */
static measures_t measure(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    measures_t at = {R(0), R(0)};
    for (int i = 0; i < NX; i++) {
        if (!is_measured[i] && !is_accumulator[i]) {
            continue;
        }
        at.violation += FABS(s->x[0][i] - s->xhat[i]) / size_or(q->state_scale[i], z_scale[i]);
    }
    for (int k = 0; k < N; k++) {
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            at.violation += FABS(x_next[i] - s->x[k + 1][i]) / size_or(q->state_scale[i], z_scale[i]);
        }
    }
    real_t value[NG];
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t v = outside(s, m, value[m]);
        if (row_is_soft(s, m)) {
            at.cost += soft_penalty(s, m, v);
            continue;
        }
        at.violation += v / size_or(s->row_scale[row_id(m)], row_magnitude[row_id(m)]);
    }
    at.cost += nodal_cost(s);
    return at;
}

/* Raises a scale to a size that is more than twice as large. Returns 1 if it changes. */
static int raise_scale(real_t *scale, real_t size)
{
    if (!(size > R(2) * *scale) || !isfinite(size)) {
        return 0;
    }
    *scale = size;
    return 1;
}

static inline real_t *gradient_of(solver_t *s, int k)
{
    return (k < N) ? s->node[k].g : s->terminal.g;
}

/* Enlarges the sizes of the states. The size of a state is at least what a control changes in an interval, and what a
 * hard bound demands, because the value and the step of a state near 0 may be rounding errors. */
static void enlarge_by_reach(const solver_t *s, real_t *size)
{
    real_t u[NU];
    control_sizes(s, u);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NX; i++) {
            for (int j = 0; j < NU; j++) {
                enlarge(&size[i], s->node[k].S[i][NX + j] * u[j]);
            }
        }
    }
    for (int m = 0; m < NG; m++) {
        if (row_is_state(m)) {
            enlarge(&size[row_index(m)], clip(R(0), row_lower(s, m), row_upper(s, m)));
        }
    }
}

/* Updates the scales of the hard rows: the largest magnitude of the terms of a linearised row and of its finite bounds.
 * Returns 1 if one of them changes. */
static int update_row_scales(solver_t *s, const real_t *size)
{
    int grew = 0;
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m)) {
            continue;
        }
        real_t *scale = &s->row_scale[row_id(m)];
        grew |= raise_scale(scale, row_terms(s, m, size));
        grew |= raise_scale(scale, FABS(row_lower(s, m)));
        grew |= raise_scale(scale, FABS(row_upper(s, m)));
    }
    return grew;
}

/* Updates the scales of states and rows: largest magnitudes over the horizon at the present point and of the present
 * step. They only grow; if one does, the measures of earlier points are no longer comparable, and the filter is
 * cleared. cost_unit is how much the cost may change along the horizon: the largest |g_i| |z_i|, at least that of its
 * scale. */
static void update_scales(solver_t *s)
{
    sqp_t *q = &s->sqp;
    real_t size[NZ] = {0};
    int grew = 0;
    q->cost_unit = cost_size[0];
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            enlarge(&q->cost_unit, gradient_of(s, k)[i] * point_at(s, k, i));
            enlarge(&size[i], point_at(s, k, i));
            enlarge(&size[i], *step_at(&s->step, k, i));
        }
    }
    enlarge_by_reach(s, size);
    for (int i = 0; i < NX; i++) {
        grew |= raise_scale(&q->state_scale[i], size[i]);
    }
    if (HARD_ROWS) {
        grew |= update_row_scales(s, size);
    }
    if (grew) {
        q->entries = 0;
        q->most_violation = INF;
    }
}
