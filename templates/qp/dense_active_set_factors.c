/* Contract of this part: H = L D L', its substitutions, and panels of four lanes. */

/* y[j] += c0 rows[0][j] + c1 rows[1][j] + c2 rows[2][j] + c3 rows[3][j],  from <= j < to */
static inline void qp_add_panel(real_t *y, const real_t *rows, real_t c0, real_t c1, real_t c2, real_t c3,
                         int from, int to)
{
    for (int j = from; j < to; j += 4) {
        const real_t *a = rows + j;
        real_t s[4];
        for (int l = 0; l < 4; ++l) {
            s[l] = y[j + l] + ((c0 * a[l] + c1 * a[LDV + l]) +
                               (c2 * a[2 * LDV + l] + c3 * a[3 * LDV + l]));
        }
        for (int l = 0; l < 4; ++l) {
            y[j + l] = s[l];
        }
    }
}

/* sum_j a_j b_j,  j < n, in four partial sums */
static inline real_t qp_dot(const real_t *a, const real_t *b, int n)
{
    real_t s[4] = { R(0.0), R(0.0), R(0.0), R(0.0) };
    for (int j = 0; j < n; j += 4) {
        for (int l = 0; l < 4; ++l) {
            s[l] += a[j + l] * b[j + l];
        }
    }
    return (s[0] + s[2]) + (s[1] + s[3]);
}

/* A pivot below this share of the diagonal entry may be zero. */
static inline real_t qp_zero_pivot(void)
{
    return SQRT(TOL_UNIT / 256);
}

/* Weight of the proximal term as a share of the diagonal entry. */
static inline real_t qp_proximal_share(void)
{
    return SQRT(TOL_UNIT * 262144);
}

/* L D L' of the diagonal panel b; reference[k]: diagonal of H before elimination. Returns 0, and leaves the panel as it is, if
 * a pivot is not safely positive. */
static int qp_factorize_diagonal(qp_t *q, int b, const real_t *reference)
{
    real_t *h0 = q->H[b] + b, *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b, *h3 = q->H[b + 3] + b;
    const real_t x10 = h1[0], x20 = h2[0], x30 = h3[0];
    const real_t d0 = h0[0], e0 = R(1.0) / d0;
    const real_t l10 = x10 * e0, l20 = x20 * e0, l30 = x30 * e0;
    const real_t x21 = h2[1] - l20 * x10, x31 = h3[1] - l30 * x10;
    const real_t d1 = h1[1] - l10 * x10, e1 = R(1.0) / d1;
    const real_t l21 = x21 * e1, l31 = x31 * e1;
    const real_t x32 = h3[2] - l30 * x20 - l31 * x21;
    const real_t d2 = h2[2] - l20 * x20 - l21 * x21, e2 = R(1.0) / d2;
    const real_t l32 = x32 * e2;
    const real_t d3 = h3[3] - l30 * x30 - l31 * x31 - l32 * x32, e3 = R(1.0) / d3;
    if (!(d0 > qp_zero_pivot() * reference[b] && d1 > qp_zero_pivot() * reference[b + 1] &&
          d2 > qp_zero_pivot() * reference[b + 2] && d3 > qp_zero_pivot() * reference[b + 3] &&
          isfinite((d0 + d1) + (d2 + d3)))) {
        return 0;
    }
    h1[0] = h0[1] = l10;
    h2[0] = h0[2] = l20;
    h3[0] = h0[3] = l30;
    h2[1] = h1[2] = l21;
    h3[1] = h1[3] = l31;
    h3[2] = h2[3] = l32;
    h1[1] = d1;
    h2[2] = d2;
    h3[3] = d3;
    q->inverse[b] = e0;
    q->inverse[b + 1] = e1;
    q->inverse[b + 2] = e2;
    q->inverse[b + 3] = e3;
    return 1;
}

/* The middle one of the positive numbers in v; 1 if there is none. */
static real_t qp_median(const real_t *v)
{
    real_t middle = R(0.0);
    int positive = 0;
    for (int i = 0; i < NV; ++i) {
        positive += v[i] > R(0.0);
    }
    for (int i = 0; i < NV; ++i) {
        int smaller = 0;
        for (int j = 0; j < NV; ++j) {
            smaller += v[j] > R(0.0) && v[j] < v[i];
        }
        middle = 2 * smaller <= positive && v[i] > middle ? v[i] : middle;
    }
    return middle > R(0.0) && isfinite(middle) ? middle : R(1.0);
}

