/* Factorises matrices of n rows, M = P' L U; `order` holds the order of their rows. */

static void lu_exchange(real_t *M, int *order, int n, int i, int j)
{
    const int row = order[i];
    order[i] = order[j];
    order[j] = row;
    for (int c = 0; c < n; c++) {
        const real_t moved = M[i * n + c];
        M[i * n + c] = M[j * n + c];
        M[j * n + c] = moved;
    }
}

/* M = P' L U with row exchanges. Pivots are compared in the scales of their variables, and the diagonal of U is stored
 * as its inverse. Returns -1 on success, or the index of a variable whose column has no pivot above rounding errors. */
static inline int lu_factorize(real_t *M, int *order, const real_t *unit, int n)
{
    for (int i = 0; i < n; i++) {
        order[i] = i;
    }
    for (int j = 0; j < n; j++) {
        int best = j;
        real_t largest = R(0);
        for (int i = j; i < n; i++) {
            const real_t size = FABS(M[i * n + j]) * unit[order[i]];
            if (size > largest) {
                largest = size;
                best = i;
            }
        }
        if (!(largest > TOL_UNIT * unit[j]) || !isfinite(largest)) {
            return j;
        }
        if (best != j) {
            lu_exchange(M, order, n, best, j);
        }
        M[j * n + j] = R(1) / M[j * n + j];
        for (int i = j + 1; i < n; i++) {
            M[i * n + j] *= M[j * n + j];
            for (int c = j + 1; c < n; c++) {
                M[i * n + c] -= M[i * n + j] * M[j * n + c];
            }
        }
    }
    return -1;
}

/* Y = M^-1 B for `columns` columns. */
static inline void lu_solve(const real_t *M, const int *order, int n, const real_t *B, real_t *Y, int columns)
{
    for (int i = 0; i < n; i++) {
        for (int c = 0; c < columns; c++) {
            Y[i * columns + c] = B[order[i] * columns + c];
        }
        for (int j = 0; j < i; j++) {
            for (int c = 0; c < columns; c++) {
                Y[i * columns + c] -= M[i * n + j] * Y[j * columns + c];
            }
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) {
            for (int c = 0; c < columns; c++) {
                Y[i * columns + c] -= M[i * n + j] * Y[j * columns + c];
            }
        }
        for (int c = 0; c < columns; c++) {
            Y[i * columns + c] *= M[i * n + i];
        }
    }
}

/* Y = M'^-1 B for `columns` columns; W: as many numbers. */
static inline void lu_solve_transposed(
    const real_t *M, const int *order, int n, const real_t *B, real_t *W, real_t *Y, int columns)
{
    for (int i = 0; i < n; i++) {
        for (int c = 0; c < columns; c++) {
            W[i * columns + c] = B[i * columns + c];
        }
        for (int j = 0; j < i; j++) {
            for (int c = 0; c < columns; c++) {
                W[i * columns + c] -= M[j * n + i] * W[j * columns + c];
            }
        }
        for (int c = 0; c < columns; c++) {
            W[i * columns + c] *= M[i * n + i];
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) {
            for (int c = 0; c < columns; c++) {
                W[i * columns + c] -= M[j * n + i] * W[j * columns + c];
            }
        }
        for (int c = 0; c < columns; c++) {
            Y[order[i] * columns + c] = W[i * columns + c];
        }
    }
}

/* Returns the largest entry of a step d of n variables v, relative to the size of each variable; `worst` is its
 * index. */
static inline real_t size_of_correction(const real_t *d, const real_t *v, const real_t *unit, int n, int *worst)
{
    real_t most = R(0);
    *worst = 0;
    for (int i = 0; i < n; i++) {
        const real_t size = FABS(d[i]) * unit[i] / (FABS(v[i]) * unit[i] + R(1));
        if (!(size <= most)) { /* also true for NaN */
            most = size;
            *worst = i;
        }
    }
    return most;
}
