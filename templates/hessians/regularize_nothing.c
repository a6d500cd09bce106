/* A condensed Hessian that is not positive definite stays as it is. */
static status_t condense_factorize(solver_t *s)
{
    return qp_factorize(&s->qp);
}
