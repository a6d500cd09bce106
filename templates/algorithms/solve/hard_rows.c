/* Hard rows in a search: the rows of a linearisation without a solution are relaxed with the penalty row_weight
 * (elastic QP), which grows as long as the linearisations have none. */

/* Solves the QP with its rows relaxed. */
static status_t run_relaxed_qp(solver_t *s)
{
    s->relaxation = s->sqp.row_weight * s->sqp.cost_unit;
    const status_t status = run_qp(s);
    s->relaxation = INF;
    return status;
}

/* Solves the QP of the present linearisation. If it is infeasible, or has been given up, its rows are relaxed. */
static status_t solve_qp(solver_t *s)
{
    const status_t status = run_qp(s);
    s->trial.elastic = is_given_up(status);
    return s->trial.elastic ? run_relaxed_qp(s) : status;
}

/* Solves the same QP with other constraints. */
static status_t solve_again(solver_t *s)
{
    return s->trial.elastic ? run_relaxed_qp(s) : run_qp(s);
}

/* Returns the reduction of the violation by the full step, according to the linearisation. */
static real_t gain_of(const solver_t *s)
{
    real_t gain = s->sqp.base.violation;
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m)) {
            continue;
        }
        gain -= FABS(row_excess(s, m, R(0))) / size_or(s->row_scale[row_id(m)], row_magnitude[row_id(m)]);
    }
    return gain;
}

/* Raises the penalty, up to a limit, after an iteration whose elastic QP made no progress. */
static status_t raise_row_weight(solver_t *s, status_t status)
{
    const int slow = !(s->sqp.gain > FACTOR_SQP_LITTLE_PROGRESS * s->sqp.base.violation);
    if (s->trial.elastic && (status == STALLED || (status == OK && slow))) {
        status = (s->sqp.row_weight < FACTOR_SQP_MOST_ELASTIC_WEIGHT) ? OK : INFEASIBLE;
        s->sqp.row_weight *= FACTOR_PENALTY_RATIO;
    }
    return status;
}
