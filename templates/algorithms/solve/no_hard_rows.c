/* solve() without hard rows: every QP has a solution. */

static status_t solve_qp(solver_t *s)
{
    return run_qp(s);
}

static status_t solve_again(solver_t *s)
{
    return run_qp(s);
}

static real_t gain_of(const solver_t *s)
{
    return s->sqp.base.violation;
}
