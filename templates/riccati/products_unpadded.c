/* Products of matrices without padding. Whole blocks have four rows and columns; the other entries are computed one by
 * one. */

/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < rows, from <= j < to. */
static void riccati_entries(
    real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int rows, int from, int to)
{
    for (int r = 0; r < rows; r++) {
        for (int j = from; j < to; j++) {
            real_t sum = R(0);
            for (int l = 0; l < n; l++) {
                sum += a[l * lda + r] * b[l * ldb + j];
            }
            c[r * ldc + j] += sum;
        }
    }
}

/* c[i][j] += sum_{l<n} a[l][i] b[l][j],  i < rows, j < width. */
static void riccati_product(
    real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int rows, int width)
{
    const int whole = rows / 4 * 4, fours = width / 4 * 4, last = whole * ldc;
    for (int i = 0; i < whole; i += 4) {
        const int row = i * ldc;
        riccati_rows(c + row, ldc, a + i, lda, b, ldb, n, fours);
        riccati_entries(c + row, ldc, a + i, lda, b, ldb, n, 4, fours, width);
    }
    riccati_entries(c + last, ldc, a + whole, lda, b, ldb, n, rows - whole, 0, width);
}

/* Computes the product for a square matrix c: its lower triangle, and some entries above its diagonal. */
static void riccati_lower(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int rows)
{
    const int whole = rows / 4 * 4, last = whole * ldc;
    for (int i = 0; i < whole; i += 4) {
        const int row = i * ldc;
        riccati_rows(c + row, ldc, a + i, lda, b, ldb, n, i + 4);
    }
    riccati_entries(c + last, ldc, a + whole, lda, b, ldb, n, rows - whole, 0, rows);
}
