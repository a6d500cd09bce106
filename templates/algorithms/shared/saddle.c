/* Saddles. Where the slope of the dynamics with respect to a control vanishes (u^2 at 0), no step of an iteration moves
 * it, and a plan may satisfy the conditions of optimality although its cost falls to both sides. A probe leaves such a
 * plan: idle controls take, node by node, the value among a few with the least Hamiltonian
 *
 *     l_k(x_k, u) + lam_{k+1}' Phi(x_k, u),
 *
 * and the plan goes as far towards them as lowers its cost. */

#if HAS_QP
/* Returns 1 if control j of node k moves next to nothing, by the last linearisation. */
static int is_idle(const solver_t *s, int k, int j)
{
    if (!(FABS(s->step.du[k][j]) <= FACTOR_IDLE_STEP * z_scale[NX + j])) {
        return 0;
    }
    for (int i = 0; i < NX; i++) {
        if (FABS(s->node[k].S[i][NX + j]) > idle_slope[i * NU + j]) {
            return 0;
        }
    }
    return 1;
}
#else
/* Returns 1 if control j of node k moves next to nothing, by a small change of it. */
static int is_idle(solver_t *s, int k, int j)
{
    real_t here[NX], there[NX];
    const real_t u = s->u[k][j], h = FACTOR_IDLE_STEP * z_scale[NX + j];
    if (idle_slope[j] < R(0)) {
        return 0;
    }
    interval_value(s, k, here);
    s->u[k][j] = (u + h > control_upper(s, k, j)) ? u - h : u + h;
    interval_value(s, k, there);
    s->u[k][j] = u;
    for (int i = 0; i < NX; i++) {
        if (FABS(there[i] - here[i]) > R(2) * h * idle_slope[i * NU + j]) {
            return 0;
        }
    }
    return 1;
}
#endif

/* Returns 1 if the states that control j moves by a finite change are worth it, beyond rounding. */
static int is_wanted(const real_t *lam, int j)
{
    real_t worth = R(0);
    for (int i = 0; i < NX; i++) {
        if (idle_slope[i * NU + j] < INF) {
            worth += FABS(lam[i]) * idle_slope[i * NU + j] * z_scale[NX + j];
        }
    }
    return worth > TOL_ZERO * cost_size[0];
}

static real_t hamiltonian(const solver_t *s, int k, const real_t *lam)
{
    real_t x_next[NX], sum = R(0);
    if (HAS_PATH_COST) {
        PATH_COST(s, k, &sum);
    }
    interval_value(s, k, x_next);
    for (int i = 0; i < NX; i++) {
        sum += lam[i] * x_next[i];
    }
    return sum;
}

/* Moves idle control j of node k, and with it its partner by `with` of its own scale, to the value with the least
 * Hamiltonian. */
static void probe_control(solver_t *s, int k, int j, const real_t *lam, real_t with)
{
    const int other = (idle_partner[j] < 0) ? j : idle_partner[j];
    const real_t from = s->u[k][j], of_other = s->u[k][other];
    real_t least = hamiltonian(s, k, lam), best = from, of_best = of_other;
    for (int n = 0; n < 2 * PROBES; n++) {
        const real_t size = (n % 2 == 0) ? probe_size[n / 2] : -probe_size[n / 2];
        s->u[k][other] = of_other + size * with * z_scale[NX + other];
        s->u[k][other] = safe_value(s, k, other);
        s->u[k][j] = from + size * z_scale[NX + j];
        s->u[k][j] = safe_value(s, k, j);
        const real_t value = hamiltonian(s, k, lam);
        if (value < least) {
            least = value;
            best = s->u[k][j];
            of_best = s->u[k][other];
        }
    }
    s->u[k][other] = of_best;
    s->u[k][j] = best;
}

/* Moves the idle controls of node k that the cost wants to be moved. */
static void probe_node(solver_t *s, int k, const real_t *lam)
{
    int idle[NU];
    for (int j = 0; j < NU; j++) {
        idle[j] = is_wanted(lam, j) && is_idle(s, k, j);
    }
    for (int j = 0; j < NU; j++) {
        if (idle[j]) {
            probe_control(s, k, j, lam, R(0));
        }
        if (PARTNERS) {
            if (idle[j] && idle_partner[j] >= 0) {
                probe_control(s, k, j, lam, R(1));
                probe_control(s, k, j, lam, -R(1));
            }
        }
    }
}

#if NODES
/* Returns 1 if there are idle controls that the cost wants to be moved. */
static int may_be_at_saddle(const solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            if (is_wanted(s->lam[k + 1], j) && is_idle(s, k, j)) {
                return 1;
            }
        }
    }
    return 0;
}

/* Moves the idle controls of all nodes. */
static void probe_plan(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        probe_node(s, k, s->lam[k + 1]);
    }
}
#else
/* Whether controls are idle is found node by node. */
static int may_be_at_saddle(const solver_t *s)
{
    return 1;
}

