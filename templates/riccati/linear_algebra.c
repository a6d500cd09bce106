#if HOST_LANES > 2
#include "riccati/linear_algebra_lanes.c"
#else
#include "riccati/blocks.c"

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

#include "riccati/dot.c"

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
#endif
