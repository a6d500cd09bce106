/* Four rows of a matrix product: c[r][j] += sum_{l<n} a[l][r] b[l][j], r < 4, j < 8. */
static inline void riccati_block_8(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n)
{
    real_t s0[8] = {0}, s1[8] = {0}, s2[8] = {0}, s3[8] = {0};
    for (int l = 0; l < n; l++) {
        const real_t a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (int i = 0; i < 8; i++) {
            s0[i] += a0 * b[i];
        }
        for (int i = 0; i < 8; i++) {
            s1[i] += a1 * b[i];
        }
        for (int i = 0; i < 8; i++) {
            s2[i] += a2 * b[i];
        }
        for (int i = 0; i < 8; i++) {
            s3[i] += a3 * b[i];
        }
        a += lda;
        b += ldb;
    }
    for (int i = 0; i < 8; i++) {
        c[i] += s0[i];
    }
    for (int i = 0; i < 8; i++) {
        c[ldc + i] += s1[i];
    }
    for (int i = 0; i < 8; i++) {
        c[2 * ldc + i] += s2[i];
    }
    for (int i = 0; i < 8; i++) {
        c[3 * ldc + i] += s3[i];
    }
}

/* The same for j < 4. */
static inline void riccati_block_4(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n)
{
    real_t s0[4] = {0}, s1[4] = {0}, s2[4] = {0}, s3[4] = {0};
    for (int l = 0; l < n; l++) {
        const real_t a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (int i = 0; i < 4; i++) {
            s0[i] += a0 * b[i];
        }
        for (int i = 0; i < 4; i++) {
            s1[i] += a1 * b[i];
        }
        for (int i = 0; i < 4; i++) {
            s2[i] += a2 * b[i];
        }
        for (int i = 0; i < 4; i++) {
            s3[i] += a3 * b[i];
        }
        a += lda;
        b += ldb;
    }
    for (int i = 0; i < 4; i++) {
        c[i] += s0[i];
    }
    for (int i = 0; i < 4; i++) {
        c[ldc + i] += s1[i];
    }
    for (int i = 0; i < 4; i++) {
        c[2 * ldc + i] += s2[i];
    }
    for (int i = 0; i < 4; i++) {
        c[3 * ldc + i] += s3[i];
    }
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

/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width. */
static inline void riccati_combine(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int eights = width / 8 * 8, fours = width / 4 * 4;
    for (int j = 0; j < eights; j += 8) {
        const real_t *row = rows + j;
        real_t s[8] = {0};
        for (int l = 0; l < n; l++) {
            for (int i = 0; i < 8; i++) {
                s[i] += a[l] * row[i];
            }
            row += ld;
        }
        for (int i = 0; i < 8; i++) {
            y[j + i] += s[i];
        }
    }
    for (int j = eights; j < fours; j += 4) {
        const real_t *row = rows + j;
        real_t s[4] = {0};
        for (int l = 0; l < n; l++) {
            for (int i = 0; i < 4; i++) {
                s[i] += a[l] * row[i];
            }
            row += ld;
        }
        for (int i = 0; i < 4; i++) {
            y[j + i] += s[i];
        }
    }
    for (int j = fours; j < width; j++) {
        real_t sum = R(0);
        for (int l = 0; l < n; l++) {
            sum += a[l] * rows[l * ld + j];
        }
        y[j] += sum;
    }
}

/* sum_j a[j] b[j],  j < n. */
static inline real_t riccati_dot(const real_t *a, const real_t *b, int n)
{
    const int eights = n / 8 * 8, fours = n / 4 * 4;
    real_t s[8] = {0}, sum = R(0);
    for (int j = 0; j < eights; j += 8) {
        for (int i = 0; i < 8; i++) {
            s[i] += a[j + i] * b[j + i];
        }
    }
    for (int i = 0; i < 4; i++) {
        s[i] += s[i + 4];
    }
    for (int j = eights; j < fours; j += 4) {
        for (int i = 0; i < 4; i++) {
            s[i] += a[j + i] * b[j + i];
        }
    }
    for (int j = fours; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum + ((s[0] + s[2]) + (s[1] + s[3]));
}

#if BLOCK_ROWS || !HAS_COST_GRADIENT || !HAS_TERMINAL_ADJOINT
/* y += Q z, where Q is symmetric of n rows (lower triangle). Every entry is read once, in blocks of four. */
static void riccati_add_symmetric(real_t *y, const real_t *Q, int ld, const real_t *z, int n)
{
    const real_t *row = Q;
    for (int i = 0; i < n; i++) {
        const int fours = i / 4 * 4;
        const real_t z_i = z[i];
        real_t s[4] = {0}, sum = row[i] * z_i;
        for (int j = 0; j < fours; j += 4) {
            real_t t[4];
            for (int l = 0; l < 4; l++) {
                s[l] += row[j + l] * z[j + l];
                t[l] = y[j + l] + z_i * row[j + l];
            }
            for (int l = 0; l < 4; l++) {
                y[j + l] = t[l];
            }
        }
        for (int j = fours; j < i; j++) {
            y[j] += z_i * row[j];
            sum += row[j] * z[j];
        }
        y[i] += sum + ((s[0] + s[2]) + (s[1] + s[3]));
        row += ld;
    }
}
#endif
