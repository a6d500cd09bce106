/* sum_j a[j] b[j],  j < n; the order of the sums is that of dot.c. */
static inline real_t riccati_dot(const real_t *a, const real_t *b, int n)
{
    const int eights = n / 8 * 8, fours = n / 4 * 4;
    real_t s0 = R(0), s1 = R(0), s2 = R(0), s3 = R(0), s4 = R(0), s5 = R(0), s6 = R(0), s7 = R(0), sum = R(0);
    for (int j = 0; j < eights; j += 8) {
        s0 += a[j] * b[j];
        s1 += a[j + 1] * b[j + 1];
        s2 += a[j + 2] * b[j + 2];
        s3 += a[j + 3] * b[j + 3];
        s4 += a[j + 4] * b[j + 4];
        s5 += a[j + 5] * b[j + 5];
        s6 += a[j + 6] * b[j + 6];
        s7 += a[j + 7] * b[j + 7];
    }
    s0 += s4;
    s1 += s5;
    s2 += s6;
    s3 += s7;
    if (eights < fours) {
        s0 += a[eights] * b[eights];
        s1 += a[eights + 1] * b[eights + 1];
        s2 += a[eights + 2] * b[eights + 2];
        s3 += a[eights + 3] * b[eights + 3];
    }
    for (int j = fours; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum + ((s0 + s2) + (s1 + s3));
}
