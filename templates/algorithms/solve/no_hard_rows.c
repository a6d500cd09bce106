/* A search without hard rows: every QP has a solution. */

/* Solves the QP of the present linearisation. */
static status_t solve_qp(solver_t *s)
{
    return run_qp(s);
}

/* The same QP with other constraints. */
static status_t solve_again(solver_t *s)
{
    return run_qp(s);
}

/* By how much the full step reduces the violation according to the linearisation. */
static real_t gain_of(const solver_t *s)
{
    return s->sqp.base.violation;
}
