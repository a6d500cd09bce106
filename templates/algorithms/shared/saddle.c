/* Saddles. Where the slope of the dynamics with respect to a control vanishes (u^2 at 0), the control is idle: no step
 * of an iteration moves it, and a plan may satisfy the conditions of optimality although its cost falls to both sides.
 * A probe leaves such a plan. At each node it sets idle controls to the one of a few values with the least Hamiltonian
 *
 *     l_k(x_k, u) + lam_{k+1}' Phi(x_k, u),
 *
 * and the plan moves towards them as far as its cost falls. */

#if HAS_QP
/* Returns 1 if component i of (x, u) at node k has almost no effect on the other variables, by the last
 * linearisation. */
static int is_idle(const solver_t *s, int k, int i)
{
    if (!(FABS((i < NX) ? s->step.dx[k][i] : s->step.du[k][i - NX]) <= FACTOR_IDLE_STEP * z_scale[i])) {
        return 0;
    }
    for (int l = 0; l < NX; l++) {
        if (FABS(s->node[k].S[l][i]) > idle_slope[l * NZ + i]) {
            return 0;
        }
    }
    return 1;
}
#else
/* Returns 1 if component i of (x, u) at node k has almost no effect on the other variables, by a small change of it. */
static int is_idle(solver_t *s, int k, int i)
{
    real_t here[NX], there[NX], *z = (i < NX) ? &s->x[k][i] : &s->u[k][i - NX];
    const real_t from = *z, h = FACTOR_IDLE_CHANGE * z_scale[i];
    interval_value(s, k, here);
    *z = (i >= NX && from + h > control_upper(s, k, i - NX)) ? from - h : from + h;
    interval_value(s, k, there);
    *z = from;
    for (int l = 0; l < NX; l++) {
        if (FABS(there[l] - here[l]) > R(2) * h * idle_slope[l * NZ + i]) {
            return 0;
        }
    }
    return 1;
}
#endif

/* Returns 1 if component i is idle at some node and a finite change of it would lower the cost beyond rounding, by the
 * multipliers of the states that it moves. */
static int is_wanted(const real_t *lam, int i)
{
    real_t worth = R(0);
    for (int l = 0; l < NX && idle_slope[i] >= R(0); l++) {
        if (idle_slope[l * NZ + i] < INF) {
            worth += FABS(lam[l]) * idle_slope[l * NZ + i] * z_scale[i];
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

/* Moves the controls of node k along a direction, in their scales, to the least Hamiltonian. */
static void probe_along(solver_t *s, int k, const real_t *lam, const real_t *direction)
{
    real_t from[NU], best[NU], least = hamiltonian(s, k, lam);
    (void)memcpy(from, s->u[k], sizeof from);
    (void)memcpy(best, from, sizeof best);
    for (int n = 0; n < 2 * PROBES; n++) {
        const real_t size = (n % 2 == 0) ? probe_size[n / 2] : -probe_size[n / 2];
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = from[j] + size * direction[j] * z_scale[NX + j];
            s->u[k][j] = safe_value(s, k, j);
        }
        const real_t value = hamiltonian(s, k, lam);
        if (value < least) {
            least = value;
            (void)memcpy(best, s->u[k], sizeof best);
        }
    }
    (void)memcpy(s->u[k], best, sizeof best);
}

#if IDLE_STATES
/* Returns 1 if the Hamiltonian of node k is less at another value of state i. */
static int state_asks(solver_t *s, int k, int i, const real_t *lam)
{
    const real_t from = s->x[k][i], here = hamiltonian(s, k, lam);
    int asks = 0;
    for (int n = 0; n < 2 * PROBES; n++) {
        s->x[k][i] = from + ((n % 2 == 0) ? probe_size[n / 2] : -probe_size[n / 2]) * z_scale[i];
        asks |= hamiltonian(s, k, lam) < here - TOL_MERIT_ROUNDING * (FABS(here) + cost_size[0]);
    }
    s->x[k][i] = from;
    return asks;
}

/* Records whether the Hamiltonian of node k falls with an idle state that the controls reach. */
static void ask_states(solver_t *s, int k, const real_t *lam)
{
    for (int i = 0; i < NX && k > 0 && !s->saddle.asked; i++) {
        s->saddle.asked = is_wanted(lam, i) && is_idle(s, k, i) && state_asks(s, k, i, lam);
    }
}
#endif

/* Moves the idle controls of node k to a lower cost. */
static void probe_node(solver_t *s, int k, const real_t *lam)
{
    int idle[NU];
    real_t direction[NU] = {R(0)};
    for (int j = 0; j < NU; j++) {
        idle[j] = is_wanted(lam, NX + j) && is_idle(s, k, NX + j);
    }
    for (int j = 0; j < NU; j++) {
        if (!idle[j]) {
            continue;
        }
        direction[j] = R(1);
        probe_along(s, k, lam, direction);
        if (PARTNERS) {
            if (idle_partner[j] >= 0) { /* also moves the control by which control j is multiplied */
                direction[idle_partner[j]] = R(1);
                probe_along(s, k, lam, direction);
                direction[idle_partner[j]] = -R(1);
                probe_along(s, k, lam, direction);
                direction[idle_partner[j]] = R(0);
            }
        }
        direction[j] = R(0);
    }
    if (IDLE_STATES) {
        ask_states(s, k, lam);
    }
}

#if HAS_QP
/* Returns 1 if a component is idle whose change would lower the cost. */
static int may_be_at_saddle(const solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int i = first_idle(); i < NZ; i++) {
            if (is_wanted(s->lam[k + 1], i) && is_idle(s, k, i)) {
                return 1;
            }
        }
    }
    return 0;
}
#endif

