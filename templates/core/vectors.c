/* Finiteness and magnitudes of vectors, four numbers at a time, which compilers hold in vector registers. */

/* Returns 1 if all n numbers are finite: then their products with 0 are 0. */
static int all_finite(const real_t *v, int n)
{
    const int fours = n / 4 * 4;
    real_t s0 = R(0), s1 = R(0), s2 = R(0), s3 = R(0);
    for (int i = 0; i < fours; i += 4) {
        s0 += R(0) * v[i];
        s1 += R(0) * v[i + 1];
        s2 += R(0) * v[i + 2];
        s3 += R(0) * v[i + 3];
    }
    for (int i = fours; i < n; i++) {
        s0 += R(0) * v[i];
    }
    return isfinite((s0 + s2) + (s1 + s3)) != 0;
}

/* size = max(size, |v|) by components, n of them; numbers that are not finite may be left out. */
static inline void enlarge_all(real_t *size, const real_t *v, int n)
{
    const int fours = n / 4 * 4;
    for (int i = 0; i < fours; i += 4) {
        real_t a[4];
        for (int l = 0; l < 4; l++) {
            a[l] = FABS(v[i + l]);
        }
        for (int l = 0; l < 4; l++) {
            size[i + l] = (a[l] > size[i + l]) ? a[l] : size[i + l];
        }
    }
    for (int i = fours; i < n; i++) {
        const real_t a = FABS(v[i]);
        size[i] = (a > size[i]) ? a : size[i];
    }
}

/* size = max(size, |v|) by components, n of them; NaN where v is not finite. */
static inline void widen(real_t *size, const real_t *v, int n)
{
    enlarge_all(size, v, n);
    for (int i = 0; i < n; i++) {
        size[i] += R(0) * v[i];
    }
}
