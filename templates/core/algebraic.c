#if ALGEBRAIC
/* Computes the algebraic variables at the state x and the controls u, with the parameters of node k. At node N, the
 * plan has the controls of node N - 1. */
status_t API(algebraic)(solver_t *s, int k, const real_t x[NXHAT], const real_t u[NU], real_t z[ALGEBRAIC])
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (k < 0 || k > N) {
        return BAD_INDEX;
    }
    real_t start[NX];
    (void)memcpy(start, s->x[k], sizeof start);
    (void)memcpy(start, x, NXHAT * sizeof *x);
#if NALG
    real_t point[NXA];
    const int reason = algebraic_of_node(s, k, start, u, point);
    STAGE_ALGEBRAIC(point, u, (k < N) ? PARAM(s, k) : PARAM_N(s), z);
    return (reason < 0) ? OK : NUMERICAL_FAILURE;
#else
    STAGE_ALGEBRAIC(start, u, (k < N) ? PARAM(s, k) : PARAM_N(s), z);
    return OK;
#endif
}
#endif
