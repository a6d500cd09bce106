/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width. */
static inline void riccati_combine(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int fours = width / 4 * 4;
    for (int j = 0; j < fours; j += 4) {
        const real_t *row = rows + j;
        real_t s0 = R(0), s1 = R(0), s2 = R(0), s3 = R(0);
        for (int l = 0; l < n; l++) {
            s0 += a[l] * row[0];
            s1 += a[l] * row[1];
            s2 += a[l] * row[2];
            s3 += a[l] * row[3];
            row += ld;
        }
        y[j] += s0;
        y[j + 1] += s1;
        y[j + 2] += s2;
        y[j + 3] += s3;
    }
    for (int j = fours; j < width; j++) {
        real_t sum = R(0);
        for (int l = 0; l < n; l++) {
            sum += a[l] * rows[l * ld + j];
        }
        y[j] += sum;
    }
}
