/* The search has no hard rows, so that every QP has a solution. */

/* Solves the QP of the present linearisation. */
static status_t solve_qp(solver_t *s)
{
    return run_qp(s);
}

/* Solves the same QP with other constraints. */
static status_t solve_again(solver_t *s)
{
    return run_qp(s);
}

/* Returns the reduction of the violation by the full step, according to the linearisation. */
static real_t gain_of(const solver_t *s)
{
    return s->sqp.base.violation;
}
