#include "riccati/tiles_lanes.c"

/* Contract of this part: the functions of riccati/linear_algebra.c and riccati/blocks.c on packs. They are inlined, so
 * that sizes are constants. */

/* PACK_WIDTH packs, one per row. */
typedef struct {
    pack_t r0, r1, r2, r3, r4, r5, r6, r7;
} packs_t;

/* (a0 + a1, b0 + b1, a2 + a3, b2 + b3, ...) */
PACK_INLINE pack_t pack_pairs(pack_t a, pack_t b)
{
#if PACK_WIDTH == 8
    const pack_t even = __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14);
    const pack_t odd = __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
#else
    const pack_t even = __builtin_shufflevector(a, b, 0, 4, 2, 6);
    const pack_t odd = __builtin_shufflevector(a, b, 1, 5, 3, 7);
#endif
    return even + odd;
}

/* The same with pairs of numbers in the place of numbers: sums of the pairs of a, then of the pairs of b. */
PACK_INLINE pack_t pack_fold(pack_t a, pack_t b)
{
#if PACK_WIDTH == 8
    const pack_t even = __builtin_shufflevector(a, b, 0, 1, 4, 5, 8, 9, 12, 13);
    const pack_t odd = __builtin_shufflevector(a, b, 2, 3, 6, 7, 10, 11, 14, 15);
#else
    const pack_t even = __builtin_shufflevector(a, b, 0, 1, 4, 5);
    const pack_t odd = __builtin_shufflevector(a, b, 2, 3, 6, 7);
#endif
    return even + odd;
}

/* The sums of the rows. */
PACK_INLINE pack_t packs_sums(const packs_t *a)
{
    const pack_t first = pack_fold(pack_pairs(a->r0, a->r1), pack_pairs(a->r2, a->r3));
    if (PACK_WIDTH == 8) {
        const pack_t second = pack_fold(pack_pairs(a->r4, a->r5), pack_pairs(a->r6, a->r7));
        return pack_fold(first, second);
    } else {
        return first;
    }
}

/* c[r] += row r of A times b,  r < rows <= PACK_WIDTH,  n <= PACK_WIDTH columns */
PACK_INLINE void packs_add(packs_t *c, const real_t *A, int ld, pack_t b, int rows, int n)
{
    c->r0 += pack_load(A, n) * b;
    if (rows > 1) {
        c->r1 += pack_load(A + ld, n) * b;
    }
    if (rows > 2) {
        c->r2 += pack_load(A + 2 * ld, n) * b;
    }
    if (rows > 3) {
        c->r3 += pack_load(A + 3 * ld, n) * b;
    }
    if (rows > 4) {
        c->r4 += pack_load(A + 4 * ld, n) * b;
    }
    if (rows > 5) {
        c->r5 += pack_load(A + 5 * ld, n) * b;
    }
    if (rows > 6) {
        c->r6 += pack_load(A + 6 * ld, n) * b;
    }
    if (rows > 7) {
        c->r7 += pack_load(A + 7 * ld, n) * b;
    }
}

PACK_INLINE void packs_clear(packs_t *c)
{
    const pack_t zero = {0};
    c->r0 = zero;
    c->r1 = zero;
    c->r2 = zero;
    c->r3 = zero;
    c->r4 = zero;
    c->r5 = zero;
    c->r6 = zero;
    c->r7 = zero;
}

/* sum_j A[i][j] x[j],  i < rows <= PACK_WIDTH,  j < n; x has whole packs. */
PACK_INLINE pack_t riccati_row_products(const real_t *A, int ld, const real_t *x, int rows, int n)
{
    const int done = n / PACK_WIDTH * PACK_WIDTH;
    packs_t c;
    packs_clear(&c);
#pragma GCC unroll 4
    for (int j = 0; j < done; j += PACK_WIDTH) {
        packs_add(&c, A + j, ld, *(const pack_t *)(x + j), rows, PACK_WIDTH);
    }
    if (n > done) {
        packs_add(&c, A + done, ld, *(const pack_t *)(x + done), rows, n - done);
    }
    return packs_sums(&c);
}

/* y[j] += sum_{l<n} a[l] rows[l][j], j < width <= TILE_WIDTH; in four sums, as one is a chain of dependent
 * operations */
