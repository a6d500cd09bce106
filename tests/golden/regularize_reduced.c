/* Eigenvalues of one symmetric matrix by Householder reflections to tridiagonal form and implicit QL (Bowdler, Martin, Reinsch
 * and Wilkinson 1968; procedures tred2 and tql2), at most GOLDEN_MAX_QL iterations per eigenvalue.
 *
 * On entry W holds the matrix, n rows of length ld, entries at most 1; on return row k of W is an eigenvector of d[k]. */

/* Row i is reflected to a multiple of e_{i-1}: the reflector goes to d, its product with the matrix to e. */
static golden_real reflect_row(golden_real *W, golden_real *d, golden_real *e, int i, int ld, golden_real scale)
{
    golden_real h = 0.0, f, g;
    int j, k;
    for (k = 0; k < i; k++) {
        d[k] /= scale;
        h += d[k] * d[k];
        e[k] = 0.0;
    }
    f = d[i - 1];
    g = (f > 0.0) ? -sqrt(h) : sqrt(h);
    e[i] = scale * g;
    h -= f * g;
    d[i - 1] = f - g;
    for (j = 0; j < i; j++) {
        f = d[j];
        W[i * ld + j] = f;
        g = e[j] + W[j * ld + j] * f;
        for (k = j + 1; k < i; k++) {
            g += W[j * ld + k] * d[k];
            e[k] += W[j * ld + k] * f;
        }
        e[j] = g;
    }
    return h;
}

/* The trailing update W -= d e' + e d' of the leading i rows. */
static void reflect_rest(golden_real *W, golden_real *d, golden_real *e, int i, int ld, golden_real h)
{
    golden_real f = 0.0;
    int j, k;
    for (j = 0; j < i; j++) {
        e[j] /= h;
        f += e[j] * d[j];
    }
    f /= h + h;
    for (j = 0; j < i; j++) {
        e[j] -= f * d[j];
    }
    for (j = 0; j < i; j++) {
        const golden_real a = d[j], b = e[j];
        for (k = j; k < i; k++) {
            W[j * ld + k] -= a * e[k] + b * d[k];
        }
        d[j] = W[j * ld + i - 1];
        W[j * ld + i] = 0.0;
    }
}

/* W = Q T Q': diagonal of T to d, the rest of it to e[1 ..], rows of Q' to W. */
static void tridiagonalize(golden_real *W, golden_real *d, golden_real *e, int n, int ld)
{
    int i, j, k;
    for (j = 0; j < n; j++) {
        d[j] = W[j * ld + n - 1];
    }
    for (i = n - 1; i > 0; i--) {
        golden_real scale = 0.0, h = 0.0;
        for (k = 0; k < i; k++) {
            scale += fabs(d[k]);
        }
        if (scale > 2.0194839173657902e-28) {
            h = reflect_row(W, d, e, i, ld, scale);
            reflect_rest(W, d, e, i, ld, h);
        } else {
            e[i] = d[i - 1];
            for (j = 0; j < i; j++) {
                d[j] = W[j * ld + i - 1];
                W[j * ld + i] = W[i * ld + j] = 0.0;
            }
        }
        d[i] = h;
    }
}

/* The reflections are multiplied out. */
static void collect_reflections(golden_real *W, golden_real *d, golden_real *e, int n, int ld)
{
    int i, j, k;
    for (i = 0; i < n - 1; i++) {
        const golden_real h = d[i + 1];
        golden_real *w = W + (i + 1) * ld;
        W[i * ld + n - 1] = W[i * ld + i];
        W[i * ld + i] = 1.0;
        for (k = 0; k <= i && h != 0.0; k++) {
            d[k] = w[k] / h;
        }
        for (j = 0; j <= i && h != 0.0; j++) {
            golden_real g = 0.0;
            for (k = 0; k <= i; k++) {
                g += w[k] * W[j * ld + k];
            }
            for (k = 0; k <= i; k++) {
                W[j * ld + k] -= g * d[k];
            }
        }
        for (k = 0; k <= i; k++) {
            w[k] = 0.0;
        }
    }
    for (j = 0; j < n; j++) {
        d[j] = W[j * ld + n - 1];
        W[j * ld + n - 1] = 0.0;
    }
    W[(n - 1) * ld + n - 1] = 1.0;
    for (i = 1; i < n; i++) {
        e[i - 1] = e[i];
    }
    e[n - 1] = 0.0;
}