/* A length for every variable: the smallest positive width of its bounds and of the rows it appears in; 1 if there is none.
 * Returns the size of the cost over these lengths: the median, for some bounds are out of all reach. */
static real_t qp_lengths(const qp_t *q, const real_t *reference, real_t *length)
{
    real_t square[LDV];
    for (int i = 0; i < NV; ++i) {
        real_t least = q->upper[i] - q->lower[i];
        least = least > R(0.0) ? least : (real_t)INFINITY;
        for (int j = 0; j < NG; ++j) {
            const real_t a = FABS(q->A[j][i]), width = q->upper[NV + j] - q->lower[NV + j];
            if (width > R(0.0) && width < least * a) {
                least = width / a;
            }
        }
        length[i] = least < (real_t)INFINITY ? least : R(1.0);
        square[i] = reference[i] * length[i] * length[i];
    }
    return qp_median(square);
}

/* Weights of the proximal term: a share of the diagonal of H, and where that is (nearly) zero, of the cost over the square of a
 * length. */
static void qp_set_proximal_weights(qp_t *q, const real_t *reference)
{
    real_t length[LDV];
    const real_t cost = qp_lengths(q, reference, length);
    for (int i = 0; i < NV; ++i) {
        const real_t other = cost / (length[i] * length[i]);
        const int known = reference[i] > TOL_QP_PIVOT * other;
        q->weight[i] = known ? qp_proximal_share() * reference[i] : R(1.0 / 64) * other;
        q->proximal[i] = q->center[i] = R(0.0);
    }
    for (int i = NV; i < LDV; ++i) {
        q->weight[i] = q->proximal[i] = q->center[i] = R(0.0);
    }
    q->semidefinite = 1;
}

/* As qp_factorize_diagonal, pivot by pivot: one that may be zero gets the weight of the proximal term. Returns 0 if a pivot is
 * negative beyond rounding, or not finite. */
static int qp_factorize_semidefinite(qp_t *q, int b, const real_t *reference)
{
    const real_t zero = qp_zero_pivot();
    if (!q->semidefinite) {
        qp_set_proximal_weights(q, reference);
    }
    for (int k = b; k < b + 4; ++k) {
        real_t *h = q->H[k];
        real_t d = h[k];
        for (int j = b; j < k; ++j) {
            d -= h[j] * h[j] * q->H[j][j];
        }
        if (!isfinite(d) || d < -zero * reference[k]) {
            return 0;
        }
        if (d <= zero * reference[k]) {
            q->proximal[k] = q->weight[k];
            d += q->weight[k];
        }
        h[k] = d;
        q->inverse[k] = R(1.0) / d;
        for (int i = k + 1; i < b + 4; ++i) {
            real_t x = q->H[i][k];
            for (int j = b; j < k; ++j) {
                x -= q->H[i][j] * h[j] * q->H[j][j];
            }
            q->H[i][k] = h[i] = x * q->inverse[k];
        }
    }
    return 1;
}

/* A zero pivot of a semidefinite matrix has zeros below it: x_ik^2 <= (pivot k) H_ii, where x_ik = L_ik d_k. */
static int qp_zero_below(qp_t *q, int b, const real_t *reference)
{
    int valid = 1;
    for (int k = b; k < b + 4; ++k) {
        for (int i = k + 1; q->proximal[k] > R(0.0) && i < NV; ++i) {
            const real_t x = q->H[k][i] * q->H[k][k];
            valid &= x * x <= qp_zero_pivot() * reference[k] * reference[i];
        }
    }
    return valid;
}

/* Columns b..b+3 of L below the diagonal panel. With X = L D: X_i0 = H_i0, X_i1 = H_i1 - X_i0 L_10, ...;
 * then the trailing lower triangle: H_ij -= sum_k X_ik L_jk. */
