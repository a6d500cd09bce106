/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width. */
static inline void riccati_combine(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int whole = width / BLOCK_WIDTH * BLOCK_WIDTH, fours = width / 4 * 4;
    for (int j = 0; j < whole; j += BLOCK_WIDTH) {
        const real_t *row = rows + j;
        real_t s[BLOCK_WIDTH] = {0};
        for (int l = 0; l < n; l++) {
            for (int i = 0; i < BLOCK_WIDTH; i++) {
                s[i] += a[l] * row[i];
            }
            row += ld;
        }
        for (int i = 0; i < BLOCK_WIDTH; i++) {
            y[j + i] += s[i];
        }
    }
    for (int j = whole; j < fours; j += 4) {
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
