/* The relaxation: hard rows of a QP without a solution get a penalty. */

/* Returns how much the cost may change in the scales of its variables, by their largest slope and curvature. */
static real_t cost_scale(const solver_t *s, const real_t *size)
{
    real_t most = R(0);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NZ; i++) {
            enlarge(&most, s->node[k].g[i] * size[i]);
            enlarge(&most, curvature_at(s, k, i) * size[i] * size[i]);
        }
    }
    for (int i = 0; i < NX; i++) {
        enlarge(&most, s->terminal.g[i] * size[i]);
        enlarge(&most, curvature_at(s, N, i) * size[i] * size[i]);
    }
    return size_or(most, cost_size[0]);
}

/* Computes the scales of states and controls, and from them those of the rows. */
static void scale_rows(solver_t *s, real_t *size)
{
    state_scales(s, size);
    control_sizes(s, size + NX);
    (void)memset(s->row_scale, 0, sizeof s->row_scale);
    for (int m = 0; m < NG; m++) {
        enlarge(&s->row_scale[row_id(m)], size_or(row_terms(s, m, size), row_magnitude[row_id(m)]));
    }
}

/* Returns 1 if all hard rows hold up to rounding. */
static int hard_rows_hold(const solver_t *s)
{
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m)) {
            continue;
        }
        if (!(FABS(row_excess(s, m, R(0))) <= TOL_STEP * s->row_scale[row_id(m)])) {
            return 0;
        }
    }
    return 1;
}

/* Sets the prices of the hard rows. */
static void price_rows(solver_t *s)
{
    real_t size[NZ];
    scale_rows(s, size);
    s->relaxation = FACTOR_RELAXATION_WEIGHT * cost_scale(s, size);
}

/* Solves a QP that is infeasible or has been given up again with its hard rows relaxed, at the weight set in the
 * options. If all of them hold, its solution is that of the QP. */
static status_t relax_rows(solver_t *s, status_t why)
{
    status_t status;
    price_rows(s);
    status = run_qp(s);
    s->relaxation = INF;
    if (why != INFEASIBLE && (status != OK || hard_rows_hold(s))) {
        return (status == OK) ? OK : why;
    }
    name_violation(s);
    return (status == OK) ? RELAXED : status;
}

/* Sets the price of rows on states: its full value at node N, less by `ratio` at every node before. */
static void set_price(solver_t *s, real_t ratio)
{
    s->price[N] = R(1);
    for (int k = N - 1; k >= 0; k--) {
        s->price[k] = s->price[k + 1] * clip(ratio, least_price[0], R(1));
    }
}

static void relaxation_on_reset(solver_t *s)
{
    if (PRICED_ROWS) {
        set_price(s, R(1));
        s->rises = 0;
        s->outside = R(0);
    }
}

static void relaxation_before_solve(solver_t *s)
{
    relaxation_on_reset(s);
}

/* Returns the largest violation of a hard row of node 1, which the plant reaches next, relative to its scale. */
static real_t next_violation(const solver_t *s)
{
    real_t most = R(0);
    for (int m = 0; m < NG && row_node(m) <= 1; m++) {
        if (row_node(m) == 1 && !row_is_soft(s, m)) {
            enlarge(&most, row_excess(s, m, R(0)) / s->row_scale[row_id(m)]);
        }
    }
    return most;
}

/* Lowers the price at early nodes, then raises it again. */
static void sweep_price(solver_t *s)
{
    const real_t ratio = s->price[N - 1];
    set_price(s, s->rises ? ratio / price_change[0] : ratio * price_change[0]);
    s->rises = s->rises ? s->price[N - 1] < R(1) : s->price[N - 1] <= least_price[0];
}

/* Changes prices while samples stay RELAXED and the violation does not fall: violations at early nodes become cheaper,
 * then more expensive again. The way back inside may lead through larger violations, and the least sum of them over a
 * short horizon may be to stay outside for ever; where early violations are cheap, a plan may rest outside although it
 * need not. The price at the last node stays. A relaxed QP that has been given up may have a solution at another price,
 * as equal prices make its vertices coincide. */
static status_t relaxation_after_feedback(solver_t *s, status_t status)
{
    if (PRICED_ROWS) {
        const real_t before = s->outside;
        if (status == OK) {
            s->outside = R(0);
            s->rises = 0;
            if (s->price[N - 1] < R(1)) {
                set_price(s, s->price[N - 1] * price_change[1]);
            }
        } else if (is_given_up(status)) {
            sweep_price(s);
        } else if (status == RELAXED) {
            s->outside = next_violation(s);
            if (!(s->outside < FACTOR_RELAXATION_FALLS * before)) {
                sweep_price(s);
            }
        }
    }
    return status;
}

static status_t relaxation_after_qp(solver_t *s, status_t status)
{
    if (is_given_up(status)) {
        return relax_rows(s, status);
    }
    return status;
}
