/* sum_j a[j] b[j],  j < n. */
static inline real_t riccati_dot(const real_t *a, const real_t *b, int n)
{
    const int eights = n / 8 * 8, fours = n / 4 * 4;
    real_t s[4] = {0}, t[4] = {0}, sum = R(0);
    for (int j = 0; j < eights; j += 8) {
        for (int i = 0; i < 4; i++) {
            s[i] += a[j + i] * b[j + i];
        }
        for (int i = 0; i < 4; i++) {
            t[i] += a[j + 4 + i] * b[j + 4 + i];
        }
    }
    for (int i = 0; i < 4; i++) {
        s[i] += t[i];
    }
    for (int j = eights; j < fours; j += 4) {
        for (int i = 0; i < 4; i++) {
            s[i] += a[j + i] * b[j + i];
        }
    }
    for (int j = fours; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum + ((s[0] + s[2]) + (s[1] + s[3]));
}
