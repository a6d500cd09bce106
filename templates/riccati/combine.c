/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width <= BLOCK_WIDTH. */
static inline void riccati_combine_strip(real_t *y, const real_t *a, const real_t *rows, int ld, int n, const int width)
{
    real_t s[BLOCK_WIDTH] = {0};
    for (int l = 0; l < n; l++) {
        for (int i = 0; i < width; i++) {
            s[i] += a[l] * rows[i];
        }
        rows += ld;
    }
    for (int i = 0; i < width; i++) {
        y[i] += s[i];
    }
}

/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width, for any width. */
static inline void riccati_combine(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int whole = width / BLOCK_WIDTH * BLOCK_WIDTH, fours = width / 4 * 4;
    for (int j = 0; j < whole; j += BLOCK_WIDTH) {
        riccati_combine_strip(y + j, a, rows + j, ld, n, BLOCK_WIDTH);
    }
    if (whole < fours) {
        riccati_combine_strip(y + whole, a, rows + whole, ld, n, 4);
    }
    for (int j = fours; j < width; j++) {
        real_t sum = R(0);
        for (int l = 0; l < n; l++) {
            sum += a[l] * rows[l * ld + j];
        }
        y[j] += sum;
    }
}
