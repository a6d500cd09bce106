/* Eigenvalues of LANES symmetric matrices of n rows at once, by Jacobi rotations. Element (i, j) of all matrices is
 * stored at [i * n + j][lane], so that every loop over lanes vectorises. */

/* Computes cos and sin of the rotations that annihilate the elements a_pq, with the smaller of the two angles: t = tan
 * = 2 a_pq / (d + sign(d) sqrt(d^2 + 4 a_pq^2)), d = a_qq - a_pp. Returns 0 if all elements a_pq are negligible.
 * Entries are at most 1 in magnitude. */
static int jacobi_angle(const real_t *app, const real_t *aqq, const real_t *apq, real_t *t, real_t *c, real_t *s)
{
    real_t tangent[LANES], cosine[LANES];
    int l, worth = 0;
    for (l = 0; l < LANES; l++) {
        worth |= FABS(apq[l]) > TOL_EIGEN_OFFDIAGONAL;
    }
    for (l = 0; worth && l < LANES; l++) {
        const real_t a = R(2) * apq[l];
        const real_t d = aqq[l] - app[l];
        const real_t r = FABS(d) + SQRT(d * d + a * a) + TOL_EIGEN_TINY;
        tangent[l] = ((d < R(0)) ? -a : a) / r;
        cosine[l] = R(1) / SQRT(R(1) + tangent[l] * tangent[l]);
    }
    for (l = 0; worth && l < LANES; l++) {
        t[l] = tangent[l];
        c[l] = cosine[l];
        s[l] = tangent[l] * cosine[l];
    }
    return worth;
}

/* (x, y) <- (c x - s y, s x + c y). */
static inline void jacobi_apply(real_t *x, real_t *y, const real_t *c, const real_t *s)
{
    real_t a[LANES], b[LANES];
    int l;
    for (l = 0; l < LANES; l++) {
        a[l] = c[l] * x[l] - s[l] * y[l];
        b[l] = s[l] * x[l] + c[l] * y[l];
    }
    for (l = 0; l < LANES; l++) {
        x[l] = a[l];
        y[l] = b[l];
    }
}

/* A <- J' A J and V <- J' V in the plane (p, q), p < q; only the lower triangle of A is stored. Returns 0 if no
 * rotation was needed. */
static int jacobi_rotate(real_t (*A)[LANES], real_t (*V)[LANES], int n, int p, int q)
{
    real_t t[LANES], c[LANES], s[LANES];
    real_t *app = A[p * n + p], *aqq = A[q * n + q], *apq = A[q * n + p];
    int k, l;
    if (!jacobi_angle(app, aqq, apq, t, c, s)) {
        return 0;
    }
    for (l = 0; l < LANES; l++) {
        const real_t shift = t[l] * apq[l];
        app[l] -= shift;
        aqq[l] += shift;
        apq[l] = R(0);
    }
    for (k = 0; k < p; k++) {
        jacobi_apply(A[p * n + k], A[q * n + k], c, s);
    }
    for (k = p + 1; k < q; k++) {
        jacobi_apply(A[k * n + p], A[q * n + k], c, s);
    }
    for (k = q + 1; k < n; k++) {
        jacobi_apply(A[k * n + p], A[k * n + q], c, s);
    }
    for (k = 0; k < n; k++) {
        jacobi_apply(V[p * n + k], V[q * n + k], c, s);
    }
    return 1;
}

/* V = I */
static void jacobi_identity(real_t (*V)[LANES], int n)
{
    int i, j, l;
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++) {
            for (l = 0; l < LANES; l++) {
                V[i * n + j][l] = (i == j) ? R(1) : R(0);
            }
        }
    }
}

/* Rotates in every plane once, in rounds of disjoint planes, whose angles are independent of one another. m is n
 * rounded up to an even number; a plane with the row n is skipped. Returns 0 if no rotation was needed. */
static int jacobi_sweep(real_t (*A)[LANES], real_t (*V)[LANES], int n)
{
    const int m = n + (n & 1);
    int round, i, rotated = 0;
    for (round = 0; round < m - 1; round++) {
        for (i = 0; i < m / 2; i++) {
            const int a = (i == 0) ? m - 1 : (round + i) % (m - 1);
            const int b = (round - i + m - 1) % (m - 1);
            if (a < n && b < n) {
                rotated |= jacobi_rotate(A, V, n, (a < b) ? a : b, (a < b) ? b : a);
            }
        }
    }
    return rotated;
}

/* A = V' Lambda V: eigenvalues on the diagonal of A, eigenvectors in the rows of V. */
static void jacobi(real_t (*A)[LANES], real_t (*V)[LANES], int n)
{
    int sweep, rotated = 1;
    jacobi_identity(V, n);
    for (sweep = 0; sweep < MAX_SWEEPS && rotated; sweep++) {
        rotated = jacobi_sweep(A, V, n);
    }
}
