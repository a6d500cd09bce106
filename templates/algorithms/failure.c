/* What becomes of a QP that has no solution, and of a plan that has become useless. */

/* What the linearised row m exceeds its bounds by after the step; > 0 at the upper bound. */
static real_t row_excess(const solver_t *s, int m)
{
    real_t J[NZ];
    real_t value = row_gradient(s, m, J);
    const int k = row_node[m];
    int i;
    for (i = 0; i < NX; i++) {
        value += J[i] * s->step.dx[k][i];
        value += (row_kind[m] == 2) ? s->coupled.J_0[row_index[m]][i] * s->step.dx[0][i] : R(0);
    }
    for (i = 0; k < N && i < NU; i++) {
        value += J[NX + i] * s->step.du[k][i];
    }
    return value - clip(value, row_lower(s, m), row_upper(s, m));
}

static void forget_violation(solver_t *s)
{
    s->stats.violated_row = s->stats.violated_node = -1;
    s->stats.violation = R(0);
}

/* The hard row that the step, the QP's last or relaxed one, violates most goes to the statistics. */
static void name_violation(solver_t *s)
{
    int m;
    forget_violation(s);
    for (m = 0; m < NG; m++) {
        const real_t excess = FABS(row_excess(s, m));
        if (excess > s->stats.violation && row_l1[row_id[m]] == (real_t)INFINITY) {
            s->stats.violation = excess;
            s->stats.violated_row = (int32_t)row_id[m];
            s->stats.violated_node = (int32_t)row_node[m];
        }
    }
}

/* The QP is infeasible: its hard rows are relaxed at the weight that the options ask for, or it stays so. */
static status_t relax_qp(solver_t *s)
{
    status_t status = INFEASIBLE;
    if (relaxation_weight[0] < (real_t)INFINITY) {
        s->relaxation = relaxation_weight[0];
        status = run_qp(s);
        s->relaxation = (real_t)INFINITY;
    }
    name_violation(s);
    return (status == OK) ? RELAXED : status;
}

static int plan_is_finite(const solver_t *s)
{
    return all_finite(&s->x[0][0], (N + 1) * NX) && all_finite(&s->u[0][0], N * NU);
}

/* After a failure that would come back: where numbers broke down, and where the QP fails for the second time in a row, the states
 * of the plan start anew at the measured one, for the plan may have nothing to do with it any more; its controls stay. Where the
 * QP did not end its working set is forgotten. */
static void recover(solver_t *s, status_t status)
{
    const int solved = status == OK || status == RELAXED;
    const int measured = status != NOT_FINITE && status != NOT_PREPARED;
    if (measured) {
        s->failing = solved ? 0 : s->failing ? 2 : 1;
    }
    if (status == NUMERICAL_FAILURE || (measured && s->failing == 2)) {
        start_at_measured(s);
    } else if (status == ITERATION_LIMIT || status == STALLED) {
        condense_init(s);
    }
}
