/* Levels of an iteration: what is evaluated anew while matrices and factors of the last level A are kept.
 * A: everything. B: dynamics, rows and the gradient of the cost. C: what level B evaluates, and the gradient of the
 * Lagrangian, by one adjoint sweep of every interval. D: nothing, the data follow the model of the QP. */

/* z_k - z_k of the last evaluation; the terminal node has no controls. */
static void plan_change(const solver_t *s, int k, real_t *dz)
{
    for (int i = 0; i < NX; i++) {
        dz[i] = s->x[k][i] - s->levels.x[k][i];
    }
    for (int j = 0; j < NU; j++) {
        dz[NX + j] = (k < N) ? s->u[k][j] - s->levels.u[k][j] : R(0);
    }
}

/* h += J dz, n entries of dz. */
static void follow_rows(real_t *h, const real_t *J, const real_t *dz, int rows, int n)
{
    for (int j = 0; j < rows; j++) {
        for (int i = 0; i < n; i++) {
            h[j] += J[j * n + i] * dz[i];
        }
    }
}

/* g += (J - J_A)' mu, n entries of g. */
static void correct_rows(real_t *g, const real_t *J, const real_t *J_A, const real_t *mu, int rows, int n)
{
    for (int j = 0; j < rows; j++) {
        for (int i = 0; i < n; i++) {
            g[i] += (J[j * n + i] - J_A[j * n + i]) * mu[j];
        }
    }
}

/* g += Q dz, n entries; only the lower triangle of Q is stored, in rows of ld numbers. */
static void follow_gradient(real_t *g, const real_t *Q, const real_t *dz, int n, int ld)
{
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            g[i] += Q[(i < j) ? j * ld + i : i * ld + j] * dz[j];
        }
    }
}

/* Level D of node k: b, g and h as the model of the QP predicts them. */
static void follow_node(solver_t *s, int k)
{
    node_t *node = &s->node[k];
    real_t dz[NZ], next[NZ];
    plan_change(s, k, dz);
    plan_change(s, k + 1, next);
    for (int i = 0; i < NX; i++) {
        node->b[i] -= next[i];
        for (int j = 0; j < NZ; j++) {
            node->b[i] += node->S[i][j] * dz[j];
        }
    }
    follow_gradient(node->g, HESSIAN(s, k)[0], dz, NZ, NZ);
    if (PROXIMAL) {
        /* a limit of steps, and no part of the cost */
        for (int i = 0; i < NZ; i++) {
            node->g[i] -= proximal[i] * dz[i];
        }
    }
    if (NH > 0) {
        follow_rows(node->h, node->J[0], dz, NH, NZ);
    }
}

/* Level D: the changes of the plan since the last evaluation, in the model of the QP. */
static void follow_plan(solver_t *s)
{
    real_t dz[NZ];
    for (int k = 0; k < N; k++) {
        follow_node(s, k);
    }
    plan_change(s, N, dz);
    if (TERMINAL_BLOCK) {
        follow_gradient(s->terminal.g, s->hessian.Q_N[0], dz, NX, NX);
    }
    if (NH_N > 0) {
        follow_rows(s->terminal.h, s->terminal.J[0], dz, NH_N, NX);
    }
    if (NE > 0) {
        follow_rows(s->coupled.r, s->coupled.J_N[0], dz, NE, NX);
        plan_change(s, 0, dz);
        follow_rows(s->coupled.r, s->coupled.J_0[0], dz, NE, NX);
    }
}

/* g += ([A B]_k - S)' lam_{k+1}: what the derivatives of level A miss in the gradient of the Lagrangian. */
static void correct_gradient(solver_t *s, int k)
{
    node_t *node = &s->node[k];
    real_t pulled[NZ];
    INTEGRATOR_ADJOINT(s, k, s->lam[k + 1], pulled);
    for (int i = 0; i < NZ; i++) {
        for (int j = 0; j < NX; j++) {
            pulled[i] -= node->S[j][i] * s->lam[k + 1][j];
        }
        node->g[i] += pulled[i];
    }
}

/* Level B or C of node k. */
static void refresh_node(solver_t *s, int k, int level)
{
    node_t *node = &s->node[k];
    real_t x_next[NX];
#if IMPLICIT
    interval_leaving(s, k, x_next, node->left);
#else
    interval_value(s, k, x_next);
#endif
    for (int i = 0; i < NX; i++) {
        node->b[i] = x_next[i] - s->x[k + 1][i];
    }
    (void)memset(node->g, 0, sizeof node->g);
    PATH_GRADIENT(s, k, node->g);
    if (level == LEVEL_C) {
        correct_gradient(s, k);
    }
    if (NH > 0) {
        real_t J[NH][NZ] = {{R(0)}}, mu[NH];
        PATH_ROWS(s, k, node->h, J);
        if (level == LEVEL_C) {
            path_multipliers(s, k, mu);
            correct_rows(node->g, J[0], node->J[0], mu, NH, NZ);
        }
    }
}