/* One implicit QL step on rows l .. m of T. Returns the shift, by which all later eigenvalues were moved. */
static golden_real ql_step(golden_real *W, golden_real *d, golden_real *e, int l, int m, int n, int ld)
{
    const golden_real first = d[l], ratio = (d[l + 1] - d[l]) / (2.0 * e[l]);
    const golden_real root = sqrt(ratio * ratio + 1.0);
    const golden_real t = ratio + ((ratio < 0.0) ? -root : root), next = e[l + 1];
    golden_real c = 1.0, c2 = c, c3 = c, s = 0.0, s2 = s, p, shift, pushed;
    int i, k;
    d[l] = e[l] / t;
    pushed = d[l + 1] = e[l] * t;
    shift = first - d[l];
    for (i = l + 2; i < n; i++) {
        d[i] -= shift;
    }
    p = d[m];
    for (i = m - 1; i >= l; i--) {
        const golden_real g = c * e[i], h = c * p, r = sqrt(p * p + e[i] * e[i]);
        golden_real *w = W + i * ld;
        c3 = c2;
        c2 = c;
        s2 = s;
        e[i + 1] = s * r;
        s = (r > 0.0) ? e[i] / r : 0.0;
        c = (r > 0.0) ? p / r : 1.0;
        p = c * d[i] - s * g;
        d[i + 1] = h + s * (c * g + s * d[i]);
        for (k = 0; k < n; k++) {
            const golden_real a = w[k], b = w[ld + k];
            w[ld + k] = s * a + c * b;
            w[k] = c * a - s * b;
        }
    }
    p = -s * s2 * c3 * next * e[l] / pushed;
    e[l] = s * p;
    d[l] = c * p;
    return shift;
}

static void decompose(golden_real *W, golden_real *d, golden_real *e, int n, int ld)
{
    golden_real f = 0.0, size = 0.0;
    int l, m, iteration;
    tridiagonalize(W, d, e, n, ld);
    collect_reflections(W, d, e, n, ld);
    for (l = 0; l < n; l++) {
        const golden_real here = fabs(d[l]) + fabs(e[l]);
        size = (here > size) ? here : size;
        m = l;
        while (m < n - 1 && fabs(e[m]) > 2.220446049250313e-16 * size) {
            m++;
        }
        for (iteration = 0; m > l && iteration < GOLDEN_MAX_QL && fabs(e[l]) > 2.220446049250313e-16 * size; iteration++) {
            f += ql_step(W, d, e, l, m, n, ld);
        }
        d[l] += f;
        e[l] = 0.0;
    }
}

/* H, lower triangle of n rows, becomes V f(Lambda) V', f = max(|Lambda|, floor) if GOLDEN_MIRROR, else max(Lambda, floor); floor
 * relative to the largest |Lambda|. 0 is returned, and H stays as it is, if it is zero or not finite. work has the size of H. */
static int regularize_reduced(golden_real *H, int n, int ld, golden_real *work)
{
    golden_real d[GOLDEN_LDV], e[GOLDEN_LDV], scale = 0.0, smallest = 0.0;
    int i, j, k;
    for (i = 0; i < n; i++) {
        for (j = 0; j <= i; j++) {
            const golden_real a = fabs(H[i * ld + j]);
            scale = (a > scale) ? a : scale;
        }
    }
    if (!(scale > 0.0) || !isfinite(scale)) {
        return 0;
    }
    for (i = 0; i < n; i++) {
        for (j = 0; j <= i; j++) {
            work[i * ld + j] = work[j * ld + i] = H[i * ld + j] / scale;
            H[i * ld + j] = 0.0;
        }
    }
    decompose(work, d, e, n, ld);
    for (k = 0; k < n; k++) {
        smallest = (fabs(d[k]) > smallest) ? fabs(d[k]) : smallest;
    }
    smallest *= regularization[0];
    for (k = 0; k < n; k++) {
        const golden_real a = (GOLDEN_MIRROR && d[k] < 0.0) ? -d[k] : d[k];
        const golden_real value = scale * ((a < smallest) ? smallest : a);
        const golden_real *v = work + k * ld;
        for (i = 0; i < n; i++) {
            const golden_real b = value * v[i];
            for (j = 0; j <= i; j++) {
                H[i * ld + j] += b * v[j];
            }
        }
    }
    return 1;
}

/* A condensed Hessian that is not positive definite is formed again and regularised. */
static golden_status_t condense_factorize(golden_solver_t *s)
{
    const golden_status_t status = qp_factorize(&s->qp);
    if (status != GOLDEN_NUMERICAL_FAILURE) {
        return status;
    }
    condense_hessian(s);
    return regularize_reduced(&s->qp.H[0][0], GOLDEN_NV - GOLDEN_NSL, GOLDEN_LDV, &s->qp.Q[0][0]) ? qp_factorize(&s->qp) : status;
}
