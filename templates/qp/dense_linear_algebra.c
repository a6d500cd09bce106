/* Dense linear algebra in panels of four rows. Vectors and rows have LDV entries, with zeros as padding. The inverses
 * of the diagonal of a triangular matrix are stored separately, and its other triangle is not read; missing rows in the
 * last panel of n rows are zero, and so are their inverses. */

/* sum_j a_j b_j, j < n, in four partial sums. */
static inline real_t dot(const real_t *a, const real_t *b, int n)
{
    real_t s0 = R(0), s1 = R(0), s2 = R(0), s3 = R(0);
    for (int j = 0; j < n; j += 4) {
        s0 += a[j] * b[j];
        s1 += a[j + 1] * b[j + 1];
        s2 += a[j + 2] * b[j + 2];
        s3 += a[j + 3] * b[j + 3];
    }
    return (s0 + s2) + (s1 + s3);
}

/* |a| */
static real_t norm(const real_t *a)
{
    return SQRT(dot(a, a, LDV));
}

/* y = 0, in a loop, which is faster than a call of memset. */
static inline void clear(real_t *y)
{
    for (int j = 0; j < LDV; ++j) {
        y[j] = R(0);
    }
}

#if SCALAR && !SMALL
/* y = x */
static inline void copy(real_t *y, const real_t *x)
{
    for (int j = 0; j < LDV; j += 4) {
        y[j] = x[j];
        y[j + 1] = x[j + 1];
        y[j + 2] = x[j + 2];
        y[j + 3] = x[j + 3];
    }
}

/* y[j] -= c0 A[0][j] + c1 A[1][j] + c2 A[2][j] + c3 A[3][j],  from <= j < to */
static inline void subtract_panel(real_t *y, const real_t (*A)[LDV], const real_t *c, int from, int to)
{
    const real_t c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
    for (int j = from; j < to; j += 4) {
        y[j] -= (c0 * A[0][j] + c1 * A[1][j]) + (c2 * A[2][j] + c3 * A[3][j]);
        y[j + 1] -= (c0 * A[0][j + 1] + c1 * A[1][j + 1]) + (c2 * A[2][j + 1] + c3 * A[3][j + 1]);
        y[j + 2] -= (c0 * A[0][j + 2] + c1 * A[1][j + 2]) + (c2 * A[2][j + 2] + c3 * A[3][j + 2]);
        y[j + 3] -= (c0 * A[0][j + 3] + c1 * A[1][j + 3]) + (c2 * A[2][j + 3] + c3 * A[3][j + 3]);
    }
}
#else
/* y = x, in a loop, because memcpy writes halves of a vector register, which would stall the next read. */
static inline void copy(real_t *y, const real_t *x)
{
    for (int j = 0; j < LDV; j += 4) {
        real_t t[4];
        for (int l = 0; l < 4; ++l) {
            t[l] = x[j + l];
        }
        for (int l = 0; l < 4; ++l) {
            y[j + l] = t[l];
        }
    }
}

/* y[j] -= c0 A[0][j] + c1 A[1][j] + c2 A[2][j] + c3 A[3][j],  from <= j < to */
static inline void subtract_panel(real_t *y, const real_t (*A)[LDV], const real_t *c, int from, int to)
{
    const real_t c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
    for (int j = from; j < to; j += 4) {
        real_t s[4];
        for (int l = 0; l < 4; ++l) {
            s[l] = y[j + l] - ((c0 * A[0][j + l] + c1 * A[1][j + l]) + (c2 * A[2][j + l] + c3 * A[3][j + l]));
        }
        for (int l = 0; l < 4; ++l) {
            y[j + l] = s[l];
        }
    }
}
#endif

/* c = L^{-1} y, four entries, where L is the panel at column b of L' (unit upper triangular). */
static inline void solve_block(const real_t (*L)[LDV], int b, const real_t *y, real_t *c)
{
    const real_t *l0 = L[0] + b, *l1 = L[1] + b, *l2 = L[2] + b;
    c[0] = y[0];
    c[1] = y[1] - l0[1] * c[0];
    c[2] = y[2] - l0[2] * c[0] - l1[2] * c[1];
    c[3] = y[3] - l0[3] * c[0] - l1[3] * c[1] - l2[3] * c[2];
}

/* y := C^{-T} y, n entries, where C is lower triangular. */
static void solve_upper(const real_t (*C)[LDV], const real_t *inverse, real_t *y, int n)
{
    for (int b = (n + 3) / 4 * 4 - 4; b >= 0; b -= 4) {
        const real_t *c1 = C[b + 1] + b, *c2 = C[b + 2] + b, *c3 = C[b + 3] + b, *d = inverse + b;
        real_t x[4];
        x[3] = y[b + 3] * d[3];
        x[2] = (y[b + 2] - c3[2] * x[3]) * d[2];
        x[1] = (y[b + 1] - c3[1] * x[3] - c2[1] * x[2]) * d[1];
        x[0] = (y[b] - c3[0] * x[3] - c2[0] * x[2] - c1[0] * x[1]) * d[0];
        subtract_panel(y, C + b, x, 0, b);
        for (int l = 0; l < 4; ++l) {
            y[b + l] = x[l];
        }
    }
}

/* y := L^{-T} y, n entries, n a multiple of 4; L unit lower triangular. */
static void solve_unit_upper(const real_t (*L)[LDV], real_t *y, int n)
{
    for (int b = n - 4; b >= 0; b -= 4) {
        const real_t *l1 = L[b + 1] + b, *l2 = L[b + 2] + b, *l3 = L[b + 3] + b;
        real_t x[4];
        x[3] = y[b + 3];
        x[2] = y[b + 2] - l3[2] * x[3];
        x[1] = y[b + 1] - l3[1] * x[3] - l2[1] * x[2];
        x[0] = y[b] - l3[0] * x[3] - l2[0] * x[2] - l1[0] * x[1];
        subtract_panel(y, L + b, x, 0, b);
        for (int l = 0; l < 3; ++l) {
            y[b + l] = x[l];
        }
    }
}
