/* atan(u) = u + u z p(z),  z = u^2,  |u| <= 7 / 16. */
static inline real_t own_atan_curve(real_t z)
{
#if SINGLE
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 = (z * 0.19999315F - 0.3333333F) + z2 * (z * 0.10668386F - 0.14256576F);
    return p0 + z4 * -0.062158115F;
#else
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 =
        (z * 0.1999999999998777 - 0.33333333333333326) + z2 * (z * 0.11111110900560475 - 0.1428571428314864);
    const real_t p1 =
        (z * 0.07692087348767168 - 0.09090900195560148) + z2 * (z * 0.05847724720645106 - 0.06663239299107136);
    const real_t p2 = (z * 0.03782521866106712 - 0.05033942776485848) + z2 * -0.017547235157290002;
    return p0 + z4 * (p1 + z4 * p2);
#endif
}

/* Returns atan of a number that is not negative: the tangent of a tabulated angle (or infinity) is subtracted, and the
 * angle, a number and a rest, is added. */
static inline real_t own_atan_positive(real_t x)
{
#if SINGLE
    const real_t half = own_all(0.4636476F), half_rest = own_all(5.0121587e-09F), one = own_all(0.7853982F),
                 one_rest = own_all(-2.1855694e-08F);
    const real_t more = own_all(0.98279375F), more_rest = own_all(-2.5131424e-08F);
#else
    const real_t half = own_all(0.4636476090008061), half_rest = own_all(2.2698777452961687e-17);
    const real_t one = own_all(0.7853981633974483), one_rest = own_all(3.061616997868383e-17);
    const real_t more = own_all(0.982793723247329), more_rest = own_all(1.3903311031230998e-17);
#endif
    const truth_t first = x >= R(0.4375), second = x >= R(0.6875), third = x >= R(1.1875), last = x >= R(2.4375);
    real_t above = x, below = own_all(R(1)), base = own_all(R(0)), rest = base, u, z;
    above = own_select(first, R(2) * x - R(1), above);
    below = own_select(first, x + R(2), below);
    above = own_select(second, x - R(1), above);
    below = own_select(second, x + R(1), below);
    above = own_select(third, x - R(1.5), above);
    below = own_select(third, x * R(1.5) + R(1), below);
    above = own_select(last, own_all(R(-1)), above);
    below = own_select(last, x, below);
    base = own_select(first, half, base);
    base = own_select(second, one, base);
    base = own_select(third, more, base);
    base = own_select(last, own_all(HALF_PI), base);
    rest = own_select(first, half_rest, rest);
    rest = own_select(second, one_rest, rest);
    rest = own_select(third, more_rest, rest);
    rest = own_select(last, own_all(HALF_PI_REST), rest);
    u = above / below;
    z = u * u;
    return base + (u + ((u * z) * own_atan_curve(z) + rest));
}

static real_t own_atan(real_t x)
{
    return own_copysign(own_atan_positive(own_fabs(x)), x);
}

/* Returns the angle of the point (x, y), with the special cases of math.h. */
static real_t own_atan2(real_t y, real_t x)
{
    const real_t above = own_fabs(y), below = own_fabs(x), zero = own_all(R(0));
    const truth_t left = (own_bits(x) >> SIGN_SHIFT) != 0;
    const truth_t both = (above >= INF) & (below >= INF), none = (above <= R(0)) & (below <= R(0));
    real_t quotient = own_select(both, own_all(R(1)), own_select(none, zero, above / below)), angle;
    angle = own_atan_positive(quotient);
    angle = own_select(left, R(2) * HALF_PI - (angle - R(2) * HALF_PI_REST), angle);
    return own_copysign(angle, y);
}

/* asin(u) = u + u z p(z),  z = u^2,  |u| <= 1 / 2. */
static inline real_t own_asin_curve(real_t z)
{
#if SINGLE
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 = (z * 0.07500094F + 0.16666666F) + z2 * (z * 0.031100662F + 0.044599403F);
    const real_t p1 = (z * 0.033690847F + 0.017149238F);
    return p0 + z4 * p1;
#else
    const real_t z2 = z * z, z4 = z2 * z2;
    const real_t p0 =
        (z * 0.07499999999998433 + 0.16666666666666669) + z2 * (z * 0.030381944138531247 + 0.04464285714635543);
    const real_t p1 =
        (z * 0.017352392720869973 + 0.02237217294214989) + z2 * (z * 0.011479177415184906 + 0.013971212973552933);
    const real_t p2 =
        (z * 0.005457506718640357 + 0.01032281435018578) + z2 * (z * -0.014851887071247209 + 0.017400879442694025);
    return p0 + z4 * (p1 + z4 * (p2 + z4 * 0.02875785136742157));
#endif
}

/* asin(sqrt(z)) = root + rest of a z up to 1 / 4. */
static inline real_t own_asin_root(real_t z, real_t *rest)
{
    const real_t whole = own_sqrt(z), root = own_upper(whole), sum = root + whole;
    const real_t lost = (z - root * root) / own_select(sum > R(0), sum, own_all(R(1)));
    *rest = lost + (whole * z) * own_asin_curve(z);
    return root;
}

/* For |x| > 1 / 2, asin(|x|) = pi / 2 - 2 asin(sqrt((1 - |x|) / 2)). */
static real_t own_asin(real_t x)
{
    const real_t size = own_fabs(x), z = x * x, direct = size + (size * z) * own_asin_curve(z);
    real_t rest;
    const real_t root = own_asin_root(R(0.5) - R(0.5) * size, &rest);
    const real_t other = HALF_PI - (R(2) * root - (HALF_PI_REST - R(2) * rest));
    return own_copysign(own_select(size > R(0.5), other, direct), x);
}

static real_t own_acos(real_t x)
{
    const real_t size = own_fabs(x), z = x * x, middle = HALF_PI - (x - (HALF_PI_REST - (x * z) * own_asin_curve(z)));
    real_t rest;
    const real_t root = own_asin_root(R(0.5) - R(0.5) * size, &rest), angle = R(2) * (root + rest);
    const real_t left = R(2) * (HALF_PI - (root - (HALF_PI_REST - rest)));
    return own_select(size <= R(0.5), middle, own_select(x < R(0), left, angle));
}
