/* On a processor with shorter registers compilers warn that vectors are passed in memory; all functions that take them
 * are inlined. */
#pragma GCC diagnostic ignored "-Wpsabi"

/* A call saves no vector register, so that one between two operations would store all of them. */
#define LANES_INLINE static inline __attribute__((always_inline))

/* Numbers of VECTOR_LANES shooting nodes, one per lane, in GNU C vectors. A mask has all bits of a lane set where a
 * condition holds. */
typedef real_t lanes_t __attribute__((vector_size(VECTOR_LANES * sizeof(real_t))));
#if SINGLE
typedef int32_t mask_t __attribute__((vector_size(VECTOR_LANES * sizeof(int32_t))));
typedef uint32_t words_t __attribute__((vector_size(VECTOR_LANES * sizeof(uint32_t))));
#else
typedef int64_t mask_t __attribute__((vector_size(VECTOR_LANES * sizeof(int64_t))));
typedef uint64_t words_t __attribute__((vector_size(VECTOR_LANES * sizeof(uint64_t))));
#endif

/* The number in every lane. */
LANES_INLINE lanes_t lanes_all(real_t value)
{
    const lanes_t zero = {0};
    return value - zero; /* a sum would lose the sign of -0 */
}

/* a where the mask is set, b elsewhere. */
LANES_INLINE lanes_t lanes_select(mask_t mask, lanes_t a, lanes_t b)
{
    return (lanes_t)(((mask_t)a & mask) | ((mask_t)b & ~mask));
}

LANES_INLINE words_t lanes_pick(mask_t mask, words_t a, words_t b)
{
    return (a & (words_t)mask) | (b & ~(words_t)mask);
}

/* The bits of numbers as unsigned integers, and back. */
LANES_INLINE words_t lanes_bits(lanes_t x)
{
    return (words_t)x;
}

LANES_INLINE lanes_t lanes_number(words_t words)
{
    return (lanes_t)words;
}

/* 1 if the mask is set in a lane. */
LANES_INLINE int lanes_any(mask_t mask)
{
#if AVX512 && !SINGLE && VECTOR_LANES == 8
    return _mm512_movepi64_mask((__m512i)mask) != 0;
#else
    int any = 0;
    for (int l = 0; l < VECTOR_LANES; l++) {
        any |= mask[l] != 0;
    }
    return any;
#endif
}

/* Element i of the rows first, first + stride, ..., one row per lane. */
LANES_INLINE lanes_t lanes_gather(const real_t *first, int stride)
{
    lanes_t v;
    for (int l = 0; l < VECTOR_LANES; l++) {
        v[l] = first[l * stride];
    }
    return v;
}

#include "generated/lane_transpose.c"

/* Stores one element of every lane to to, to + stride, ... */
LANES_INLINE void lanes_store(lanes_t v, real_t *to, int stride)
{
    for (int l = 0; l < VECTOR_LANES; l++) {
        to[l * stride] = v[l];
    }
}