/* Moves the idle controls of all nodes. */
static void probe_plan(solver_t *s)
{
    real_t lam[NX], next[NX], g[NZ], own[NZ];
    start_adjoint(s, ESTIMATE, lam);
    for (int k = N - 1; k >= 0; k--) {
        memcpy(next, lam, sizeof next);
        carry_back(s, k, ESTIMATE, lam, g, own);
        probe_node(s, k, next);
    }
}
#endif

#if HAS_QP
/* The states to which the controls lead from x_0, less the gaps that the plan before the probe has. */
static void follow_controls(solver_t *s)
{
    const saddle_t *q = &s->saddle;
    real_t x[NX], u[NU], before[NX], now[NX];
    if (INNER) {
        follow_inner(s);
    }
    for (int k = 0; k < N; k++) {
        memcpy(x, s->x[k], sizeof x);
        memcpy(u, s->u[k], sizeof u);
        interval_value(s, k, now);
        memcpy(s->x[k], q->x[k], sizeof x);
        memcpy(s->u[k], q->u[k], sizeof u);
        interval_value(s, k, before);
        memcpy(s->x[k], x, sizeof x);
        memcpy(s->u[k], u, sizeof u);
        for (int i = 0; i < NX; i++) {
            s->x[k + 1][i] = q->x[k + 1][i] + (now[i] - before[i]);
        }
    }
}
#else
/* The states to which the controls lead from x_0. */
static void follow_controls(solver_t *s)
{
    if (INNER) {
        follow_inner(s);
    }
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
}
#endif

/* Sum of the violations of hard rows, in the scales of their terms. */
static real_t hard_violation(const solver_t *s)
{
    real_t value[NG], sum = R(0);
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (!row_is_soft(s, m)) {
            sum += outside(s, m, value[m]) / row_magnitude[row_id(m)];
        }
    }
    return sum;
}

static real_t cost_of_plan(const solver_t *s)
{
    real_t cost = nodal_cost(s);
    if (SOFT_ROWS > 0) {
        cost += soft_penalties(s);
    }
    return cost;
}

/* Returns 1 if the plan violates less than these measures, or costs less by this much and violates no more, and takes
 * its own. */
static int is_better(const solver_t *s, real_t *cost, real_t *violation, real_t gain)
{
    const real_t at = cost_of_plan(s);
    real_t out = R(0);
    if (NG > 0) {
        out = hard_violation(s);
    }
    const int nearer = out < FACTOR_SADDLE_NEARER * *violation && *violation > TOL_MERIT_ROUNDING;
    const int cheaper = at < *cost - gain;
    if (!isfinite(at) || !(nearer || (cheaper && out <= *violation + TOL_MERIT_ROUNDING))) {
        return 0;
    }
    *cost = at;
    *violation = out;
    return 1;
}

/* The controls move away from those before the probe, or towards them, by this factor. */
static void stretch_probe(solver_t *s, real_t factor)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t from = s->saddle.u[k][j];
            s->u[k][j] = from + factor * (s->u[k][j] - from);
            s->u[k][j] = safe_value(s, k, j);
        }
    }
    follow_controls(s);
}

/* Takes the part 1, 1/2, 1/4, ... of the probe with the best plan. Returns 0 if none is better than the plan before
 * it. */
static int take_probe(solver_t *s, real_t cost, real_t violation)
{
    real_t gain = FACTOR_SADDLE_GAIN * FABS(cost);
    int better = 0;
    enlarge(&gain, least_cost());
    follow_controls(s);
    for (int n = 0; n < PROBE_PARTS; n++) {
        if (is_better(s, &cost, &violation, gain)) {
            gain = R(0);
            better = 1;
        } else if (better) {
            break;
        }
        stretch_probe(s, R(0.5));
    }
    if (better) {
        stretch_probe(s, R(2));
    }
    return better;
}

/* Leaves a saddle. Returns 1 if the plan has moved. */
static int leave_saddle(solver_t *s)
{
    saddle_t *q = &s->saddle;
    real_t violation = R(0);
    q->saved = R(0);
    if (!may_be_at_saddle(s)) {
        return 0;
    }
    memcpy(q->x, s->x, sizeof q->x);
    memcpy(q->u, s->u, sizeof q->u);
    if (!HAS_QP) { /* whose plan may have large gaps */
        follow_controls(s);
    }
    const real_t cost = cost_of_plan(s);
    if (NG > 0) {
        violation = hard_violation(s);
    }
    probe_plan(s);
    if (!take_probe(s, cost, violation)) {
        memcpy(s->x, q->x, sizeof q->x);
        memcpy(s->u, q->u, sizeof q->u);
        return 0;
    }
    const real_t less = cost - cost_of_plan(s);
    q->saved = (less > R(0)) ? less / FABS(cost) : R(1); /* 1: it violates less */
    return 1;
}
