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

/* Q += M if M is positive semidefinite, lower triangles, n x n. */
static void add_if_convex(real_t *Q, const real_t *M, int n)
{
    real_t factor[NZ * NZ];
    (void)memcpy(factor, M, sizeof factor[0] * (size_t)(n * n));
    if (is_semidefinite(factor, n)) {
        add_lower(Q, M, n);
    }
}

/* Adds mu_i d2 h_i of every row i for which it is positive semidefinite, with the multipliers of the last QP: Q_k and
 * Q_N. Row by row, since a concave row must not take their curvature from the others. */
static void add_rows(solver_t *s)
{
    real_t mu[NH + NH_N] = {R(0)}, M[NZ][NZ] = {{R(0)}}, M_N[NX][NX] = {{R(0)}};
    for (int m = 0; m < NG; m++) {
        if (row_is_state(m) || row_is_coupled(m) || s->mult[m] == R(0)) { /* exactly 0: it is not active */
            continue;
        }
        mu[row_index(m)] = s->mult[m];
        if (row_node(m) < N) {
            PATH_CURVATURE(s, row_node(m), mu, M);
            add_if_convex(&s->hessian.Q[row_node(m)][0][0], &M[0][0], NZ);
        } else if (HAS_TERMINAL_CURVATURE) {
            TERMINAL_CURVATURE(s, mu, M_N);
            add_if_convex(&s->hessian.Q_N[0][0], &M_N[0][0], NX);
        }
        mu[row_index(m)] = R(0);
    }
}