static void qp_factorize_panel(qp_t *q, int b)
{
    const real_t *h0 = q->H[b], *h1 = q->H[b + 1], *h2 = q->H[b + 2];
    const real_t l10 = h0[b + 1], l20 = h0[b + 2], l30 = h0[b + 3], l21 = h1[b + 2], l31 = h1[b + 3], l32 = h2[b + 3];
    const real_t e0 = q->inverse[b], e1 = q->inverse[b + 1], e2 = q->inverse[b + 2], e3 = q->inverse[b + 3];
    for (int i = b + 4; i < LDV; ++i) {
        real_t *h = q->H[i] + b;
        const real_t x0 = h[0];
        const real_t x1 = h[1] - x0 * l10;
        const real_t x2 = h[2] - x0 * l20 - x1 * l21;
        const real_t x3 = h[3] - x0 * l30 - x1 * l31 - x2 * l32;
        h[1] = x1;
        h[2] = x2;
        h[3] = x3;
        q->H[b][i] = x0 * e0;
        q->H[b + 1][i] = x1 * e1;
        q->H[b + 2][i] = x2 * e2;
        q->H[b + 3][i] = x3 * e3;
    }
    for (int i = b + 4; i < NV; ++i) {
        real_t *h = q->H[i] + b;
        const real_t x0 = h[0], x1 = h[1], x2 = h[2], x3 = h[3];
        qp_add_panel(q->H[i], q->H[b], -x0, -x1, -x2, -x3, b + 4, i + 1);
        h[0] = x0 * e0;
        h[1] = x1 * e1;
        h[2] = x2 * e2;
        h[3] = x3 * e3;
    }
}

/* H + diag(proximal) = L D L' in place, inverse = D^{-1/2}; rows NV to LDV of the identity make the last panel whole. */
static status_t qp_factorize_hessian(qp_t *q)
{
    real_t reference[LDV];
    q->semidefinite = 0;
    for (int i = NV; i < LDV; ++i) {
        for (int j = 0; j < LDV; ++j) {
            q->H[i][j] = R(0.0);
        }
        q->H[i][i] = R(1.0);
    }
    for (int i = 0; i < LDV; ++i) {
        reference[i] = q->H[i][i];
    }
    for (int b = 0; b < LDV; b += 4) {
        const int definite = qp_factorize_diagonal(q, b, reference);
        if (!definite && !qp_factorize_semidefinite(q, b, reference)) {
            return NUMERICAL_FAILURE;
        }
        qp_factorize_panel(q, b);
        if (!definite && !qp_zero_below(q, b, reference)) {
            return NUMERICAL_FAILURE;
        }
    }
    for (int i = 0; i < LDV; ++i) {
        q->inverse[i] = SQRT(q->inverse[i]);
    }
    return OK;
}

/* y := D^{-1/2} L^{-1} y, where y_i = 0 for i < first */
static void qp_forward(const qp_t *q, real_t *y, int first)
{
    for (int b = first - first % 4; b < LDV; b += 4) {
        const real_t *h0 = q->H[b] + b, *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b;
        const real_t y0 = y[b];
        const real_t y1 = y[b + 1] - h0[1] * y0;
        const real_t y2 = y[b + 2] - h0[2] * y0 - h1[2] * y1;
        const real_t y3 = y[b + 3] - h0[3] * y0 - h1[3] * y1 - h2[3] * y2;
        y[b] = y0 * q->inverse[b];
        y[b + 1] = y1 * q->inverse[b + 1];
        y[b + 2] = y2 * q->inverse[b + 2];
        y[b + 3] = y3 * q->inverse[b + 3];
        qp_add_panel(y, q->H[b], -y0, -y1, -y2, -y3, b + 4, LDV);
    }
}

/* z = L^{-T} D^{-1/2} y */
static void qp_backward(const qp_t *q, const real_t *y, real_t *z)
{
    for (int j = 0; j < LDV; ++j) {
        z[j] = y[j] * q->inverse[j];
    }
    for (int b = LDV - 4; b >= 0; b -= 4) {
        const real_t *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b, *h3 = q->H[b + 3] + b;
        const real_t z3 = z[b + 3];
        const real_t z2 = z[b + 2] - h3[2] * z3;
        const real_t z1 = z[b + 1] - h3[1] * z3 - h2[1] * z2;
        const real_t z0 = z[b] - h3[0] * z3 - h2[0] * z2 - h1[0] * z1;
        z[b] = z0;
        z[b + 1] = z1;
        z[b + 2] = z2;
        qp_add_panel(z, q->H[b], -z0, -z1, -z2, -z3, 0, b);
    }
}
