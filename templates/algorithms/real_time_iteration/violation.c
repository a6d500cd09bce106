/* The row that a QP without a solution violates. */

static void forget_violation(solver_t *s)
{
    s->stats.violated_row = -1;
    s->stats.violated_node = -1;
    s->stats.violation = R(0);
}

/* Returns 1 if a QP failed with a status after which its relaxation may still have a solution. */
static inline int is_given_up(status_t status)
{
    return status == INFEASIBLE || status == ITERATION_LIMIT || status == STALLED;
}

/* Returns the change of row m due to the step. */
static real_t row_change(const solver_t *s, int m)
{
    const int k = row_node(m);
    if (row_is_state(m)) {
        return s->step.dx[k][row_index(m)];
    }
    const real_t *J = row_gradient(s, m);
    real_t change = R(0);
    for (int i = 0; i < NX; i++) {
        change += J[i] * s->step.dx[k][i];
    }
    if (row_is_coupled(m)) {
        for (int i = 0; i < NX; i++) {
            change += s->coupled.J_0[row_index(m)][i] * s->step.dx[0][i];
        }
    }
    for (int i = 0; k < N && i < NU; i++) {
        change += J[NX + i] * s->step.du[k][i];
    }
    return change;
}

/* Returns by how much the linearised row m violates its bounds after the step: positive beyond the upper bound,
 * negative beyond the lower one, 0 between them. A multiplier selects a bound, the upper one if it is positive and the
 * lower one if it is negative; then the value less that bound is returned, whatever its sign. */
static real_t row_excess(const solver_t *s, int m, real_t mult)
{
    const real_t value = row_constant(s, m) + row_change(s, m);
    return value -
        clip(value, mult > R(0) ? row_upper(s, m) : row_lower(s, m), mult < R(0) ? row_lower(s, m) : row_upper(s, m));
}

/* Records in the statistics the hard row that the step violates most. After a relaxed QP this is the relaxed step,
 * otherwise the last iterate of the QP. */
static void name_violation(solver_t *s)
{
    forget_violation(s);
    for (int m = 0; m < NG; m++) {
        const real_t excess = FABS(row_excess(s, m, R(0)));
        if (row_is_soft(s, m)) {
            continue;
        }
        if (excess > s->stats.violation) {
            s->stats.violation = excess;
            s->stats.violated_row = (int32_t)row_id(m);
            s->stats.violated_node = (int32_t)row_node(m);
        }
    }
}