PACK_INLINE void riccati_combine_strip(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int fours = n / 4 * 4;
    tile_t c;
    tile_clear(&c);
    c.r0 = strip_load(y, width);
    for (int l = 0; l < fours; l += 4) {
        strip_add_row(&c.r0, a[l], rows, width);
        strip_add_row(&c.r1, a[l + 1], rows + ld, width);
        strip_add_row(&c.r2, a[l + 2], rows + 2 * ld, width);
        strip_add_row(&c.r3, a[l + 3], rows + 3 * ld, width);
        rows += 4 * ld;
    }
    for (int l = fours; l < n; l++) {
        strip_add_row(&c.r0, a[l], rows, width);
        rows += ld;
    }
    strip_add(&c.r0, R(1), &c.r1);
    strip_add(&c.r2, R(1), &c.r3);
    strip_add(&c.r0, R(1), &c.r2);
    strip_store(y, &c.r0, width);
}

/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width */
PACK_INLINE void riccati_combine(real_t *y, const real_t *a, const real_t *rows, int ld, int n, int width)
{
    const int done = width / TILE_WIDTH * TILE_WIDTH;
    for (int j = 0; j < done; j += TILE_WIDTH) {
        riccati_combine_strip(y + j, a, rows + j, ld, n, TILE_WIDTH);
    }
    if (width > done) {
        riccati_combine_strip(y + done, a, rows + done, ld, n, width - done);
    }
}

/* y[j] += a x[j],  j < n */
PACK_INLINE void riccati_add(real_t *y, real_t a, const real_t *x, int n)
{
    const int done = n / PACK_WIDTH * PACK_WIDTH;
    for (int j = 0; j < done; j += PACK_WIDTH) {
        pack_store(y + j, pack_load(y + j, PACK_WIDTH) + a * pack_load(x + j, PACK_WIDTH), PACK_WIDTH);
    }
    if (n > done) {
        pack_store(y + done, pack_load(y + done, n - done) + a * pack_load(x + done, n - done), n - done);
    }
}

/* sum_j a[j] b[j],  j < n */
PACK_INLINE real_t riccati_dot(const real_t *a, const real_t *b, int n)
{
    const int done = n / PACK_WIDTH * PACK_WIDTH;
    pack_t sum = {0};
    for (int j = 0; j < done; j += PACK_WIDTH) {
        sum += pack_load(a + j, PACK_WIDTH) * pack_load(b + j, PACK_WIDTH);
    }
    if (n > done) {
        sum += pack_load(a + done, n - done) * pack_load(b + done, n - done);
    }
    return pack_sum(sum);
}

/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < width; width is a multiple of 4. */
PACK_INLINE void riccati_rows(real_t *c, int ldc, const real_t *a, int lda, const real_t *b, int ldb, int n, int width)
{
    tile_t t;
    for (int j = 0; j + PACK_WIDTH <= width; j += PACK_WIDTH) {
        tile_load(&t, c + j, ldc, 4, PACK_WIDTH);
        tile_accumulate(&t, a, lda, 1, b + j, ldb, n, 4, PACK_WIDTH);
        tile_store(c + j, ldc, &t, 4, PACK_WIDTH);
    }
    if (PACK_WIDTH == 8) {
        if (width % PACK_WIDTH) {
            tile_load(&t, c + width - 4, ldc, 4, 4);
            tile_accumulate(&t, a, lda, 1, b + width - 4, ldb, n, 4, 4);
            tile_store(c + width - 4, ldc, &t, 4, 4);
        }
    }
}

/* *c += row b, *y += x_r row */
PACK_INLINE void packs_add_both_row(pack_t *c, pack_t *y, const real_t *row, pack_t b, real_t x_r)
{
    const pack_t v = pack_load(row, PACK_WIDTH);
    *c += v * b;
    *y += x_r * v;
}

