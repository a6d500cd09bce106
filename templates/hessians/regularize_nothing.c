/* Leaves a condensed Hessian that is not positive definite unchanged. */
static status_t condense_factorize(solver_t *s)
{
    return qp_factorize(&s->qp);
}
