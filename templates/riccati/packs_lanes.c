/* Packs: GNU C vectors of PACK_WIDTH numbers. Loads and stores need no alignment, and a part of n < PACK_WIDTH numbers
 * touches no other memory. All sizes are constants after inlining, so that conditions on them vanish. */

/* On a processor with shorter registers compilers warn that vectors are passed in memory; all functions that take them
 * are inlined. */
#pragma GCC diagnostic ignored "-Wpsabi"

#define PACK_INLINE static inline __attribute__((always_inline, unused))

typedef real_t pack_t __attribute__((vector_size(PACK_WIDTH * sizeof(real_t))));
typedef real_t loose_pack_t
    __attribute__((vector_size(PACK_WIDTH * sizeof(real_t)), aligned(sizeof(real_t)), may_alias));
typedef real_t pack4_t __attribute__((vector_size(4 * sizeof(real_t))));
typedef real_t loose_quad_t __attribute__((vector_size(4 * sizeof(real_t)), aligned(sizeof(real_t)), may_alias));

/* n rounded up to whole packs. */
#define PACKED(n) (((n) + PACK_WIDTH - 1) / PACK_WIDTH * PACK_WIDTH)

/* Arrays of this type start at a cache line. */
#define PACK_ALIGNED __attribute__((aligned(64)))

/* The first n < 4 numbers, then zeros. */
PACK_INLINE pack4_t quad_part(const real_t *p, int n)
{
    pack4_t v = {0};
    if (n == 1) {
        v = (pack4_t){p[0], 0, 0, 0};
    } else if (n == 2) {
        v = (pack4_t){p[0], p[1], 0, 0};
    } else if (n == 3) {
        v = (pack4_t){p[0], p[1], p[2], 0};
    }
    return v;
}

/* The first n numbers, at most PACK_WIDTH, then zeros. */
PACK_INLINE pack_t pack_load(const real_t *p, int n)
{
    if (n >= PACK_WIDTH) {
        return *(const loose_pack_t *)p;
    }
#if PACK_WIDTH == 8
    const pack4_t zero = {0};
    if (n >= 4) {
        return __builtin_shufflevector(
            (pack4_t) * (const loose_quad_t *)p, quad_part(p + 4, n - 4), 0, 1, 2, 3, 4, 5, 6, 7);
    }
    return __builtin_shufflevector(quad_part(p, n), zero, 0, 1, 2, 3, 4, 5, 6, 7);
#else
    return quad_part(p, n);
#endif
}

/* Stores the first n numbers, at most PACK_WIDTH. */
PACK_INLINE void pack_store(real_t *p, pack_t v, int n)
{
    int done = 0;
    if (n >= PACK_WIDTH) {
        *(loose_pack_t *)p = v;
        return;
    }
    if (PACK_WIDTH == 8) {
        if (n >= 4) {
            *(loose_quad_t *)p = __builtin_shufflevector(v, v, 0, 1, 2, 3);
            done = 4;
        }
    }
    if (n > done) {
        p[done] = v[done];
    }
    if (n > done + 1) {
        p[done + 1] = v[done + 1];
    }
    if (n > done + 2) {
        p[done + 2] = v[done + 2];
    }
}

/* The sum of all numbers. */
PACK_INLINE real_t pack_sum(pack_t v)
{
#if PACK_WIDTH == 8
    const pack4_t s = __builtin_shufflevector(v, v, 0, 1, 2, 3) + __builtin_shufflevector(v, v, 4, 5, 6, 7);
#else
    const pack4_t s = v;
#endif
    return (s[0] + s[2]) + (s[1] + s[3]);
}
