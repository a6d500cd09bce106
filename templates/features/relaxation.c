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

/* Solves a QP that is infeasible or has been given up again with its hard rows relaxed, at the weight set in the options.
 * If all of them hold, its solution is that of the QP. */
static status_t relax_rows(solver_t *s, status_t why)
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

static status_t relaxation_after_qp(solver_t *s, status_t status)
{
    if (is_given_up(status)) {
        return relax_rows(s, status);
    }
    return status;
}
