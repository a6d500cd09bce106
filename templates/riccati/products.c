/* Four rows of a product: c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < 8. */
static inline void riccati_block_8(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n)
{
    real_t s0[8] = {0}, s1[8] = {0}, s2[8] = {0}, s3[8] = {0};
    int i, l;
    for (l = 0; l < n; l++) {
        const real_t a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (i = 0; i < 8; i++) { s0[i] += a0 * b[i]; }
        for (i = 0; i < 8; i++) { s1[i] += a1 * b[i]; }
        for (i = 0; i < 8; i++) { s2[i] += a2 * b[i]; }
        for (i = 0; i < 8; i++) { s3[i] += a3 * b[i]; }
        a += lda;
        b += ldb;
    }
    for (i = 0; i < 8; i++) { c[i] += s0[i]; }
    for (i = 0; i < 8; i++) { c[ldc + i] += s1[i]; }
    for (i = 0; i < 8; i++) { c[2 * ldc + i] += s2[i]; }
    for (i = 0; i < 8; i++) { c[3 * ldc + i] += s3[i]; }
}

/* The same for j < 4. */
static inline void riccati_block_4(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n)
{
    real_t s0[4] = {0}, s1[4] = {0}, s2[4] = {0}, s3[4] = {0};
    int i, l;
    for (l = 0; l < n; l++) {
        const real_t a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (i = 0; i < 4; i++) { s0[i] += a0 * b[i]; }
        for (i = 0; i < 4; i++) { s1[i] += a1 * b[i]; }
        for (i = 0; i < 4; i++) { s2[i] += a2 * b[i]; }
        for (i = 0; i < 4; i++) { s3[i] += a3 * b[i]; }
        a += lda;
        b += ldb;
    }
    for (i = 0; i < 4; i++) { c[i] += s0[i]; }
    for (i = 0; i < 4; i++) { c[ldc + i] += s1[i]; }
    for (i = 0; i < 4; i++) { c[2 * ldc + i] += s2[i]; }
    for (i = 0; i < 4; i++) { c[3 * ldc + i] += s3[i]; }
}

/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < width; width is a multiple of 4. */
static void riccati_rows(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int width)
{
    int j;
    for (j = 0; j + 8 <= width; j += 8) {
        riccati_block_8(c + j, ldc, a, lda, b + j, ldb, n);
    }
    if (j < width) {
        riccati_block_4(c + j, ldc, a, lda, b + j, ldb, n);
    }
}

/* y[j] += a x[j],  j < n; n is a multiple of 4. */
static inline void riccati_add(real_t *y, real_t a, const real_t *x, int n)
{
    int j, i;
    for (j = 0; j < n; j += 4) {
        real_t s[4];
        for (i = 0; i < 4; i++) { s[i] = y[j + i] + a * x[j + i]; }
        for (i = 0; i < 4; i++) { y[j + i] = s[i]; }
    }
}

/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width. */
static inline void riccati_combine(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int eights = width / 8 * 8, fours = width / 4 * 4;
    int j, i, l;
    for (j = 0; j < eights; j += 8) {
        real_t s[8] = {0};
        for (l = 0; l < n; l++) {
            const real_t *row = rows + l * ld + j;
            for (i = 0; i < 8; i++) { s[i] += a[l] * row[i]; }
        }
        for (i = 0; i < 8; i++) { y[j + i] += s[i]; }
    }
    for (j = eights; j < fours; j += 4) {
        real_t s[4] = {0};
        for (l = 0; l < n; l++) {
            const real_t *row = rows + l * ld + j;
            for (i = 0; i < 4; i++) { s[i] += a[l] * row[i]; }
        }
        for (i = 0; i < 4; i++) { y[j + i] += s[i]; }
    }
    for (j = fours; j < width; j++) {
        real_t sum = R(0);
        for (l = 0; l < n; l++) {
            sum += a[l] * rows[l * ld + j];
        }
        y[j] += sum;
    }
}

/* sum_j a[j] b[j],  j < n. */
static inline real_t riccati_dot(const real_t *a, const real_t *b, int n)
{
    real_t s[8] = {0}, t[4];
    real_t sum = R(0);
    const int eights = n / 8 * 8, fours = n / 4 * 4;
    int j, i;
    for (j = 0; j < eights; j += 8) {
        for (i = 0; i < 8; i++) { s[i] += a[j + i] * b[j + i]; }
    }
    for (i = 0; i < 4; i++) { t[i] = s[i] + s[i + 4]; }
    for (j = eights; j < fours; j += 4) {
        for (i = 0; i < 4; i++) { t[i] += a[j + i] * b[j + i]; }
    }
    for (j = fours; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum + ((t[0] + t[2]) + (t[1] + t[3]));
}
