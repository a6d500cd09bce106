/* A reduced Hessian that is not positive definite stays as it is. */
static inline int regularize_reduced(real_t *H, int n, int ld, real_t *work)
{
    (void)H;
    (void)n;
    (void)ld;
    (void)work;
    return 0;
}

static inline void regularize_stages(solver_t *s)
{
    (void)s;
}
