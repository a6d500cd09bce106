/* Returns diagonal entry i of the Hessian of node k in the QP of the sample. */
static inline real_t curvature_at(const solver_t *s, int k, int i)
{
    if (k < N) {
        return HESSIAN(s, k)[i][i];
    }
    if (TERMINAL_BLOCK) {
        return s->hessian.Q_N[i][i];
    } else {
        return R(0);
    }
}
