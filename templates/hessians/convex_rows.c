/* Returns 1 if the lower triangle M (n x n) is positive semidefinite: up to rounding, all pivots of L D L' are
 * nonnegative, and the columns of zero pivots are zero. Overwrites M. */
static int is_semidefinite(real_t *M, int n)
{
    real_t scale = R(0);
    int i, j, k;
    for (i = 0; i < n; i++) {
        const real_t d = FABS(M[i * n + i]);
        scale = (d > scale) ? d : scale;
    }
    for (j = 0; j < n; j++) {
        const real_t d = M[j * n + j];
        const int vanishes = d <= TOL_SEMIDEFINITE * scale;
        if (!(d >= -TOL_SEMIDEFINITE * scale)) {
            return 0;
        }
        for (i = j + 1; i < n; i++) {
            const real_t m = M[i * n + j];
            if (vanishes && !(FABS(m) <= TOL_SEMIDEFINITE * scale)) {
                return 0;
            }
            for (k = j + 1; k <= i && !vanishes; k++) {
                M[i * n + k] -= m * M[k * n + j] / d;
            }
        }
    }
    return 1;
}

/* Q += M, lower triangles, n x n. */
static void add_lower(real_t *Q, const real_t *M, int n)
{
    int i, j;
    for (i = 0; i < n; i++) {
        for (j = 0; j <= i; j++) {
            Q[i * n + j] += M[i * n + j];
        }
    }
}

/* Q_k += sum_i mu_i d2 h_i if that sum is positive semidefinite, with the multipliers of the last QP; likewise at node
 * N. */
static void add_rows(solver_t *s)
{
    real_t M[NZ * NZ] = {0};
    real_t factor[NZ * NZ];
#if HAS_PATH_CURVATURE
    for (int k = 0; k < N; k++) {
        PATH_CURVATURE(s, k, M);
        memcpy(factor, M, sizeof M);
        if (is_semidefinite(factor, NZ)) {
            add_lower(&s->hessian.Q[k][0][0], M, NZ);
        }
    }
#endif
#if HAS_TERMINAL_CURVATURE
    memset(M, 0, sizeof M);
    TERMINAL_CURVATURE(s, M);
    memcpy(factor, M, sizeof M);
    if (is_semidefinite(factor, NX)) {
        add_lower(&s->hessian.Q_N[0][0], M, NX);
    }
#endif
}
