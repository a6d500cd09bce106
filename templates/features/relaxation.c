/* Hard rows of a QP without a solution are relaxed. */

/* How much the cost may change in the scales of its variables: the largest slope and curvature of a variable. */
static real_t cost_scale(const solver_t *s, const real_t *size)
{
    real_t most = R(0);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NZ; i++) {
            enlarge(&most, s->node[k].g[i] * size[i]);
            enlarge(&most, HESSIAN(s, k)[i][i] * size[i] * size[i]);
        }
    }
    for (int i = 0; i < NX; i++) {
        enlarge(&most, s->terminal.g[i] * size[i]);
        enlarge(&most, s->hessian.Q_N[i][i] * size[i] * size[i]);
    }
    return size_or(most, cost_size[0]);
}

/* Scales of states and controls, and those of the rows, which follow from them. */
static void scale_rows(solver_t *s, real_t *size)
{
    state_scales(s, size);
    control_sizes(s, size + NX);
    memset(s->row_scale, 0, sizeof s->row_scale);
    for (int m = 0; m < NG; m++) {
        enlarge(&s->row_scale[row_id(m)], size_or(row_terms(s, m, size), row_magnitude[row_id(m)]));
    }
}

/* Returns 1 if all hard rows hold up to rounding. */
static int nothing_relaxed(const solver_t *s)
{
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(m)) {
            continue;
        }
        if (!(FABS(row_excess(s, m, R(0))) <= TOL_STEP * s->row_scale[row_id(m)])) {
            return 0;
        }
    }
    return 1;
}

/* Hard rows cost their price. */
static void price_rows(solver_t *s)
{
    real_t size[NZ];
    scale_rows(s, size);
    s->relaxation = relaxation_weight[0] * cost_scale(s, size);
}

/* Solves a QP that is infeasible or has been given up again with its hard rows relaxed, at the weight set in the options.
 * If all of them hold, its solution is that of the QP. */
static status_t relax_rows(solver_t *s, status_t why)
{
    status_t status;
    price_rows(s);
    status = run_qp(s);
    s->relaxation = INF;
    if (why != INFEASIBLE && (status != OK || nothing_relaxed(s))) {
        return (status == OK) ? OK : why;
    }
    name_violation(s);
    return (status == OK) ? RELAXED : status;
}

static void relaxation_on_reset(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        s->price[k] = R(1);
    }
}

static void relaxation_before_solve(solver_t *s)
{
    relaxation_on_reset(s);
}

/* While rows stay relaxed, violations at early nodes become cheaper: the way back inside may lead through larger ones, and
 * where all cost the same, the least sum of them over a short horizon may be to stay outside for ever. Towards the end of
 * the horizon the price stays, so that no plan remains outside. */
static status_t relaxation_after_feedback(solver_t *s, status_t status)
{
    const int recovers = status == OK && s->price[N - 1] < R(1);
    if (status == RELAXED || recovers) {
        const real_t ratio = s->price[N - 1] * (recovers ? R(1) / price_fall[0] : price_fall[0]);
        for (int k = N - 1; k >= 0; k--) {
            s->price[k] = s->price[k + 1] * clip(ratio, least_price[0], R(1));
        }
    }
    return status;
}

/* Rows stay relaxed until the price has recovered: hard ones would forbid the way back as soon as a plan meets them. */
static void relaxation_before_qp(solver_t *s)
{
    if (s->price[N - 1] < R(1)) {
        price_rows(s);
    }
}

static status_t relaxation_after_qp(solver_t *s, status_t status)
{
    if (!(s->relaxation < INF)) {
        return is_given_up(status) ? relax_rows(s, status) : status;
    }
    s->relaxation = INF;
    if (status != OK) {
        return run_qp(s);
    }
    if (nothing_relaxed(s)) {
        return OK;
    }
    name_violation(s);
    return RELAXED;
}
