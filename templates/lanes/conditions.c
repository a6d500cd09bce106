/* Comparisons and choices: 1 where a condition holds, 0 elsewhere. */
LANES_INLINE lanes_t lanes_one_where(mask_t mask)
{
    return (lanes_t)((mask_t)lanes_all(R(1)) & mask);
}

LANES_INLINE lanes_t lanes_lt(lanes_t a, lanes_t b)
{
    return lanes_one_where((mask_t)(a < b));
}

LANES_INLINE lanes_t lanes_le(lanes_t a, lanes_t b)
{
    return lanes_one_where((mask_t)(a <= b));
}

LANES_INLINE lanes_t lanes_eq(lanes_t a, lanes_t b)
{
    return lanes_one_where((mask_t)(a == b));
}

LANES_INLINE lanes_t lanes_ne(lanes_t a, lanes_t b)
{
    return lanes_one_where((mask_t)(a != b));
}

LANES_INLINE lanes_t lanes_not(lanes_t a)
{
    return lanes_one_where((mask_t)(a == R(0)));
}

LANES_INLINE lanes_t lanes_and(lanes_t a, lanes_t b)
{
    return lanes_one_where((mask_t)(a != R(0)) & (mask_t)(b != R(0)));
}

LANES_INLINE lanes_t lanes_or(lanes_t a, lanes_t b)
{
    return lanes_one_where((mask_t)(a != R(0)) | (mask_t)(b != R(0)));
}

LANES_INLINE lanes_t lanes_if_else_zero(lanes_t a, lanes_t b)
{
    return (lanes_t)((mask_t)b & (mask_t)(a != R(0)));
}

LANES_INLINE lanes_t lanes_sign(lanes_t a)
{
    return lanes_one_where((mask_t)(a > R(0))) - lanes_one_where((mask_t)(a < R(0)));
}
