/* Eigenvalues of one symmetric matrix by Householder reflections to tridiagonal form and implicit QL (Bowdler, Martin,
 * Reinsch and Wilkinson 1968; procedures tred2 and tql2), at most MAX_QL iterations per eigenvalue.
 *
 * On entry W holds the matrix of n rows, with entries of at most 1 in magnitude; on return row k of W is an eigenvector
 * for the eigenvalue d[k]. */

/* Reflects row i to a multiple of e_{i-1}; stores the reflector in d and its product with the matrix in e. */
static real_t reflect_row(real_t (*W)[LDV], real_t *d, real_t *e, int i, real_t scale)
{
    real_t h = R(0), f, g;
    for (int k = 0; k < i; ++k) {
        d[k] /= scale;
        h += d[k] * d[k];
        e[k] = R(0);
    }
    f = d[i - 1];
    g = (f > R(0)) ? -SQRT(h) : SQRT(h);
    e[i] = scale * g;
    h -= f * g;
    d[i - 1] = f - g;
    for (int j = 0; j < i; ++j) {
        f = d[j];
        W[i][j] = f;
        g = e[j] + W[j][j] * f;
        for (int k = j + 1; k < i; ++k) {
            g += W[j][k] * d[k];
            e[k] += W[j][k] * f;
        }
        e[j] = g;
    }
    return h;
}

/* Updates the leading i rows: W -= d e' + e d'. */
static void reflect_rest(real_t (*W)[LDV], real_t *d, real_t *e, int i, real_t h)
{
    real_t f = R(0);
    for (int j = 0; j < i; ++j) {
        e[j] /= h;
        f += e[j] * d[j];
    }
    f /= h + h;
    for (int j = 0; j < i; ++j) {
        e[j] -= f * d[j];
    }
    for (int j = 0; j < i; ++j) {
        const real_t a = d[j], b = e[j];
        for (int k = j; k < i; ++k) {
            W[j][k] -= a * e[k] + b * d[k];
        }
        d[j] = W[j][i - 1];
        W[j][i] = R(0);
    }
}

/* W = Q T Q'. Stores the diagonal of T in d, its subdiagonal in e[1 ..] and the reflectors in W. */
static void tridiagonalize(real_t (*W)[LDV], real_t *d, real_t *e, int n)
{
    for (int j = 0; j < n; ++j) {
        d[j] = W[j][n - 1];
    }
    for (int i = n - 1; i > 0; --i) {
        real_t scale = R(0), h = R(0);
        for (int k = 0; k < i; ++k) {
            scale += FABS(d[k]);
        }
        if (scale > TOL_EIGEN_TINY) {
            h = reflect_row(W, d, e, i, scale);
            reflect_rest(W, d, e, i, h);
        } else {
            e[i] = d[i - 1];
            for (int j = 0; j < i; ++j) {
                d[j] = W[j][i - 1];
                W[j][i] = R(0);
                W[i][j] = R(0);
            }
        }
        d[i] = h;
    }
}

/* Multiplies the reflections; stores the rows of Q' in W. */
static void collect_reflections(real_t (*W)[LDV], real_t *d, real_t *e, int n)
{
    for (int i = 0; i < n - 1; ++i) {
        const real_t h = d[i + 1];
        real_t *w = W[i + 1];
        W[i][n - 1] = W[i][i];
        W[i][i] = R(1);
        for (int k = 0; k <= i && h != R(0); ++k) { /* exactly 0 if row i was not reflected */
            d[k] = w[k] / h;
        }
        for (int j = 0; j <= i && h != R(0); ++j) { /* as above */
            real_t g = R(0);
            for (int k = 0; k <= i; ++k) {
                g += w[k] * W[j][k];
            }
            for (int k = 0; k <= i; ++k) {
                W[j][k] -= g * d[k];
            }
        }
        for (int k = 0; k <= i; ++k) {
            w[k] = R(0);
        }
    }
    for (int j = 0; j < n; ++j) {
        d[j] = W[j][n - 1];
        W[j][n - 1] = R(0);
    }
    W[n - 1][n - 1] = R(1);
    for (int i = 1; i < n; ++i) {
        e[i - 1] = e[i];
    }
    e[n - 1] = R(0);
}

/* One implicit QL step on rows l .. m of T. Returns the shift that was subtracted from all later eigenvalues. */
static real_t ql_step(real_t (*W)[LDV], real_t *d, real_t *e, int l, int m, int n)
{
    const real_t first = d[l], ratio = (d[l + 1] - d[l]) / (R(2) * e[l]);
    const real_t root = SQRT(ratio * ratio + R(1));
    const real_t t = ratio + ((ratio < R(0)) ? -root : root), next = e[l + 1];
    real_t c = R(1), c2 = c, c3 = c, s = R(0), s2 = s, p, shift, pushed;
    d[l] = e[l] / t;
    d[l + 1] = e[l] * t;
    pushed = d[l + 1];
    shift = first - d[l];
    for (int i = l + 2; i < n; ++i) {
        d[i] -= shift;
    }
    p = d[m];
    for (int i = m - 1; i >= l; --i) { /* at most n - 1 - l passes */
        const real_t g = c * e[i], h = c * p, r = SQRT(p * p + e[i] * e[i]);
        real_t *w = W[i], *v = W[i + 1];
        c3 = c2;
        c2 = c;
        s2 = s;
        e[i + 1] = s * r;
        s = (r > R(0)) ? e[i] / r : R(0);
        c = (r > R(0)) ? p / r : R(1);
        p = c * d[i] - s * g;
        d[i + 1] = h + s * (c * g + s * d[i]);
        for (int k = 0; k < n; ++k) {
            const real_t a = w[k], b = v[k];
            v[k] = s * a + c * b;
            w[k] = c * a - s * b;
        }
    }
    p = -s * s2 * c3 * next * e[l] / pushed;
    e[l] = s * p;
    d[l] = c * p;
    return shift;
}

static void decompose(real_t (*W)[LDV], real_t *d, real_t *e, int n)
{
    real_t f = R(0), size = R(0);
    tridiagonalize(W, d, e, n);
    collect_reflections(W, d, e, n);
    for (int l = 0; l < n; ++l) {
        const real_t here = FABS(d[l]) + FABS(e[l]);
        size = (here > size) ? here : size;
        int m = l;
        while (m < n - 1 && FABS(e[m]) > TOL_UNIT * size) { /* at most n - 1 - l passes */
            ++m;
        }
        for (int iteration = 0; m > l && iteration < MAX_QL && FABS(e[l]) > TOL_UNIT * size; ++iteration) {
            f += ql_step(W, d, e, l, m, n);
        }
        d[l] += f;
        e[l] = R(0);
    }
}
