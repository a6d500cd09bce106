/* Leaves a condensed Hessian that is not positive definite unchanged. */
static status_t condense_factorize(solver_t *s)
{
    return qp_factorize(&s->qp);
}

#if NG
static inline real_t released_multiplier(const solver_t *s, int m)
{
    return s->qp.mult[NV + m];
}
#endif
