/* Random numbers are counter-based: those of a sample are a function of seed, flight, sample and signal only, so that
 * any number of threads, and any machine with the arithmetic of IEEE 754, draws the same bits.
 *
 * Philox4x32-10: Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011. Normal numbers
 * follow by the inverse of their distribution: Wichura, "Algorithm AS 241", Applied Statistics 37 (1988). Sums are
 * explicit fma(), which compilers may neither split nor contract. */

/* Computes four words from a counter of four words and a key of two. */
TARGET static void batch_philox(uint32_t c[4], uint32_t k0, uint32_t k1)
{
    for (int round = 0; round < 10; round++) {
        const uint64_t p = (uint64_t)0xD2511F53u * c[0], q = (uint64_t)0xCD9E8D57u * c[2];
        const uint32_t c0 = (uint32_t)(q >> 32) ^ c[1] ^ k0, c2 = (uint32_t)(p >> 32) ^ c[3] ^ k1;
        c[1] = (uint32_t)q;
        c[3] = (uint32_t)p;
        c[0] = c0;
        c[2] = c2;
        k0 += 0x9E3779B9u;
        k1 += 0xBB67AE85u;
    }
}

/* Returns (m + 1/2) 2^-52 with the 52 leading bits m of two words: inside (0, 1), without rounding. */
TARGET static double batch_unit(uint32_t high, uint32_t low)
{
    const uint64_t m = ((uint64_t)(high >> 6) << 26) | (low >> 6);
    return ((double)m + 0.5) * 2.220446049250313e-16;
}

/* c[n - 1] x^(n - 1) + ... + c[0]. */
TARGET static double batch_polynomial(const double *c, int n, double x)
{
    double sum = c[n - 1];
    for (int i = n - 2; i >= 0; i--) {
        sum = fma(sum, x, c[i]);
    }
    return sum;
}

/* Returns the logarithm of a positive normal number: e log(2) + 2 artanh(s) with x = 2^e m, s = (m - 1) / (m + 1). */
TARGET static double batch_logarithm(double x)
{
    const double odd[12] = { 1.0, 1.0 / 3.0, 1.0 / 5.0, 1.0 / 7.0, 1.0 / 9.0, 1.0 / 11.0, 1.0 / 13.0, 1.0 / 15.0,
        1.0 / 17.0, 1.0 / 19.0, 1.0 / 21.0, 1.0 / 23.0 };
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    const uint64_t shifted = bits + (0x3FF0000000000000u - 0x3FE6A09E667F3BCDu);
    const int64_t e = (int64_t)(shifted >> 52) - 1023;
    double m;
    bits -= (uint64_t)e << 52;
    memcpy(&m, &bits, sizeof m);
    const double s = (m - 1.0) / (m + 1.0);
    return fma((double)e, 0.6931471805599453, 2.0 * s * batch_polynomial(odd, 12, s * s));
}

/* Returns z with P(Z <= z) = p of a standard normal Z. */
TARGET static double batch_normal(double p)
{
    const double a[8] = { 3.3871328727963666080, 133.14166789178437745, 1971.5909503065514427, 13731.693765509461125,
        45921.953931549871457, 67265.770927008700853, 33430.575583588128105, 2509.0809287301226727 };
    const double b[8] = { 1.0, 42.313330701600911252, 687.18700749205790830, 5394.1960214247511077,
        21213.794301586595867, 39307.895800092710610, 28729.085735721942674, 5226.4952788528545610 };
    const double c[8] = { 1.42343711074968357734, 4.63033784615654529590, 5.76949722146069140550,
        3.64784832476320460504, 1.27045825245236838258, 0.241780725177450611770, 0.0227238449892691845833,
        7.74545014278341407640e-4 };
    const double d[8] = { 1.0, 2.05319162663775882187, 1.67638483018380384940, 0.689767334985100004550,
        0.148103976427480074590, 0.0151986665636164571966, 5.47593808499534494600e-4, 1.05075007164441684324e-9 };
    const double e[8] = { 6.65790464350110377720, 5.46378491116411436990, 1.78482653991729133580,
        0.296560571828504891230, 0.0265321895265761230930, 1.24266094738807843860e-3, 2.71155556874348757815e-5,
        2.01033439929228813265e-7 };
    const double f[8] = { 1.0, 0.599832206555887937690, 0.136929880922735805310, 0.0148753612908506148525,
        7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7, 2.04426310338993978564e-15 };
    const double q = p - 0.5;
    if (fabs(q) <= 0.425) {
        const double r = fma(-q, q, 0.180625);
        return q * batch_polynomial(a, 8, r) / batch_polynomial(b, 8, r);
    }
    const double r = sqrt(-batch_logarithm(q < 0.0 ? p : 1.0 - p));
    const double z = (r <= 5.0) ? batch_polynomial(c, 8, r - 1.6) / batch_polynomial(d, 8, r - 1.6)
                                : batch_polynomial(e, 8, r - 5.0) / batch_polynomial(f, 8, r - 5.0);
    return (q < 0.0) ? -z : z;
}

/* Draws the n numbers of a sample of a flight. */
TARGET static void batch_draw_sample(
    const batch_random_t *r, uint64_t seed, int64_t flight, int64_t k, int n, double *out)
{
    for (int i = 0; i < n; i += 2) {
        uint32_t word[4] = { (uint32_t)k, (uint32_t)flight, (uint32_t)((uint64_t)flight >> 32),
            ((uint32_t)r->stream << 16) | (uint32_t)(i / 2) };
        batch_philox(word, (uint32_t)seed, (uint32_t)(seed >> 32));
        for (int j = 0; j < 2 && i + j < n; j++) {
            const double p = batch_unit(word[2 * j], word[2 * j + 1]);
            out[i + j] = PRODUCT(r->size[i + j], r->uniform ? 2.0 * p - 1.0 : batch_normal(p));
        }
    }
}
