static int all_finite(const real_t *v, int n)
{
    for (int i = 0; i < n; i++) {
        if (!isfinite(v[i])) {
            return 0;
        }
    }
    return 1;
}

/* size = max(size, |v|) by components, n of them; NaN where v is not finite. */
static inline void widen(real_t *size, const real_t *v, int n)
{
    for (int i = 0; i < n; i++) {
        const real_t a = FABS(v[i]);
        size[i] = ((a > size[i]) ? a : size[i]) + R(0) * a;
    }
}

/* size = max(size, |v|) by components, n of them; numbers that are not finite may be left out. */
static inline void enlarge_all(real_t *size, const real_t *v, int n)
{
    for (int i = 0; i < n; i++) {
        const real_t a = FABS(v[i]);
        size[i] = (a > size[i]) ? a : size[i];
    }
}
