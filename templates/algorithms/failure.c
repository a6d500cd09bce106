/* Measures after a QP without a solution, and recovery from a plan that has become useless. */

static void forget_violation(solver_t *s)
{
    s->stats.violated_row = s->stats.violated_node = -1;
    s->stats.violation = R(0);
}

#if HARD_ROWS || (SOLVE && NG)
#if GENERAL_ROWS || NE
/* Change of the general or coupled row m due to the step. */
static real_t nodal_change(const solver_t *s, int m)
{
    const real_t *J = nodal_row(s, m);
    const int k = row_node[m];
    real_t change = R(0);
    for (int i = 0; i < NX; i++) {
        change += J[i] * s->step.dx[k][i];
    }
#if NE
    if (IS_COUPLED(m)) {
        for (int i = 0; i < NX; i++) {
            change += s->coupled.J_0[row_index[m]][i] * s->step.dx[0][i];
        }
    }
#endif
    for (int i = 0; k < N && i < NU; i++) {
        change += J[NX + i] * s->step.du[k][i];
    }
    return change;
}

#endif
/* Amount by which the linearised row m violates its bounds after the step; positive at the upper bound,
 * negative at the lower one. With a multiplier it is the distance from the bound to which that belongs. */
static real_t row_excess(const solver_t *s, int m, real_t mult)
{
    real_t value = ROW_CONSTANT(s, m);
#if STATE_ROWS && (GENERAL_ROWS || NE)
    value += (row_kind[m] == ROW_STATE) ? s->step.dx[row_node[m]][row_index[m]] : nodal_change(s, m);
#elif STATE_ROWS
    value += s->step.dx[row_node[m]][row_index[m]];
#else
    value += nodal_change(s, m);
#endif
    return value -
        clip(value, mult > R(0) ? ROW_UPPER(s, m) : ROW_LOWER(s, m), mult < R(0) ? ROW_LOWER(s, m) : ROW_UPPER(s, m));
}
#endif

#if HARD_ROWS
/* Records in the statistics the hard row that the step violates most. After a relaxed QP this is the relaxed step,
 * otherwise the last iterate of the QP. */
static void name_violation(solver_t *s)
{
    forget_violation(s);
    for (int m = 0; m < NG; m++) {
        const real_t excess = FABS(row_excess(s, m, R(0)));
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        if (excess > s->stats.violation) {
            s->stats.violation = excess;
            s->stats.violated_row = (int32_t)row_id[m];
            s->stats.violated_node = (int32_t)row_node[m];
        }
    }
}

#if RELAX
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
    return scale_of(most);
}

/* Scales of states and controls, and those of the rows, which follow from them. */
static void scale_rows(solver_t *s, real_t *size)
{
    state_scales(s, size);
    control_sizes(s, size + NX);
    for (int m = 0; m < NG; m++) {
        enlarge(&s->row_scale[row_id[m]], row_terms(s, m, size));
    }
}

/* Returns 1 if all hard rows hold up to rounding. */
static int nothing_relaxed(const solver_t *s)
{
    for (int m = 0; m < NG; m++) {
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        if (!(FABS(row_excess(s, m, R(0))) <= TOL_STEP * s->row_scale[row_id[m]])) {
            return 0;
        }
    }
    return 1;
}

/* Called if the QP is infeasible or has been given up: solves it again with its hard rows relaxed, at the weight set in
 * the options. If all of them hold, its solution is that of the QP. */
static status_t give_way(solver_t *s, status_t why)
{
    status_t status;
    real_t size[NZ];
    scale_rows(s, size);
    s->relaxation = relaxation_weight[0] * cost_scale(s, size);
    status = run_qp(s);
    s->relaxation = INF;
    if (why != INFEASIBLE && (status != OK || nothing_relaxed(s))) {
        return (status == OK) ? OK : why;
    }
    name_violation(s);
    return (status == OK) ? RELAXED : status;
}
#else
/* Called if the QP is infeasible or has been given up: reports the violated row; there is no relaxation. */
static status_t give_way(solver_t *s, status_t why)
{
    if (why == INFEASIBLE) {
        name_violation(s);
    }
    return why;
}
#endif
#endif

#if HARD_ROWS
/* Returns 1 if a QP with relaxed rows may have a solution where this one has none. */
static inline int is_given_up(status_t status)
{
    return status == INFEASIBLE || status == ITERATION_LIMIT || status == STALLED;
}

#endif
/* The QP of a sample, and where it has no solution the one with relaxed rows. */
static status_t run_sample_qp(solver_t *s)
{
    const status_t status = run_qp(s);
#if HARD_ROWS
    if (is_given_up(status)) {
        return give_way(s, status);
    }
#endif
    return status;
}

#include "algorithms/recover.c"
