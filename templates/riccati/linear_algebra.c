#if TILES
#include "riccati/linear_algebra_lanes.c"
#else
#if SCALAR
#include "riccati/blocks_scalar.c"

#include "riccati/combine_scalar.c"

#include "riccati/dot_scalar.c"

#if SMALL
#include "riccati/products_unpadded.c"
#endif
#else
#include "riccati/blocks.c"

#include "riccati/combine.c"

#include "riccati/dot.c"
#endif

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
