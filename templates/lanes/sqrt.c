LANES_INLINE lanes_t lanes_sqrt(lanes_t x)
{
#if AVX512 && !SINGLE && VECTOR_LANES == 8
    return (lanes_t)_mm512_sqrt_pd((__m512d)x);
#else
    lanes_t y;
    for (int l = 0; l < VECTOR_LANES; l++) {
        y[l] = SQRT(x[l]);
    }
    return y;
#endif
}
