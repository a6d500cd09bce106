/* r = x - n pi / 2, its rest and n, for the lanes that are too large for lanes_reduce_moderate(). */
static __attribute__((noinline)) void lanes_large_angles(const lanes_t *x, lanes_t *r, lanes_t *rest, words_t *n)
{
    for (int l = 0; l < VECTOR_LANES; l++) {
        if (!(FABS((*x)[l]) <= LARGEST_ANGLE)) {
            real_t lost;
            bits_t quadrant;
            (*r)[l] = large_angle((*x)[l], &lost, &quadrant);
            (*rest)[l] = lost;
            (*n)[l] = quadrant;
        }
    }
}

/* r = x - n pi / 2,  |r| <= pi / 4, its rest, and n in the lowest bits. */
LANES_INLINE lanes_t lanes_reduce_moderate(lanes_t x, lanes_t *rest, words_t *n);
LANES_INLINE lanes_t lanes_reduce(lanes_t x, lanes_t *rest, words_t *n)
{
    lanes_t r = lanes_reduce_moderate(x, rest, n);
    if (lanes_any((mask_t)(x > LARGEST_ANGLE) | (mask_t)(x < -LARGEST_ANGLE))) {
        const lanes_t angles = x;
        lanes_t reduced = r, lost = *rest;
        words_t quadrants = *n;
        lanes_large_angles(&angles, &reduced, &lost, &quadrants);
        r = reduced;
        *rest = lost;
        *n = quadrants;
    }
    return r;
}