#if NODES
/* Moves the idle controls of all nodes. */
static void probe_plan(solver_t *s)
{
    if (IDLE_STATES) {
        s->saddle.asked = 0;
    }
    for (int k = 0; k < N; k++) {
        probe_node(s, k, s->lam[k + 1]);
    }
}
#else
/* Moves the idle controls of all nodes. */
static void probe_plan(solver_t *s)
{
    real_t lam[NX], next[NX], g[NZ], own[NZ];
    if (IDLE_STATES) {
        s->saddle.asked = 0;
    }
    start_adjoint(s, ESTIMATE, lam);
    for (int k = N - 1; k >= 0; k--) {
        (void)memcpy(next, lam, sizeof next);
        carry_back(s, k, ESTIMATE, lam, g, own);
        probe_node(s, k, next);
    }
}
#endif

#if HAS_QP
/* Simulates the states from x_0 with the new controls, less the gaps that the plan had before the probe. */
static void follow_controls(solver_t *s)
{
    const saddle_t *q = &s->saddle;
    real_t x[NX], u[NU], before[NX], now[NX];
    if (AUGMENTED) {
        follow_augmented(s);
    }
    for (int k = 0; k < N; k++) {
        (void)memcpy(x, s->x[k], sizeof x);
        (void)memcpy(u, s->u[k], sizeof u);
        interval_value(s, k, now);
        (void)memcpy(s->x[k], q->x[k], sizeof x);
        (void)memcpy(s->u[k], q->u[k], sizeof u);
        interval_value(s, k, before);
        (void)memcpy(s->x[k], x, sizeof x);
        (void)memcpy(s->u[k], u, sizeof u);
        for (int i = 0; i < NX; i++) {
            s->x[k + 1][i] = q->x[k + 1][i] + (now[i] - before[i]);
        }
    }
}
#else
/* Simulates the states from x_0 with the new controls. */
static void follow_controls(solver_t *s)
{
    if (AUGMENTED) {
        follow_augmented(s);
    }
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
}
#endif

#if HARD_ROWS
/* Returns the sum of the violations of hard rows, in the scales of their terms. */
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
#endif

