/* Products for processors without a vector unit. The sums are separate variables, which compilers hold in registers. */

/* c[r][j] += sum_{l<n} a[l][r] b[l][j], r < 4, j < 4: a block of a matrix product. */
static inline void riccati_block(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n)
{
    real_t s00 = R(0), s01 = R(0), s02 = R(0), s03 = R(0);
    real_t s10 = R(0), s11 = R(0), s12 = R(0), s13 = R(0);
    real_t s20 = R(0), s21 = R(0), s22 = R(0), s23 = R(0);
    real_t s30 = R(0), s31 = R(0), s32 = R(0), s33 = R(0);
    for (int l = 0; l < n; l++) {
        const real_t b0 = b[0], b1 = b[1], b2 = b[2], b3 = b[3];
        s00 += a[0] * b0;
        s01 += a[0] * b1;
        s02 += a[0] * b2;
        s03 += a[0] * b3;
        s10 += a[1] * b0;
        s11 += a[1] * b1;
        s12 += a[1] * b2;
        s13 += a[1] * b3;
        s20 += a[2] * b0;
        s21 += a[2] * b1;
        s22 += a[2] * b2;
        s23 += a[2] * b3;
        s30 += a[3] * b0;
        s31 += a[3] * b1;
        s32 += a[3] * b2;
        s33 += a[3] * b3;
        a += lda;
        b += ldb;
    }
    c[0] += s00;
    c[1] += s01;
    c[2] += s02;
    c[3] += s03;
    c += ldc;
    c[0] += s10;
    c[1] += s11;
    c[2] += s12;
    c[3] += s13;
    c += ldc;
    c[0] += s20;
    c[1] += s21;
    c[2] += s22;
    c[3] += s23;
    c += ldc;
    c[0] += s30;
    c[1] += s31;
    c[2] += s32;
    c[3] += s33;
}

/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < width; width is a multiple of 4. */
static void riccati_rows(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int width)
{
    for (int j = 0; j < width; j += 4) {
        riccati_block(c + j, ldc, a, lda, b + j, ldb, n);
    }
}

#if SMALL
/* y[j] += a x[j],  j < n. */
static inline void riccati_add(real_t *y, real_t a, const real_t *x, int n)
{
    for (int j = 0; j < n; j++) {
        y[j] += a * x[j];
    }
}
#else
/* y[j] += a x[j],  j < n; n is a multiple of 4. */
static inline void riccati_add(real_t *y, real_t a, const real_t *x, int n)
{
    for (int j = 0; j < n; j += 4) {
        y[j] += a * x[j];
        y[j + 1] += a * x[j + 1];
        y[j + 2] += a * x[j + 2];
        y[j + 3] += a * x[j + 3];
    }
}
#endif
