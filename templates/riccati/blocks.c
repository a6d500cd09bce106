/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < width <= BLOCK_WIDTH: four rows of a matrix product. */
static inline void riccati_block(
    real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, const int width)
{
    real_t s0[BLOCK_WIDTH] = {0}, s1[BLOCK_WIDTH] = {0}, s2[BLOCK_WIDTH] = {0}, s3[BLOCK_WIDTH] = {0};
    for (int l = 0; l < n; l++) {
        const real_t a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (int i = 0; i < width; i++) {
            s0[i] += a0 * b[i];
        }
        for (int i = 0; i < width; i++) {
            s1[i] += a1 * b[i];
        }
        for (int i = 0; i < width; i++) {
            s2[i] += a2 * b[i];
        }
        for (int i = 0; i < width; i++) {
            s3[i] += a3 * b[i];
        }
        a += lda;
        b += ldb;
    }
    for (int i = 0; i < width; i++) {
        c[i] += s0[i];
    }
    for (int i = 0; i < width; i++) {
        c[ldc + i] += s1[i];
    }
    for (int i = 0; i < width; i++) {
        c[2 * ldc + i] += s2[i];
    }
    for (int i = 0; i < width; i++) {
        c[3 * ldc + i] += s3[i];
    }
}

/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < width; width is a multiple of 4. */
static void riccati_rows(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int width)
{
    const int whole = width / BLOCK_WIDTH * BLOCK_WIDTH;
    for (int j = 0; j < whole; j += BLOCK_WIDTH) {
        riccati_block(c + j, ldc, a, lda, b + j, ldb, n, BLOCK_WIDTH);
    }
    if (whole < width) {
        riccati_block(c + whole, ldc, a, lda, b + whole, ldb, n, 4);
    }
}

/* y[j] += a x[j],  j < n; n is a multiple of 4. */
static inline void riccati_add(real_t *y, real_t a, const real_t *x, int n)
{
    for (int j = 0; j < n; j += 4) {
        real_t s[4];
        for (int i = 0; i < 4; i++) {
            s[i] = y[j + i] + a * x[j + i];
        }
        for (int i = 0; i < 4; i++) {
            y[j + i] = s[i];
        }
    }
}