static real_t cost_of_plan(const solver_t *s)
{
    if (SOFT_ROWS > 0) {
        return nodal_cost(s) + soft_penalties(s);
    }
    return nodal_cost(s);
}

/* Returns 1, and records the plan as the best one, if it costs less than the best one by `gain` and violates no more,
 * or if it violates less. */
static int is_better(solver_t *s, real_t gain)
{
    saddle_t *q = &s->saddle;
    const real_t cost = cost_of_plan(s);
    int better = isfinite(cost) && cost < q->cost - gain;
#if HARD_ROWS
    const real_t out = hard_violation(s);
    const int nearer = out < FACTOR_SADDLE_NEARER * q->violation && q->violation > TOL_MERIT_ROUNDING;
    better = (better && out <= q->violation + TOL_MERIT_ROUNDING) || (isfinite(cost) && nearer);
    q->violation = better ? out : q->violation;
#endif
    q->cost = better ? cost : q->cost;
    return better;
}

/* Multiplies the difference between the controls and those before the probe by a factor. */
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

/* Takes the fraction 1, 1/2, 1/4, ... of the probe with the best plan. Returns 0 if none is better than the plan before
 * it. */
static int take_probe(solver_t *s)
{
    real_t gain = FACTOR_SADDLE_GAIN * FABS(s->saddle.cost);
    int better = 0;
    enlarge(&gain, least_cost());
    follow_controls(s);
    for (int n = 0; n < PROBE_PARTS; n++) {
        if (is_better(s, gain)) {
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

/* Returns 1 if a control differs from that before the probe. */
static int has_moved(const solver_t *s)
{
    int moved = 0;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            moved |= s->u[k][j] != s->saddle.u[k][j]; /* exact comparison: the probe has found another value */
        }
    }
    return moved;
}

#if IDLE_STATES
/* Shifts control `pushed`, or all of them (NU), to one side at all nodes, from the plan before the probe. This serves a
 * state that controls drive and that is idle, such as the speed of a propeller at rest. */
static void push_control(solver_t *s, int pushed, real_t size)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t part = (drives_idle[j] && (j == pushed || pushed == NU)) ? size : R(0);
            s->u[k][j] = s->saddle.u[k][j] + part * z_scale[NX + j];
            s->u[k][j] = safe_value(s, k, j);
        }
    }
}

/* Takes the first push that leads to a better plan: of one control or of all, to either side. */
static int take_push(solver_t *s)
{
    for (int pushed = NU; pushed >= 0; pushed--) {
        for (int side = -1; side <= 1; side += 2) {
            push_control(s, pushed, R(side));
            if (has_moved(s) && take_probe(s)) {
                return 1;
            }
        }
    }
    return 0;
}
#endif

/* Leaves a saddle. Returns 1 if the plan has moved. */
static int leave_saddle(solver_t *s)
{
    saddle_t *q = &s->saddle;
    q->saved = R(0);
    if (HAS_QP && !may_be_at_saddle(s)) {
        return 0;
    }
    (void)memcpy(q->x, s->x, sizeof q->x);
    (void)memcpy(q->u, s->u, sizeof q->u);
    if (!HAS_QP) {
        /* the plan of an algorithm without a QP may have large gaps */
        follow_controls(s);
    }
    const real_t cost = cost_of_plan(s);
    q->cost = cost;
    if (HARD_ROWS) {
        q->violation = hard_violation(s);
    }
    probe_plan(s);
    int left = has_moved(s) && take_probe(s);
    if (IDLE_STATES) {
        left = left || (q->asked && take_push(s));
    }
    if (!left) {
        (void)memcpy(s->x, q->x, sizeof q->x);
        (void)memcpy(s->u, q->u, sizeof q->u);
        return 0;
    }
    q->saved = (q->cost < cost) ? (cost - q->cost) / FABS(cost) : R(1); /* 1: the plan violates less */
    return 1;
}
