#include "riccati/packs_lanes.c"

/* Tiles: up to TILE_ROWS rows of three packs, which stay in registers while a product is accumulated. */

#if PACK_WIDTH == 8
#define TILE_ROWS 7
#else
#define TILE_ROWS 4
#endif
#define TILE_WIDTH (3 * PACK_WIDTH)

typedef struct {
    pack_t v0, v1, v2;
} strip_t;

typedef struct {
    strip_t r0, r1, r2, r3, r4, r5, r6;
} tile_t;

/* `width` numbers of a row, at most TILE_WIDTH, then zeros. */
PACK_INLINE strip_t strip_load(const real_t *p, int width)
{
    const pack_t zero = {0};
    strip_t s = {zero, zero, zero};
    s.v0 = pack_load(p, width);
    if (width > PACK_WIDTH) {
        s.v1 = pack_load(p + PACK_WIDTH, width - PACK_WIDTH);
    }
    if (width > 2 * PACK_WIDTH) {
        s.v2 = pack_load(p + 2 * PACK_WIDTH, width - 2 * PACK_WIDTH);
    }
    return s;
}

PACK_INLINE void strip_store(real_t *p, const strip_t *s, int width)
{
    pack_store(p, s->v0, width);
    if (width > PACK_WIDTH) {
        pack_store(p + PACK_WIDTH, s->v1, width - PACK_WIDTH);
    }
    if (width > 2 * PACK_WIDTH) {
        pack_store(p + 2 * PACK_WIDTH, s->v2, width - 2 * PACK_WIDTH);
    }
}

/* c += a b */
PACK_INLINE void strip_add(strip_t *c, real_t a, const strip_t *b)
{
    c->v0 += a * b->v0;
    c->v1 += a * b->v1;
    c->v2 += a * b->v2;
}

/* c += a times `width` numbers of a row */
PACK_INLINE void strip_add_row(strip_t *c, real_t a, const real_t *row, int width)
{
    const strip_t s = strip_load(row, width);
    strip_add(c, a, &s);
}

PACK_INLINE void tile_clear(tile_t *c)
{
    const pack_t zero = {0};
    const strip_t s = {zero, zero, zero};
    c->r0 = s;
    c->r1 = s;
    c->r2 = s;
    c->r3 = s;
    c->r4 = s;
    c->r5 = s;
    c->r6 = s;
}

PACK_INLINE void tile_load(tile_t *c, const real_t *p, int ld, int rows, int width)
{
    tile_clear(c);
    c->r0 = strip_load(p, width);
    if (rows > 1) {
        c->r1 = strip_load(p + ld, width);
    }
    if (rows > 2) {
        c->r2 = strip_load(p + 2 * ld, width);
    }
    if (rows > 3) {
        c->r3 = strip_load(p + 3 * ld, width);
    }
    if (rows > 4) {
        c->r4 = strip_load(p + 4 * ld, width);
    }
    if (rows > 5) {
        c->r5 = strip_load(p + 5 * ld, width);
    }
    if (rows > 6) {
        c->r6 = strip_load(p + 6 * ld, width);
    }
}

PACK_INLINE void tile_store(real_t *p, int ld, const tile_t *c, int rows, int width)
{
    strip_store(p, &c->r0, width);
    if (rows > 1) {
        strip_store(p + ld, &c->r1, width);
    }
    if (rows > 2) {
        strip_store(p + 2 * ld, &c->r2, width);
    }
    if (rows > 3) {
        strip_store(p + 3 * ld, &c->r3, width);
    }
    if (rows > 4) {
        strip_store(p + 4 * ld, &c->r4, width);
    }
    if (rows > 5) {
        strip_store(p + 5 * ld, &c->r5, width);
    }
    if (rows > 6) {
        strip_store(p + 6 * ld, &c->r6, width);
    }
}

/* c[r] += a[r * step] b,  r < rows */
PACK_INLINE void tile_add(tile_t *c, const real_t *a, int step, const strip_t *b, int rows)
{
    strip_add(&c->r0, a[0], b);
    if (rows > 1) {
        strip_add(&c->r1, a[step], b);
    }
    if (rows > 2) {
        strip_add(&c->r2, a[2 * step], b);
    }
    if (rows > 3) {
        strip_add(&c->r3, a[3 * step], b);
    }
    if (rows > 4) {
        strip_add(&c->r4, a[4 * step], b);
    }
    if (rows > 5) {
        strip_add(&c->r5, a[5 * step], b);
    }
    if (rows > 6) {
        strip_add(&c->r6, a[6 * step], b);
    }
}

/* c[r][j] += sum_{l<n} a[l * along + r * across] b[l][j],  r < rows, j < width */
PACK_INLINE void tile_accumulate(
    tile_t *c, const real_t *a, int along, int across, const real_t *b, int ldb, int n, int rows, int width)
{
#pragma GCC unroll 4
    for (int l = 0; l < n; l++) {
        const strip_t s = strip_load(b, width);
        tile_add(c, a, across, &s, rows);
        a += along;
        b += ldb;
    }
}

/* Step l of tile_symmetric. */
PACK_INLINE void tile_symmetric_step(tile_t *c, const real_t *D, int ld, int l, const real_t *b, int rows, int width)
{
    const strip_t s = strip_load(b, width);
    strip_add(&c->r0, D[l * ld], &s);
    if (rows > 1) {
        strip_add(&c->r1, (l < 1) ? D[ld + l] : D[l * ld + 1], &s);
    }
    if (rows > 2) {
        strip_add(&c->r2, (l < 2) ? D[2 * ld + l] : D[l * ld + 2], &s);
    }
    if (rows > 3) {
        strip_add(&c->r3, (l < 3) ? D[3 * ld + l] : D[l * ld + 3], &s);
    }
    if (rows > 4) {
        strip_add(&c->r4, (l < 4) ? D[4 * ld + l] : D[l * ld + 4], &s);
    }
    if (rows > 5) {
        strip_add(&c->r5, (l < 5) ? D[5 * ld + l] : D[l * ld + 5], &s);
    }
    if (rows > 6) {
        strip_add(&c->r6, (l < 6) ? D[6 * ld + l] : D[l * ld + 6], &s);
    }
}

/* c += D b, where the rows x rows matrix D is symmetric (lower triangle). */
PACK_INLINE void tile_symmetric(tile_t *c, const real_t *D, int ld, const real_t *b, int ldb, int rows, int width)
{
    tile_symmetric_step(c, D, ld, 0, b, rows, width);
    if (rows > 1) {
        tile_symmetric_step(c, D, ld, 1, b + ldb, rows, width);
    }
    if (rows > 2) {
        tile_symmetric_step(c, D, ld, 2, b + 2 * ldb, rows, width);
    }
    if (rows > 3) {
        tile_symmetric_step(c, D, ld, 3, b + 3 * ldb, rows, width);
    }
    if (rows > 4) {
        tile_symmetric_step(c, D, ld, 4, b + 4 * ldb, rows, width);
    }
    if (rows > 5) {
        tile_symmetric_step(c, D, ld, 5, b + 5 * ldb, rows, width);
    }
    if (rows > 6) {
        tile_symmetric_step(c, D, ld, 6, b + 6 * ldb, rows, width);
    }
}