/* Level B or C of the terminal node. */
static void refresh_terminal(solver_t *s, int level)
{
    terminal_t *terminal = &s->terminal;
    (void)memset(terminal->g, 0, sizeof terminal->g);
    TERMINAL_GRADIENT(s, terminal->g);
    if (NH_N > 0) {
        real_t J[NH_N][NX] = {{R(0)}};
        TERMINAL_ROWS(s, terminal->h, J);
        if (level == LEVEL_C) {
            correct_rows(terminal->g, J[0], terminal->J[0], END_MULTIPLIERS(s), NH_N, NX);
        }
    }
}

/* Level B or C of the coupled rows. */
static void refresh_coupled(solver_t *s, int level)
{
    real_t J_0[NE][NX] = {{R(0)}}, J_N[NE][NX] = {{R(0)}};
    COUPLED_ROWS(s, s->coupled.r, J_0, J_N);
    if (level == LEVEL_C) {
        correct_rows(s->node[0].g, J_0[0], s->coupled.J_0[0], COUPLED_MULTIPLIERS(s), NE, NX);
        correct_rows(s->terminal.g, J_N[0], s->coupled.J_N[0], COUPLED_MULTIPLIERS(s), NE, NX);
    }
}

/* Level B or C of all nodes. */
static void refresh(solver_t *s, int level)
{
    for (int k = 0; k < N; k++) {
        refresh_node(s, k, level);
    }
    refresh_terminal(s, level);
    if (HAS_START_GRADIENT) {
        add_start_gradient(s, s->node[0].g);
    }
    if (NE > 0) {
        refresh_coupled(s, level);
    }
}

/* Level A: evaluates everything. The gradients that level C has filled are cleared first, as kernels store only their
 * structural nonzeros. */
static status_t evaluate_everything(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        (void)memset(s->node[k].g, 0, sizeof s->node[k].g);
    }
    (void)memset(s->terminal.g, 0, sizeof s->terminal.g);
    return prepare_here(s);
}

/* Preparation at a level. It is A if there is nothing to keep: at first, after a failure, and after a reset. */
static status_t evaluate(solver_t *s, int level)
{
    status_t status = OK;
    s->levels.last = (s->levels.valid && s->failures == NO_FAILURE) ? level : LEVEL_A;
    if (s->levels.last == LEVEL_A) {
        take_penalties(s);
        status = evaluate_everything(s);
        s->levels.valid = (status == OK);
    } else {
        if (s->levels.last == LEVEL_D) {
            follow_plan(s);
        } else {
            refresh(s, s->levels.last);
        }
        s->renewal = UP_TO_DATE;
        condense_rows(s);
    }
    (void)memcpy(s->levels.x, s->x, sizeof s->levels.x);
    (void)memcpy(s->levels.u, s->u, sizeof s->levels.u);
    return status;
}

/* The QP and its step at the state of the plan in place of a measured one. */
static status_t step_at_plan(solver_t *s)
{
    real_t measured[NX];
    status_t status;
    measure_plan(s, measured);
    status = feedback_here(s);
    (void)memcpy(s->xhat, measured, sizeof s->xhat);
    return status;
}

static void levels_on_reset(solver_t *s)
{
    s->levels.valid = 0;
    s->levels.asked = LEVEL_A;
}

static void levels_before_solve(solver_t *s)
{
    s->levels.valid = 0;
}

static status_t levels_prepare_plan(solver_t *s)
{
    const status_t status = evaluate(s, s->levels.asked);
    s->levels.asked = LEVEL_A;
    measure_residual(s);
    return status;
}

status_t API(prepare_level)(solver_t *s, int level)
{
    if (level < LEVEL_A || level > LEVEL_D) {
        return BAD_ARGUMENT;
    }
    s->levels.asked = level;
    return API(prepare)(s);
}

status_t API(iterate)(solver_t *s, int level)
{
    status_t status;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (level < LEVEL_A || level > LEVEL_D) {
        return BAD_ARGUMENT;
    }
    s->newton = NEWTON;
    if (FIRST) {
        s->first.call = 0; /* the plan is not that of a sample any more */
    }
    forget_violation(s);
    status = evaluate(s, level);
    measure_residual(s);
    status = (status == OK) ? step_at_plan(s) : status;
    s->levels.valid &= (status == OK || status == RELAXED);
    s->prepared = 0;
    return finish(s, judge(s, status));
}
