/* A rotation in the plane (p, q) that makes A_pq zero; the rows of V turn with it. Returns 0 if A_pq is negligible. */
static int rotate_plane(real_t (*A)[NZ], real_t (*V)[NZ], int n, int p, int q)
{
    const real_t a = R(2) * A[p][q], d = A[q][q] - A[p][p];
    if (!(FABS(a) > TOL_EIGEN_OFFDIAGONAL * SQRT(FABS(A[p][p] * A[q][q]))) || !(FABS(a) > R(0))) {
        return 0;
    }
    const real_t tangent = ((d < R(0)) ? -a : a) / (FABS(d) + SQRT(d * d + a * a));
    const real_t cosine = R(1) / SQRT(R(1) + tangent * tangent), sine = tangent * cosine;
    for (int i = 0; i < n; i++) {
        const real_t x = A[p][i], y = A[q][i];
        A[p][i] = cosine * x - sine * y;
        A[q][i] = sine * x + cosine * y;
    }
    for (int i = 0; i < n; i++) {
        const real_t x = A[i][p], y = A[i][q], v = V[p][i], w = V[q][i];
        A[i][p] = cosine * x - sine * y;
        A[i][q] = sine * x + cosine * y;
        V[p][i] = cosine * v - sine * w;
        V[q][i] = sine * v + cosine * w;
    }
    return 1;
}

/* A = V' max(Lambda, 0) V for the symmetric n x n matrix A = V' Lambda V, by Jacobi rotations. */
static void keep_positive_part(real_t (*A)[NZ], real_t (*V)[NZ], int n)
{
    int rotated = 1;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            V[i][j] = (i == j) ? R(1) : R(0);
        }
    }
    for (int sweep = 0; sweep < MAX_ROTATIONS && rotated; sweep++) {
        rotated = 0;
        for (int p = 0; p < n; p++) {
            for (int q = p + 1; q < n; q++) {
                rotated |= rotate_plane(A, V, n, p, q);
            }
        }
    }
    real_t value[NZ];
    for (int i = 0; i < n; i++) {
        value[i] = (A[i][i] > R(0)) ? A[i][i] : R(0);
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            A[i][j] = R(0);
            for (int l = 0; l < n; l++) {
                A[i][j] += value[l] * V[l][i] * V[l][j];
            }
        }
    }
}
