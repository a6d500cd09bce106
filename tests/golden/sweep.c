/* recursion: zero
 *   o [3]
 * no operations */
static void recursion_zero(real *o)
{
    o[0] = 0.0F;
    o[1] = 0.0F;
    o[2] = 0.0F;
}

/* recursion: fade
 *   i0 [3]
 *   i1 [3]
 *   o [3]
 * 3 add, 3 mul */
static void recursion_fade(const real *i0, const real *i1, real *o)
{
    const real i0_0 = i0[0];
    const real i1_0 = i1[0];
    const real i0_1 = i0[1];
    const real i1_1 = i1[1];
    const real i0_2 = i0[2];
    const real i1_2 = i1[2];
    const real t2 = 0.5F * i0_0;
    const real t4 = t2 + i1_0;
    const real t6 = 0.5F * i0_1;
    const real t8 = t6 + i1_1;
    const real t10 = 0.5F * i0_2;
    const real t12 = t10 + i1_2;
    o[0] = t4;
    o[1] = t8;
    o[2] = t12;
}

/* recursion: double
 *   i0 [1]
 *   o [1]
 * 1 add */
static void recursion_double(const real *i0, real *o)
{
    const real i0_0 = i0[0];
    const real t1 = i0_0 + i0_0;
    o[0] = t1;
}

/* a test of everything
 *   A [12]
 *   y [3]
 *   Y [2 x 3]
 * 27 add, 15 mul, 3 call */
static void recursion(const real *A, real *y, real *Y)
{
    real s[3];
    ptrdiff_t k, c, r;
    recursion_zero(&s[0]);
    for (k = 3; k >= 0; k--) {
        recursion_fade(&s[0], &A[3 * k], &s[0]);
    }
    for (c = 0; c < 3; c++) {
        {
            const real i0_0 = A[c];
            const real i0_1 = A[c + 3];
            const real i0_2 = A[c + 6];
            const real i0_3 = A[c + 9];
            const real i1_0 = s[c];
            const real t2 = i0_0 + i0_1;
            const real t4 = t2 + i0_2;
            const real t6 = t4 + i0_3;
            const real t8 = t6 * i1_0;
            y[c] = t8;
        }
        for (r = 1; r < 3; r++) {
            recursion_double(&y[c], &y[c]);
        }
        {
            const real i0_0 = y[c];
            const real t1 = sinf(i0_0);
            Y[c] = i0_0;
            Y[c + 3] = t1;
        }
    }
}