/* c[r] += row r of A times b,  *y += A'x,  r < rows <= PACK_WIDTH */
PACK_INLINE void packs_add_both(packs_t *c, pack_t *y, const real_t *A, int ld, pack_t b, const real_t *x, int rows)
{
    pack_t even = *y, odd = {0};
    packs_add_both_row(&c->r0, &even, A, b, x[0]);
    if (rows > 1) {
        packs_add_both_row(&c->r1, &odd, A + ld, b, x[1]);
    }
    if (rows > 2) {
        packs_add_both_row(&c->r2, &even, A + 2 * ld, b, x[2]);
    }
    if (rows > 3) {
        packs_add_both_row(&c->r3, &odd, A + 3 * ld, b, x[3]);
    }
    if (rows > 4) {
        packs_add_both_row(&c->r4, &even, A + 4 * ld, b, x[4]);
    }
    if (rows > 5) {
        packs_add_both_row(&c->r5, &odd, A + 5 * ld, b, x[5]);
    }
    if (rows > 6) {
        packs_add_both_row(&c->r6, &even, A + 6 * ld, b, x[6]);
    }
    if (rows > 7) {
        packs_add_both_row(&c->r7, &odd, A + 7 * ld, b, x[7]);
    }
    *y = even + odd;
}

/* Row n - 1 of a block on the diagonal: *c += its first n numbers times x, *y += x_{n-1} times its first n - 1. */
PACK_INLINE void packs_add_diagonal_row(pack_t *c, pack_t *y, const real_t *row, const real_t *x, int n)
{
    *c += pack_load(row, n) * pack_load(x, n);
    if (n > 1) {
        *y += x[n - 1] * pack_load(row, n - 1);
    }
}

/* c[r] += row r of A times x up to the diagonal, *y += x times the columns below the diagonal */
PACK_INLINE void packs_add_diagonal(packs_t *c, pack_t *y, const real_t *A, int ld, const real_t *x, int rows)
{
    packs_add_diagonal_row(&c->r0, y, A, x, 1);
    if (rows > 1) {
        packs_add_diagonal_row(&c->r1, y, A + ld, x, 2);
    }
    if (rows > 2) {
        packs_add_diagonal_row(&c->r2, y, A + 2 * ld, x, 3);
    }
    if (rows > 3) {
        packs_add_diagonal_row(&c->r3, y, A + 3 * ld, x, 4);
    }
    if (rows > 4) {
        packs_add_diagonal_row(&c->r4, y, A + 4 * ld, x, 5);
    }
    if (rows > 5) {
        packs_add_diagonal_row(&c->r5, y, A + 5 * ld, x, 6);
    }
    if (rows > 6) {
        packs_add_diagonal_row(&c->r6, y, A + 6 * ld, x, 7);
    }
    if (rows > 7) {
        packs_add_diagonal_row(&c->r7, y, A + 7 * ld, x, 8);
    }
}

/* Rows i .. i + rows - 1 of the lower triangle of A in riccati_add_symmetric; y has whole packs. */
PACK_INLINE void riccati_add_symmetric_rows(pack_t *y, const real_t *A, int ld, const real_t *x, int i, int rows)
{
    const real_t *row = A + i * ld;
    pack_t *last = y + i / PACK_WIDTH;
    packs_t c;
    packs_clear(&c);
    for (int j = 0; j < i; j += PACK_WIDTH) {
        packs_add_both(&c, y + j / PACK_WIDTH, row + j, ld, pack_load(x + j, PACK_WIDTH), x + i, rows);
    }
    packs_add_diagonal(&c, last, row + i, ld, x + i, rows);
    *last += packs_sums(&c);
}

/* y += A x, where A is symmetric of n rows (lower triangle). */
PACK_INLINE void riccati_add_symmetric(real_t *y, const real_t *A, int ld, const real_t *x, int n)
{
    const int done = n / PACK_WIDTH * PACK_WIDTH;
    pack_t sum[PACKED(NZ) / PACK_WIDTH]; /* n <= NZ */
    for (int j = 0; j < n; j += PACK_WIDTH) {
        sum[j / PACK_WIDTH] = pack_load(y + j, n - j);
    }
    for (int i = 0; i < done; i += PACK_WIDTH) {
        riccati_add_symmetric_rows(sum, A, ld, x, i, PACK_WIDTH);
    }
    if (n > done) {
        riccati_add_symmetric_rows(sum, A, ld, x, done, n - done);
    }
    for (int j = 0; j < n; j += PACK_WIDTH) {
        pack_store(y + j, sum[j / PACK_WIDTH], n - j);
    }
}
