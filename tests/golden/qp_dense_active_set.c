/* ==== qp: dense_active_set ================================================================================ */

/* ---------------------------------------------------------------------------------------------------------------------
 * qp: dense dual active-set method
 *
 *     min  1/2 z'H z + g'z   s.t.   lower[i] <= z_i <= upper[i],  i < NV;   lower[NV+j] <= A[j] z <= upper[NV+j],  j < NG
 *
 *     H z + g + mult[0..NV) + A' mult[NV..NV+NG) = 0,   mult > 0 at an upper bound, < 0 at a lower one, 0 in between
 *
 * A row c with a finite penalty[c] >= 0 is elastic: the cost has the term penalty[c] * (violation of the row) in place of the
 * row, so |mult| <= penalty. Where the multiplier stands at that limit the row is saturated and may be violated.
 *
 * Contract of the seam
 *   qp_init       once: everything zero, all bounds and penalties infinite, empty working set.
 *   qp_factorize  preparation: H (lower triangle) and A are known, lower and upper hold a prediction. Overwrites H.
 *                 OK, or NUMERICAL_FAILURE: H not positive semidefinite, data not finite.
 *   qp_solve      feedback: g, lower, upper and penalty are known. Writes z, mult, iterations, changes, dropped, relaxed.
 *                 OK; ITERATION_LIMIT, STALLED (a working set came back), INFEASIBLE: z is the last iterate, 0 if bounds cross;
 *                 NUMERICAL_FAILURE (data not finite, cost unbounded below): z = mult = 0.
 *   qp_shift_working_set  before qp_factorize: the prediction moves n variables towards the front, and rows as told (its own template).
 * Bounds may be infinite; equality = equal bounds. Redundant consistent equalities get multiplier 0 and are counted in
 * dropped; elastic rows that are violated, in relaxed. Bounds that cross are INFEASIBLE, of elastic rows too; without
 * crossed bounds and hard rows the answer is never INFEASIBLE. After INFEASIBLE certificate[] holds weights f, |f| <= 1, with
 *     sum_c f_c a_c = 0   and   sum_c f_c (upper_c if f_c > 0, lower_c if f_c < 0) < 0       (0 if bounds cross).
 * side[] is the working set and stays for the warm start (+-1: member at its upper or lower bound, +-2: saturated there); a
 * caller may edit it before qp_factorize.
 * Columns NV to LDV of A are zero; those of H, its rows NV to LDV and its upper triangle are not read.
 *
 * Method (Goldfarb and Idnani 1983) in the coordinates y = D^{1/2} L'z of H = L D L', L unit lower triangular. There the
 * cost is 1/2 |y - y0|^2 with y0 = -D^{-1/2} L^{-1} g, and row a is m'y with m = D^{-1/2} L^{-1} a. The rows of the
 * working set W (nw of them) are kept as M_W' = Q'R: R upper triangular, the rows of Q orthonormal (Daniel, Gragg,
 * Kaufman and Stewart 1976). With t the active bounds, the minimiser on W is
 *
 *     R'w = t,   c = Q y0 - w,   y = y0 - Q'c,   lam = R^{-1} c,   z = L^{-T} D^{-1/2} y
 *
 * A saturated row belongs to the cost: y0 = -D^{-1/2} L^{-1} (g + sum_saturated mult_c a_c). The dual problem is then one with
 * multipliers in [0, penalty], and every step increases its objective as before.
 *
 * Where a pivot of H may be zero, H + E with a diagonal E is factorised, E_ii > 0 at these pivots only, and the proximal point
 * method iterates to the minimiser for H itself.
 *
 * Storage: H holds D on its diagonal, L below and L' above; R is stored transposed (row j: coefficients of member j).
 * Loops run over panels of four, for which every vector and matrix is padded with zeros.
 * ------------------------------------------------------------------------------------------------------------------ */

/* Contract of this part: H = L D L', its substitutions, and panels of four lanes. */

/* y[j] += c0 rows[0][j] + c1 rows[1][j] + c2 rows[2][j] + c3 rows[3][j],  from <= j < to */
static inline void qp_add_panel(golden_real *y, const golden_real *rows, golden_real c0, golden_real c1, golden_real c2, golden_real c3,
                         int from, int to)
{
    for (int j = from; j < to; j += 4) {
        const golden_real *a = rows + j;
        golden_real s[4];
        for (int l = 0; l < 4; ++l) {
            s[l] = y[j + l] + ((c0 * a[l] + c1 * a[GOLDEN_LDV + l]) +
                               (c2 * a[2 * GOLDEN_LDV + l] + c3 * a[3 * GOLDEN_LDV + l]));
        }
        for (int l = 0; l < 4; ++l) {
            y[j + l] = s[l];
        }
    }
}

/* sum_j a_j b_j,  j < n, in four partial sums */
static inline golden_real qp_dot(const golden_real *a, const golden_real *b, int n)
{
    golden_real s[4] = {0.0, 0.0, 0.0, 0.0};
    for (int j = 0; j < n; j += 4) {
        for (int l = 0; l < 4; ++l) {
            s[l] += a[j + l] * b[j + l];
        }
    }
    return (s[0] + s[2]) + (s[1] + s[3]);
}

/* A pivot below this share of the diagonal entry may be zero. */
static inline golden_real qp_zero_pivot(void)
{
    return 0.0625 * sqrt(2.220446049250313e-16);
}

/* Weight of the proximal term as a share of the diagonal entry. */
static inline golden_real qp_proximal_share(void)
{
    return 512.0 * sqrt(2.220446049250313e-16);
}

/* L D L' of the diagonal panel b; reference[k]: diagonal of H before elimination. Returns 0, and leaves the panel as it is, if
 * a pivot is not safely positive. */
static int qp_factorize_diagonal(golden_qp_t *q, int b, const golden_real *reference)
{
    golden_real *h0 = q->H[b] + b, *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b, *h3 = q->H[b + 3] + b;
    const golden_real x10 = h1[0], x20 = h2[0], x30 = h3[0];
    const golden_real d0 = h0[0], e0 = 1.0 / d0;
    const golden_real l10 = x10 * e0, l20 = x20 * e0, l30 = x30 * e0;
    const golden_real x21 = h2[1] - l20 * x10, x31 = h3[1] - l30 * x10;
    const golden_real d1 = h1[1] - l10 * x10, e1 = 1.0 / d1;
    const golden_real l21 = x21 * e1, l31 = x31 * e1;
    const golden_real x32 = h3[2] - l30 * x20 - l31 * x21;
    const golden_real d2 = h2[2] - l20 * x20 - l21 * x21, e2 = 1.0 / d2;
    const golden_real l32 = x32 * e2;
    const golden_real d3 = h3[3] - l30 * x30 - l31 * x31 - l32 * x32, e3 = 1.0 / d3;
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
static golden_real qp_median(const golden_real *v)
{
    golden_real middle = 0.0;
    int positive = 0;
    for (int i = 0; i < GOLDEN_NV; ++i) {
        positive += v[i] > 0.0;
    }
    for (int i = 0; i < GOLDEN_NV; ++i) {
        int smaller = 0;
        for (int j = 0; j < GOLDEN_NV; ++j) {
            smaller += v[j] > 0.0 && v[j] < v[i];
        }
        middle = 2 * smaller <= positive && v[i] > middle ? v[i] : middle;
    }
    return middle > 0.0 && isfinite(middle) ? middle : 1.0;
}

/* A length for every variable: the smallest positive width of its bounds and of the rows it appears in; 1 if there is none.
 * Returns the size of the cost over these lengths: the median, for some bounds are out of all reach. */
static golden_real qp_lengths(const golden_qp_t *q, const golden_real *reference, golden_real *length)
{
    golden_real square[GOLDEN_LDV];
    for (int i = 0; i < GOLDEN_NV; ++i) {
        golden_real least = q->upper[i] - q->lower[i];
        least = least > 0.0 ? least : (golden_real)INFINITY;
        for (int j = 0; j < GOLDEN_NG; ++j) {
            const golden_real a = fabs(q->A[j][i]), width = q->upper[GOLDEN_NV + j] - q->lower[GOLDEN_NV + j];
            if (width > 0.0 && width < least * a) {
                least = width / a;
            }
        }
        length[i] = least < (golden_real)INFINITY ? least : 1.0;
        square[i] = reference[i] * length[i] * length[i];
    }
    return qp_median(square);
}

/* Weights of the proximal term: a share of the diagonal of H, and where that is (nearly) zero, of the cost over the square of a
 * length. */
static void qp_set_proximal_weights(golden_qp_t *q, const golden_real *reference)
{
    golden_real length[GOLDEN_LDV];
    const golden_real cost = qp_lengths(q, reference, length);
    for (int i = 0; i < GOLDEN_NV; ++i) {
        const golden_real other = cost / (length[i] * length[i]);
        const int known = reference[i] > 7.105427357601002e-15 * other;
        q->weight[i] = known ? qp_proximal_share() * reference[i] : 0.015625 * other;
        q->proximal[i] = q->center[i] = 0.0;
    }
    for (int i = GOLDEN_NV; i < GOLDEN_LDV; ++i) {
        q->weight[i] = q->proximal[i] = q->center[i] = 0.0;
    }
    q->semidefinite = 1;
}

/* As qp_factorize_diagonal, pivot by pivot: one that may be zero gets the weight of the proximal term. Returns 0 if a pivot is
 * negative beyond rounding, or not finite. */
static int qp_factorize_semidefinite(golden_qp_t *q, int b, const golden_real *reference)
{
    const golden_real zero = qp_zero_pivot();
    if (!q->semidefinite) {
        qp_set_proximal_weights(q, reference);
    }
    for (int k = b; k < b + 4; ++k) {
        golden_real *h = q->H[k];
        golden_real d = h[k];
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
        q->inverse[k] = 1.0 / d;
        for (int i = k + 1; i < b + 4; ++i) {
            golden_real x = q->H[i][k];
            for (int j = b; j < k; ++j) {
                x -= q->H[i][j] * h[j] * q->H[j][j];
            }
            q->H[i][k] = h[i] = x * q->inverse[k];
        }
    }
    return 1;
}

/* A zero pivot of a semidefinite matrix has zeros below it: x_ik^2 <= (pivot k) H_ii, where x_ik = L_ik d_k. */
static int qp_zero_below(golden_qp_t *q, int b, const golden_real *reference)
{
    int valid = 1;
    for (int k = b; k < b + 4; ++k) {
        for (int i = k + 1; q->proximal[k] > 0.0 && i < GOLDEN_NV; ++i) {
            const golden_real x = q->H[k][i] * q->H[k][k];
            valid &= x * x <= qp_zero_pivot() * reference[k] * reference[i];
        }
    }
    return valid;
}

/* Columns b..b+3 of L below the diagonal panel. With X = L D: X_i0 = H_i0, X_i1 = H_i1 - X_i0 L_10, ...;
 * then the trailing lower triangle: H_ij -= sum_k X_ik L_jk. */
static void qp_factorize_panel(golden_qp_t *q, int b)
{
    const golden_real *h0 = q->H[b], *h1 = q->H[b + 1], *h2 = q->H[b + 2];
    const golden_real l10 = h0[b + 1], l20 = h0[b + 2], l30 = h0[b + 3], l21 = h1[b + 2], l31 = h1[b + 3], l32 = h2[b + 3];
    const golden_real e0 = q->inverse[b], e1 = q->inverse[b + 1], e2 = q->inverse[b + 2], e3 = q->inverse[b + 3];
    for (int i = b + 4; i < GOLDEN_LDV; ++i) {
        golden_real *h = q->H[i] + b;
        const golden_real x0 = h[0];
        const golden_real x1 = h[1] - x0 * l10;
        const golden_real x2 = h[2] - x0 * l20 - x1 * l21;
        const golden_real x3 = h[3] - x0 * l30 - x1 * l31 - x2 * l32;
        h[1] = x1;
        h[2] = x2;
        h[3] = x3;
        q->H[b][i] = x0 * e0;
        q->H[b + 1][i] = x1 * e1;
        q->H[b + 2][i] = x2 * e2;
        q->H[b + 3][i] = x3 * e3;
    }
    for (int i = b + 4; i < GOLDEN_NV; ++i) {
        golden_real *h = q->H[i] + b;
        const golden_real x0 = h[0], x1 = h[1], x2 = h[2], x3 = h[3];
        qp_add_panel(q->H[i], q->H[b], -x0, -x1, -x2, -x3, b + 4, i + 1);
        h[0] = x0 * e0;
        h[1] = x1 * e1;
        h[2] = x2 * e2;
        h[3] = x3 * e3;
    }
}

/* H + diag(proximal) = L D L' in place, inverse = D^{-1/2}; rows NV to LDV of the identity make the last panel whole. */
static golden_status_t qp_factorize_hessian(golden_qp_t *q)
{
    golden_real reference[GOLDEN_LDV];
    q->semidefinite = 0;
    for (int i = GOLDEN_NV; i < GOLDEN_LDV; ++i) {
        for (int j = 0; j < GOLDEN_LDV; ++j) {
            q->H[i][j] = 0.0;
        }
        q->H[i][i] = 1.0;
    }
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        reference[i] = q->H[i][i];
    }
    for (int b = 0; b < GOLDEN_LDV; b += 4) {
        const int definite = qp_factorize_diagonal(q, b, reference);
        if (!definite && !qp_factorize_semidefinite(q, b, reference)) {
            return GOLDEN_NUMERICAL_FAILURE;
        }
        qp_factorize_panel(q, b);
        if (!definite && !qp_zero_below(q, b, reference)) {
            return GOLDEN_NUMERICAL_FAILURE;
        }
    }
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        q->inverse[i] = sqrt(q->inverse[i]);
    }
    return GOLDEN_OK;
}

/* y := D^{-1/2} L^{-1} y, where y_i = 0 for i < first */
static void qp_forward(const golden_qp_t *q, golden_real *y, int first)
{
    for (int b = first - first % 4; b < GOLDEN_LDV; b += 4) {
        const golden_real *h0 = q->H[b] + b, *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b;
        const golden_real y0 = y[b];
        const golden_real y1 = y[b + 1] - h0[1] * y0;
        const golden_real y2 = y[b + 2] - h0[2] * y0 - h1[2] * y1;
        const golden_real y3 = y[b + 3] - h0[3] * y0 - h1[3] * y1 - h2[3] * y2;
        y[b] = y0 * q->inverse[b];
        y[b + 1] = y1 * q->inverse[b + 1];
        y[b + 2] = y2 * q->inverse[b + 2];
        y[b + 3] = y3 * q->inverse[b + 3];
        qp_add_panel(y, q->H[b], -y0, -y1, -y2, -y3, b + 4, GOLDEN_LDV);
    }
}

/* z = L^{-T} D^{-1/2} y */
static void qp_backward(const golden_qp_t *q, const golden_real *y, golden_real *z)
{
    for (int j = 0; j < GOLDEN_LDV; ++j) {
        z[j] = y[j] * q->inverse[j];
    }
    for (int b = GOLDEN_LDV - 4; b >= 0; b -= 4) {
        const golden_real *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b, *h3 = q->H[b + 3] + b;
        const golden_real z3 = z[b + 3];
        const golden_real z2 = z[b + 2] - h3[2] * z3;
        const golden_real z1 = z[b + 1] - h3[1] * z3 - h2[1] * z2;
        const golden_real z0 = z[b] - h3[0] * z3 - h2[0] * z2 - h1[0] * z1;
        z[b] = z0;
        z[b + 1] = z1;
        z[b + 2] = z2;
        qp_add_panel(z, q->H[b], -z0, -z1, -z2, -z3, 0, b);
    }
}

/* Contract of this part: the factorised working set, rows that enter and leave it, the minimiser on it. */

/* w := R^{-T} w */
static void qp_forward_working_set(const golden_qp_t *q, golden_real *w)
{
    for (int b = 0; b < q->nw; b += 4) {
        const golden_real *r0 = q->R[b], *r1 = q->R[b + 1], *r2 = q->R[b + 2], *r3 = q->R[b + 3];
        const golden_real w0 = (w[b] - qp_dot(r0, w, b)) * q->R_inverse[b];
        const golden_real w1 = (w[b + 1] - qp_dot(r1, w, b) - r1[b] * w0) * q->R_inverse[b + 1];
        const golden_real w2 = (w[b + 2] - qp_dot(r2, w, b) - r2[b] * w0 - r2[b + 1] * w1) * q->R_inverse[b + 2];
        const golden_real w3 = (w[b + 3] - qp_dot(r3, w, b) - r3[b] * w0 - r3[b + 1] * w1 - r3[b + 2] * w2) *
                              q->R_inverse[b + 3];
        w[b] = w0;
        w[b + 1] = w1;
        w[b + 2] = w2;
        w[b + 3] = w3;
    }
}

/* x = R^{-1} c */
static void qp_backward_working_set(const golden_qp_t *q, const golden_real *c, golden_real *x)
{
    for (int k = 0; k < (q->nw + 3) / 4 * 4; ++k) {
        x[k] = c[k];
    }
    for (int b = (q->nw + 3) / 4 * 4 - 4; b >= 0; b -= 4) {
        const golden_real *r1 = q->R[b + 1] + b, *r2 = q->R[b + 2] + b, *r3 = q->R[b + 3] + b;
        const golden_real x3 = x[b + 3] * q->R_inverse[b + 3];
        const golden_real x2 = (x[b + 2] - r3[2] * x3) * q->R_inverse[b + 2];
        const golden_real x1 = (x[b + 1] - r3[1] * x3 - r2[1] * x2) * q->R_inverse[b + 1];
        const golden_real x0 = (x[b] - r3[0] * x3 - r2[0] * x2 - r1[0] * x1) * q->R_inverse[b];
        x[b] = x0;
        x[b + 1] = x1;
        x[b + 2] = x2;
        x[b + 3] = x3;
        qp_add_panel(x, q->R[b], -x0, -x1, -x2, -x3, 0, b);
    }
}

/* d = Q v */
static void qp_coefficients(const golden_qp_t *q, const golden_real *v, golden_real *d)
{
    for (int b = 0; b < q->nw; b += 4) {
        const golden_real d0 = qp_dot(q->Q[b], v, GOLDEN_LDV), d1 = qp_dot(q->Q[b + 1], v, GOLDEN_LDV);
        const golden_real d2 = qp_dot(q->Q[b + 2], v, GOLDEN_LDV), d3 = qp_dot(q->Q[b + 3], v, GOLDEN_LDV);
        d[b] = d0;
        d[b + 1] = d1;
        d[b + 2] = d2;
        d[b + 3] = d3;
    }
}

/* v := v - Q'd */
static void qp_subtract_span(const golden_qp_t *q, const golden_real *d, golden_real *v)
{
    for (int b = 0; b < q->nw; b += 4) {
        qp_add_panel(v, q->Q[b], -d[b], -d[b + 1], -d[b + 2], -d[b + 3], 0, GOLDEN_LDV);
    }
}

/* The normal of row c in y: m = D^{-1/2} L^{-1} a_c. Returns m'm. */
static golden_real qp_normal(golden_qp_t *q, int c)
{
    if (c < GOLDEN_NV) {
        for (int j = 0; j < GOLDEN_LDV; ++j) {
            q->m[j] = 0.0;
        }
        q->m[c] = 1.0;
        qp_forward(q, q->m, c);
    } else {
        for (int j = 0; j < GOLDEN_LDV; ++j) {
            q->m[j] = q->A[c - GOLDEN_NV][j];
        }
        qp_forward(q, q->m, 0);
    }
    return qp_dot(q->m, q->m, GOLDEN_LDV);
}

/* m = Q'd + v with Q v = 0; a second pass where cancellation has cost orthogonality. Returns v'v. */
static golden_real qp_project(golden_qp_t *q, golden_real mm)
{
    golden_real e[GOLDEN_LDV], vv = mm;
    for (int j = 0; j < GOLDEN_LDV; ++j) {
        q->v[j] = q->m[j];
    }
    if (q->nw > 0) {
        qp_coefficients(q, q->v, q->d);
        qp_subtract_span(q, q->d, q->v);
        vv = qp_dot(q->v, q->v, GOLDEN_LDV);
        if (vv < 0.5 * mm) {
            qp_coefficients(q, q->v, e);
            qp_subtract_span(q, e, q->v);
            for (int k = 0; k < q->nw; ++k) {
                q->d[k] += e[k];
            }
            vv = qp_dot(q->v, q->v, GOLDEN_LDV);
        }
    }
    return vv;
}

/* Row c enters the working set on the given side with multiplier lam; m = Q'd + v is its projection. */
static void qp_append(golden_qp_t *q, int c, int side, golden_real vv, golden_real lam)
{
    const int k = q->nw;
    const golden_real norm = sqrt(vv), scale = 1.0 / norm;
    if (k % 4 == 0) {
        for (int i = k; i < k + 4; ++i) {
            q->R_inverse[i] = 0.0;
            for (int j = 0; j < GOLDEN_LDV; ++j) {
                q->Q[i][j] = 0.0;
                q->R[i][j] = 0.0;
            }
        }
    }
    for (int j = 0; j < GOLDEN_LDV; ++j) {
        q->Q[k][j] = q->v[j] * scale;
    }
    for (int j = 0; j < k; ++j) {
        q->R[k][j] = q->d[j];
    }
    q->R[k][k] = norm;
    q->R_inverse[k] = scale;
    q->lam[k] = lam;
    q->work[k] = c;
    q->side[c] = side;
    q->nw = k + 1;
}

/* Givens rotation of the rows k, k+1 of R (columns of its transpose) and of Q that restores R_{k+1,k} = 0. */
static void qp_rotate(golden_qp_t *q, int k)
{
    const golden_real a = q->R[k][k], b = q->R[k][k + 1];
    const golden_real norm = sqrt(a * a + b * b), scale = 1.0 / norm, c = a * scale, s = b * scale;
    q->R[k][k] = norm;
    q->R[k][k + 1] = 0.0;
    q->R_inverse[k] = scale;
    for (int i = k + 1; i < q->nw; ++i) {
        const golden_real u = q->R[i][k], v = q->R[i][k + 1];
        q->R[i][k] = c * u + s * v;
        q->R[i][k + 1] = c * v - s * u;
    }
    for (int j = 0; j < GOLDEN_LDV; j += 4) {
        golden_real u[4], v[4];
        for (int l = 0; l < 4; ++l) {
            u[l] = c * q->Q[k][j + l] + s * q->Q[k + 1][j + l];
            v[l] = c * q->Q[k + 1][j + l] - s * q->Q[k][j + l];
        }
        for (int l = 0; l < 4; ++l) {
            q->Q[k][j + l] = u[l];
            q->Q[k + 1][j + l] = v[l];
        }
    }
}

/* Member k leaves the working set. */
static void qp_remove(golden_qp_t *q, int k)
{
    const int last = q->nw - 1;
    q->side[q->work[k]] = 0;
    for (int i = k; i < last; ++i) {
        q->work[i] = q->work[i + 1];
        q->lam[i] = q->lam[i + 1];
        for (int j = 0; j <= i + 1; ++j) {
            q->R[i][j] = q->R[i + 1][j];
        }
    }
    q->nw = last;
    for (int i = k; i < last; ++i) {
        qp_rotate(q, i);
    }
    q->R_inverse[last] = 0.0;
    for (int j = 0; j < GOLDEN_LDV; ++j) {
        q->Q[last][j] = 0.0;
        q->R[last][j] = 0.0;
    }
    ++q->changes;
}

/* Active bound of member k. */
static golden_real qp_active_bound(const golden_qp_t *q, int k)
{
    const int c = q->work[k];
    return q->side[c] > 0 ? q->upper[c] : q->lower[c];
}

/* The largest multiplier that row c may have. */
static inline golden_real qp_limit(const golden_qp_t *q, int c)
{
    return q->penalty[c];
}

static inline int qp_saturated(const golden_qp_t *q, int c)
{
    return q->side[c] > 1 || q->side[c] < -1;
}

/* Multiplier of row c, not a member. */
static inline golden_real qp_outside_multiplier(const golden_qp_t *q, int c)
{
    return !qp_saturated(q, c) ? 0.0 : q->side[c] > 0 ? qp_limit(q, c) : -qp_limit(q, c);
}

/* Member k leaves the working set with its multiplier at the limit of the given side: y0 -= mult m, m = Q'R. */
static void qp_saturate(golden_qp_t *q, int k, int side)
{
    const int c = q->work[k];
    const golden_real limit = qp_limit(q, c), mult = side > 0 ? limit : -limit;
    for (int i = 0; i <= k; ++i) {
        for (int j = 0; j < GOLDEN_LDV; ++j) {
            q->y0[j] -= mult * q->R[k][i] * q->Q[i][j];
        }
    }
    q->shift += limit * sqrt(qp_dot(q->R[k], q->R[k], (k + 4) / 4 * 4));
    qp_remove(q, k);
    q->side[c] = 2 * side;
}

/* y0 = -D^{-1/2} L^{-1} (g - proximal center + sum_saturated mult_c a_c) and its size; shift: sum of |mult_c| |D^{-1/2} a_c|. */
static void qp_set_origin(golden_qp_t *q)
{
    for (int i = 0; i < GOLDEN_NV; ++i) {
        q->y0[i] = -q->g[i];
    }
    for (int i = GOLDEN_NV; i < GOLDEN_LDV; ++i) {
        q->y0[i] = 0.0;
    }
    for (int i = 0; q->semidefinite && i < GOLDEN_NV; ++i) {
        q->y0[i] += q->proximal[i] * q->center[i];
    }
    q->shift = 0.0;
    for (int i = 0; q->elastic && i < GOLDEN_NV; ++i) {
        if (qp_saturated(q, i)) {
            q->y0[i] -= qp_outside_multiplier(q, i);
            q->shift += q->penalty[i] * q->inverse[i];
        }
    }
    for (int j = 0; q->elastic && j < GOLDEN_NG; ++j) {
        if (qp_saturated(q, GOLDEN_NV + j)) {
            const golden_real *a = q->A[j], mult = qp_outside_multiplier(q, GOLDEN_NV + j);
            golden_real squares = 0.0;
            for (int i = 0; i < GOLDEN_NV; ++i) {
                q->y0[i] -= mult * a[i];
                squares += (a[i] * q->inverse[i]) * (a[i] * q->inverse[i]);
            }
            q->shift += q->penalty[GOLDEN_NV + j] * sqrt(squares);
        }
    }
    qp_forward(q, q->y0, 0);
    q->scale = sqrt(qp_dot(q->y0, q->y0, GOLDEN_LDV));
}

/* 1 if y is the small difference of large terms. */
static int qp_cancelled(const golden_qp_t *q)
{
    const golden_real size = 0.125 * (q->scale + q->shift);
    return qp_dot(q->y, q->y, GOLDEN_LDV) < size * size;
}

/* y and lam of the working set; t the active bounds: R'w = t, c = Q y0 - w, y = y0 - Q'c, lam = R^{-1} c. After cancellation
 * a second pass, with y in place of y0, makes Q y = w again. */
static void qp_minimize_on_working_set(golden_qp_t *q)
{
    golden_real w[GOLDEN_LDV], c[GOLDEN_LDV];
    for (int k = 0; k < q->nw; ++k) {
        w[k] = qp_active_bound(q, k);
    }
    for (int k = q->nw; k % 4 != 0; ++k) {
        w[k] = 0.0;
    }
    qp_forward_working_set(q, w);
    qp_coefficients(q, q->y0, c);
    for (int k = 0; k < q->nw; ++k) {
        c[k] -= w[k];
    }
    for (int j = 0; j < GOLDEN_LDV; ++j) {
        q->y[j] = q->y0[j];
    }
    qp_subtract_span(q, c, q->y);
    qp_backward_working_set(q, c, q->lam);
    if (qp_cancelled(q)) {
        qp_coefficients(q, q->y, c);
        for (int k = 0; k < q->nw; ++k) {
            c[k] -= w[k];
        }
        qp_subtract_span(q, c, q->y);
    }
}

/* Contract of this part: dual iterations from a predicted working set to the solution or a certificate. */

/* Member with the most wrong multiplier, -1 if none: outside [0, limit] (equality: [-limit, limit]) by more than rounding,
 * excess |m| > tolerance (|y0| + |y|). */
static int qp_wrong_multiplier(const golden_qp_t *q)
{
    int worst = -1;
    golden_real most = 0.0;
    for (int k = 0; k < q->nw; ++k) {
        const int c = q->work[k];
        const golden_real lam = q->side[c] > 0 ? q->lam[k] : -q->lam[k];
        golden_real excess = q->lower[c] < q->upper[c] ? -lam : 0.0;
        if (q->elastic) {
            const golden_real above = fabs(lam) - qp_limit(q, c);
            excess = above > excess ? above : excess;
        }
        if (excess > 0.0) {
            const golden_real weighted = excess * sqrt(qp_dot(q->R[k], q->R[k], (k + 4) / 4 * 4));
            const golden_real rounding = q->scale + q->shift + sqrt(qp_dot(q->y, q->y, GOLDEN_LDV));
            if (weighted > most && weighted > 1.4210854715202004e-14 * rounding) {
                most = weighted;
                worst = k;
            }
        }
    }
    return worst;
}

/* Minimises on the working set; wrong multipliers are dropped or saturated, the worst first, until there is none. */
static golden_status_t qp_restore_dual_feasibility(golden_qp_t *q)
{
    for (;;) {
        qp_minimize_on_working_set(q);
        const int k = qp_wrong_multiplier(q);
        if (k < 0) {
            return GOLDEN_OK;
        }
        if (q->iterations >= GOLDEN_QP_MAX_ITERATIONS) {
            return GOLDEN_ITERATION_LIMIT;
        }
        ++q->iterations;
        const int c = q->work[k], side = q->lam[k] > 0.0 ? 1 : -1;
        if (q->lower[c] < q->upper[c] && side != q->side[c]) {
            qp_remove(q, k);
        } else {
            qp_saturate(q, k, side);
        }
    }
}

/* norm: |D^{-1/2} a_c|, an estimate of |m|; size: of the terms whose sum is a_c'z (a lower bound). */
static void qp_row_scale(const golden_qp_t *q, int c, golden_real *norm, golden_real *size)
{
    if (c < GOLDEN_NV) {
        *norm = q->inverse[c];
        *size = fabs(q->x[c]) + q->inverse[c] * fabs(q->y[c]);
    } else {
        const golden_real *a = q->A[c - GOLDEN_NV];
        golden_real s = 0.0, squares = 0.0;
        for (int j = 0; j < GOLDEN_NV; ++j) {
            s += fabs(a[j] * q->x[j]);
            squares += (a[j] * q->inverse[j]) * (a[j] * q->inverse[j]);
        }
        *norm = sqrt(squares);
        *size = s;
    }
}

/* How far the value of the saturated row c lies inside the bound at which it is saturated: there its multiplier goes back. */
static void qp_inside(const golden_qp_t *q, int c, golden_real *over, golden_real *under)
{
    if (q->side[c] > 0) {
        *under = -*over;
        *over = -(golden_real)INFINITY;
    } else {
        *over = -*under;
        *under = -(golden_real)INFINITY;
    }
}

/* The row that is violated most, measured in y by 1/|D^{-1/2} a_c|, and by how much; -1 if none. A value that is not finite
 * is returned as the violation. Tolerated: the rounding error of a_c'z, and what qp_enforce accepted. */
static int qp_most_violated(const golden_qp_t *q, int *side, golden_real *violation)
{
    int worst = -1;
    golden_real most = 0.0;
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        if (q->side[c] != 0 && !qp_saturated(q, c)) {
            continue;
        }
        const golden_real value = c < GOLDEN_NV ? q->x[c] : qp_dot(q->A[c - GOLDEN_NV], q->x, GOLDEN_LDV);
        golden_real over = value - q->upper[c], under = q->lower[c] - value;
        if (q->side[c] != 0) {
            qp_inside(q, c, &over, &under);
        }
        if (!(over <= q->slack[c] && under <= q->slack[c])) {
            const golden_real amount = over > under ? over : under;
            golden_real norm, size;
            if (!isfinite(value)) {
                *violation = value;
                return c;
            }
            qp_row_scale(q, c, &norm, &size);
            if (amount > 8.881784197001252e-16 * size && amount > most * norm) {
                most = amount / norm;
                worst = c;
                *side = over > under ? 1 : -1;
                *violation = amount;
            }
        }
    }
    return worst;
}

/* How far side * lam of member k may move at the given rate: down to 0 (equality: -limit), up to limit. leave: the side at
 * which it saturates there, 0 if it is dropped. */
static golden_real qp_room(const golden_qp_t *q, int k, int falls, int *leave)
{
    const int c = q->work[k], side = q->side[c] > 0 ? 1 : -1;
    const golden_real lam = side > 0 ? q->lam[k] : -q->lam[k];
    if (falls && q->lower[c] < q->upper[c]) {
        *leave = 0;
        return lam;
    }
    *leave = falls ? -side : side;
    return falls ? qp_limit(q, c) + lam : qp_limit(q, c) - lam;
}

/* The first member whose multiplier reaches an end of its range when the one of the entering row grows by t on the given
 * side: lam - side t r, r = R^{-1} d. Returns -1 if none; mm: squared norm of the entering normal. */
static int qp_blocking(const golden_qp_t *q, const golden_real *r, int side, golden_real mm, golden_real *step, int *leave)
{
    int first = -1;
    for (int k = 0; k < q->nw; ++k) {
        const int falls = ((q->side[q->work[k]] > 0) == (side > 0)) == (r[k] > 0.0);
        const golden_real rate = fabs(r[k]);
        int end;
        const golden_real room = qp_room(q, k, falls, &end);
        if (rate > 0.0 && room < (golden_real)INFINITY) {
            const golden_real norm2 = qp_dot(q->R[k], q->R[k], (k + 4) / 4 * 4);
            if (rate * rate * norm2 > 2.2737367544323206e-13 * 2.2737367544323206e-13 * mm &&
                (first < 0 || room < *step * rate)) {
                first = k;
                *leave = end;
                *step = room > 0.0 ? room / rate : 0.0;
            }
        }
    }
    return first;
}

/* lam -= step r, and y -= step v if the normal has a part v outside the span of the working set. */
static void qp_move(golden_qp_t *q, const golden_real *r, golden_real step, int primal)
{
    for (int k = 0; k < q->nw; ++k) {
        q->lam[k] -= step * r[k];
    }
    if (primal) {
        for (int j = 0; j < GOLDEN_LDV; ++j) {
            q->y[j] -= step * q->v[j];
        }
    }
}

/* Violation of the row with normal m = Q'R r + v that is taken as rounding. The members' part is a multiple of
 * size = |bound| + |t|'|r| + |m| (|y| / 4 + a little |y0|); entering would move y by violation / |v|, so it grows with
 * |m| / |v|, up to that of a row that cannot enter. The other part is that of v'y, which y0 dominates: a multiple of |v| |y0|. */
static golden_real qp_rounding(const golden_qp_t *q, const golden_real *r, golden_real bound, golden_real mm, golden_real vv)
{
    const golden_real most = 5.684341886080802e-14, least = 8.881784197001252e-16;
    const golden_real outside = 2.220446049250313e-16 * sqrt(vv) * (q->scale + q->shift);
    golden_real size = 0.25 * sqrt(qp_dot(q->y, q->y, GOLDEN_LDV));
    size = fabs(bound) + sqrt(mm) * (size + 9.5367431640625e-07 * (q->scale + q->shift));
    for (int k = 0; k < q->nw; ++k) {
        size += fabs(qp_active_bound(q, k) * r[k]);
    }
    return outside + size * (vv * (most * most) > mm * (least * least) ? least * sqrt(mm / vv) : most);
}

/* The rows c and work[k] contradict each other: certificate = side (e_c - sum_k r_k e_k), normalised, rounding left out. */
static void qp_certify(golden_qp_t *q, int c, int side, const golden_real *r, golden_real mm)
{
    golden_real most = 1.0;
    for (int i = 0; i < GOLDEN_NV + GOLDEN_NG; ++i) {
        q->certificate[i] = 0.0;
    }
    q->certificate[c] = side > 0 ? 1.0 : -1.0;
    for (int k = 0; k < q->nw; ++k) {
        const golden_real norm2 = qp_dot(q->R[k], q->R[k], (k + 4) / 4 * 4);
        if (r[k] * r[k] * norm2 > 2.2737367544323206e-13 * 2.2737367544323206e-13 * mm) {
            q->certificate[q->work[k]] = side > 0 ? -r[k] : r[k];
            most = fabs(r[k]) > most ? fabs(r[k]) : most;
        }
    }
    for (int i = 0; i < GOLDEN_NV + GOLDEN_NG; ++i) {
        q->certificate[i] = q->certificate[i] / most;
    }
}

/* y0 -= mult m for the row with normal m that joins the cost, or leaves it (mult with the other sign). */
static void qp_shift_origin(golden_qp_t *q, golden_real mult, golden_real mm)
{
    for (int j = 0; j < GOLDEN_LDV; ++j) {
        q->y0[j] -= mult * q->m[j];
    }
    q->shift += fabs(mult) * sqrt(mm);
}

/* Row c comes to rest: its multiplier has moved by `moved`. It is a member now, or saturated or inactive. */
static void qp_settle(golden_qp_t *q, int c, int side, int member, golden_real moved, golden_real mm, golden_real vv)
{
    const int state = q->side[c];
    const golden_real before = qp_outside_multiplier(q, c), lam = side > 0 ? before + moved : before - moved;
    if (member) {
        qp_append(q, c, state == 0 ? side : state > 0 ? 1 : -1, vv, lam);
    } else {
        q->side[c] = state == 0 || q->lower[c] >= q->upper[c] ? 2 * side : 0;
    }
    if (qp_limit(q, c) < (golden_real)INFINITY) {
        qp_shift_origin(q, (member ? 0.0 : lam) - before, mm);
    }
    ++q->changes;
}

/* How far the multiplier of the entering row c may move: from 0 to its limit, from there to 0 (equality: to -limit). */
static golden_real qp_reach(const golden_qp_t *q, int c)
{
    const golden_real limit = qp_limit(q, c);
    return q->side[c] != 0 && q->lower[c] >= q->upper[c] ? limit + limit : limit;
}

/* Dual steps until the violated row c is satisfied and in the working set, or its multiplier at the end of its range. A
 * violation that may be rounding is accepted instead, and remembered in slack[c]. */
static golden_status_t qp_enforce(golden_qp_t *q, int c, int side, golden_real violation)
{
    const int state = q->side[c];
    const golden_real mm = qp_normal(q, c), bound = (state == 0 ? side : state) > 0 ? q->upper[c] : q->lower[c];
    const golden_real reach = qp_reach(q, c), sign = side > 0 ? 1.0 : -1.0;
    golden_real r[GOLDEN_LDV], moved = 0.0;
    if (!isfinite(mm) || !isfinite(violation)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    while (q->iterations < GOLDEN_QP_MAX_ITERATIONS) {
        const golden_real vv = qp_project(q, mm);
        const int primal = vv > 2.2737367544323206e-13 * 2.2737367544323206e-13 * mm;
        golden_real step = 0.0;
        int leave = 0;
        qp_backward_working_set(q, q->d, r);
        if (!(moved > 0.0)) {
            q->slack[c] = qp_rounding(q, r, bound, mm, vv);
            if (violation <= q->slack[c]) {
                return GOLDEN_OK;
            }
        }
        const int blocking = qp_blocking(q, r, side, mm, &step, &leave);
        if (!primal && blocking < 0 && !(reach < (golden_real)INFINITY)) {
            qp_certify(q, c, side, r, mm);
            return GOLDEN_INFEASIBLE;
        }
        ++q->iterations;
        violation = sign * (qp_dot(q->m, q->y, GOLDEN_LDV) - bound);
        const int full = primal && (blocking < 0 || violation <= step * vv) && violation <= (reach - moved) * vv;
        const int last = full || blocking < 0 || reach - moved <= step;
        if (last) {
            step = !full ? reach - moved : violation > 0.0 ? violation / vv : 0.0;
        }
        moved += step;
        qp_move(q, r, sign * step, primal);
        if (last) {
            qp_settle(q, c, side, full, moved, mm, vv);
            return GOLDEN_OK;
        }
        if (leave == 0) {
            qp_remove(q, blocking);
        } else {
            qp_saturate(q, blocking, leave);
        }
    }
    return GOLDEN_ITERATION_LIMIT;
}

/* Row c enters the predicted working set unless it depends on the rows already there. */
static golden_status_t qp_predict_active(golden_qp_t *q, int c, int side)
{
    const golden_real mm = qp_normal(q, c);
    q->side[c] = 0;
    if (!isfinite(mm)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    if (q->nw < GOLDEN_NV && mm > 0.0) {
        const golden_real vv = qp_project(q, mm);
        if (vv > 3.637978807091713e-12 * 3.637978807091713e-12 * mm) {
            qp_append(q, c, side, vv, 0.0);
        }
    }
    return GOLDEN_OK;
}

/* Saturation ends where the row has become hard, or the bound infinite. */
static void qp_release_saturated(golden_qp_t *q)
{
    for (int c = GOLDEN_NV; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        const int held = qp_limit(q, c) < (golden_real)INFINITY && isfinite(q->side[c] > 0 ? q->upper[c] : q->lower[c]);
        if (qp_saturated(q, c) && !held) {
            q->side[c] = 0;
        }
    }
}

/* Sets elastic; returns 0 if a penalty is invalid. */
static int qp_take_penalties(golden_qp_t *q)
{
    int valid = 1, elastic = 0;
    for (int j = 0; j < GOLDEN_NV + GOLDEN_NG; ++j) {
        valid &= q->penalty[j] >= 0.0;
        elastic |= q->penalty[j] < (golden_real)INFINITY;
    }
    if (elastic || q->elastic) {
        qp_release_saturated(q);
    }
    q->elastic = elastic;
    return valid;
}

/* Checks the present bounds (crossed: infeasible); a member whose active side became infinite leaves. */
static golden_status_t qp_take_bounds(golden_qp_t *q)
{
    int valid = qp_take_penalties(q), ordered = 1;
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        valid &= q->lower[c] < ((golden_real)INFINITY) && q->upper[c] > -((golden_real)INFINITY);
        ordered &= q->lower[c] <= q->upper[c];
        q->slack[c] = 0.0;
    }
    if (!valid || !ordered) {
        return valid ? GOLDEN_INFEASIBLE : GOLDEN_NUMERICAL_FAILURE;
    }
    for (int k = q->nw - 1; k >= 0; --k) {
        if (!isfinite(qp_active_bound(q, k))) {
            qp_remove(q, k);
        }
    }
    return GOLDEN_OK;
}

/* Multipliers of the saturated rows; counts those that are violated by more than rounding. */
static void qp_write_saturated(golden_qp_t *q)
{
    for (int j = 0; j < GOLDEN_NG; ++j) {
        const int c = GOLDEN_NV + j;
        if (qp_saturated(q, c)) {
            const golden_real bound = q->side[c] > 0 ? q->upper[c] : q->lower[c];
            const golden_real excess = qp_dot(q->A[j], q->x, GOLDEN_LDV) - bound;
            golden_real norm, size;
            qp_row_scale(q, c, &norm, &size);
            q->mult[c] = qp_outside_multiplier(q, c);
            q->relaxed += fabs(excess) > 5.684341886080802e-14 * (size + fabs(bound));
        }
    }
}

/* A multiplier that exceeds its limit by rounding. */
static golden_real qp_clip_multiplier(const golden_qp_t *q, int c, golden_real lam)
{
    const golden_real limit = qp_limit(q, c);
    return lam > limit ? limit : lam < -limit ? -limit : lam;
}

/* Results from y, lam and the working set; active bounds hold exactly, wrong signs within rounding become zero. */
static int qp_write_result(golden_qp_t *q)
{
    golden_real total = qp_dot(q->x, q->x, GOLDEN_LDV);
    q->dropped = q->relaxed = 0;
    for (int i = 0; i < GOLDEN_NV; ++i) {
        q->z[i] = q->x[i];
    }
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        q->mult[c] = 0.0;
        q->dropped += q->side[c] == 0 && q->lower[c] >= q->upper[c];
    }
    if (q->elastic) {
        qp_write_saturated(q);
    }
    for (int k = 0; k < q->nw; ++k) {
        const int c = q->work[k];
        const golden_real lam = q->elastic ? qp_clip_multiplier(q, c, q->lam[k]) : q->lam[k];
        const int side = lam > 0.0 ? 1 : lam < 0.0 ? -1 : q->side[c];
        total += fabs(lam);
        if (c < GOLDEN_NV) {
            q->z[c] = qp_active_bound(q, k);
        }
        if (q->lower[c] >= q->upper[c]) {
            q->side[c] = side;
        }
        if (side == q->side[c]) {
            q->mult[c] = lam;
        }
    }
    return isfinite(total);
}

/* Nothing of the present data is kept: z = 0, mult = 0, empty working set. */
static golden_status_t qp_fail(golden_qp_t *q, golden_status_t status)
{
    q->nw = q->relaxed = q->dropped = 0;
    for (int i = 0; i < GOLDEN_NV; ++i) {
        q->z[i] = 0.0;
    }
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        q->mult[c] = q->certificate[c] = 0.0;
        q->side[c] = 0;
    }
    return status;
}

/* 1 if the working set is one that was there before (Brent's cycle search: a snapshot after 1, 2, 4, ... changes). */
static int qp_repeats(golden_qp_t *q, int count)
{
    int same = count > 1;
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        same &= q->side[c] == q->snapshot[c];
    }
    for (int c = 0; (count & (count - 1)) == 0 && c < GOLDEN_NV + GOLDEN_NG; ++c) {
        q->snapshot[c] = q->side[c];
    }
    return same;
}

/* Alternates most violated rows and dual steps; at the end y and lam come from the factors, not from the updates. */
static golden_status_t qp_iterate(golden_qp_t *q)
{
    golden_status_t status = qp_restore_dual_feasibility(q);
    int direct = 1, count = 0;
    while (status == GOLDEN_OK) {
        const int changes = q->changes;
        int side = 0;
        golden_real violation = 0.0;
        qp_backward(q, q->y, q->x);
        const int c = qp_most_violated(q, &side, &violation);
        if (c >= 0) {
            status = qp_enforce(q, c, side, violation);
            direct = 0;
            if (qp_cancelled(q)) {
                qp_minimize_on_working_set(q);
            }
            if (status == GOLDEN_OK && q->changes > changes && qp_repeats(q, ++count)) {
                status = GOLDEN_STALLED;
            }
        } else if (direct) {
            return GOLDEN_OK;
        } else {
            if (q->shift > 0.0) {
                qp_set_origin(q);
            }
            status = qp_restore_dual_feasibility(q);
            direct = 1;
        }
    }
    qp_backward(q, q->y, q->x);
    return status;
}

/* Contract of this part: proximal-point iterations around them where H is only semidefinite. */

/* u = D^{1/2} L's */
static void qp_to_working_coordinates(const golden_qp_t *q, const golden_real *s, golden_real *u)
{
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        u[i] = s[i];
        for (int j = i + 1; j < GOLDEN_LDV; ++j) {
            u[i] += q->H[i][j] * s[j];
        }
        u[i] = u[i] / q->inverse[i];
    }
}

/* The largest t for which z + t p crosses no bound of a row that is not a member. */
static golden_real qp_distance(const golden_qp_t *q, const golden_real *z, const golden_real *p)
{
    golden_real most = (golden_real)INFINITY;
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        if (q->side[c] != 0 && !qp_saturated(q, c)) {
            continue;
        }
        const golden_real value = c < GOLDEN_NV ? z[c] : qp_dot(q->A[c - GOLDEN_NV], z, GOLDEN_LDV);
        const golden_real slope = c < GOLDEN_NV ? p[c] : qp_dot(q->A[c - GOLDEN_NV], p, GOLDEN_LDV);
        golden_real over = value - q->upper[c], under = q->lower[c] - value;
        if (q->side[c] != 0) {
            qp_inside(q, c, &over, &under);
        }
        const golden_real room = slope > 0.0 ? -over : -under, speed = fabs(slope);
        if (speed > 0.0 && room < most * speed) {
            most = room > 0.0 ? room / speed : 0.0;
        }
    }
    return most;
}

/* center += t p to the minimum along p = s + beta p, or to the next bound. On one face this is the conjugate gradient method
 * with the proximal step as the preconditioned residual, so it ends after as many steps as E has directions:
 *     beta = s'(H + E)s / (the one before),   t = s'(H + E)s / p'Hp,   p'Hp = |D^{1/2} L'p|^2 - p'Ep
 * Returns t; infinite: the cost decreases without end. total: s'(H + E)s. */
static golden_real qp_conjugate_step(golden_qp_t *q, const golden_real *s, golden_real total)
{
    const golden_real beta = q->total > 0.0 && q->face == q->changes ? total / q->total : 0.0;
    golden_real u[GOLDEN_LDV], weighted = 0.0;
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        q->direction[i] = s[i] + beta * q->direction[i];
        weighted += q->proximal[i] * q->direction[i] * q->direction[i];
    }
    qp_to_working_coordinates(q, q->direction, u);
    const golden_real square = qp_dot(u, u, GOLDEN_LDV), curvature = square - weighted;
    golden_real t = qp_distance(q, q->center, q->direction);
    q->total = 0.0;
    q->face = q->changes;
    if (curvature * qp_proximal_share() > 7.105427357601002e-15 * square && total < t * curvature) {
        t = total / curvature;
        q->total = total;
    }
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        q->center[i] += t * q->direction[i];
    }
    return t;
}

/* A proximal step s = x - center is known. OK: it is rounding, and x the minimiser. ITERATION_LIMIT: the centre has moved.
 * NUMERICAL_FAILURE: the cost is unbounded below. */
static golden_status_t qp_move_center(golden_qp_t *q)
{
    golden_real s[GOLDEN_LDV], u[GOLDEN_LDV], e[GOLDEN_LDV], weighted = 0.0;
    const golden_real size = q->scale + q->shift + sqrt(qp_dot(q->y, q->y, GOLDEN_LDV));
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        s[i] = q->x[i] - q->center[i];
        weighted += q->proximal[i] * s[i] * s[i];
    }
    const golden_real step = sqrt(weighted), before = q->step;
    q->step = step;
    if (step <= 5.684341886080802e-14 * size ||
        (step <= 9.094947017729282e-13 * size && step > 0.5 * before)) {
        return GOLDEN_OK;
    }
    qp_to_working_coordinates(q, s, u);
    qp_coefficients(q, u, e);
    const golden_real total = qp_dot(u, u, GOLDEN_LDV), off = qp_dot(e, e, (q->nw + 3) / 4 * 4);
    if (off <= 3.637978807091713e-12 * total) {
        return qp_conjugate_step(q, s, total) < (golden_real)INFINITY ? GOLDEN_ITERATION_LIMIT : GOLDEN_NUMERICAL_FAILURE;
    }
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        q->center[i] = q->x[i];
    }
    q->total = 0.0;
    return GOLDEN_ITERATION_LIMIT;
}

/* The minimiser for a Hessian that is only semidefinite, by the proximal point method: z_{j+1} minimises the cost plus
 * 1/2 (z - z_j)'E(z - z_j), started at the working set of z_j. */
static golden_status_t qp_iterate_proximal(golden_qp_t *q)
{
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        q->center[i] = q->direction[i] = 0.0;
    }
    q->total = 0.0;
    q->step = (golden_real)INFINITY;
    for (int step = 0; step < GOLDEN_QP_MAX_PROXIMAL_STEPS; ++step) {
        qp_set_origin(q);
        golden_status_t status = isfinite(q->scale) ? qp_iterate(q) : GOLDEN_NUMERICAL_FAILURE;
        if (status == GOLDEN_OK) {
            status = qp_move_center(q);
            if (status == GOLDEN_ITERATION_LIMIT) {
                continue;
            }
        }
        return status;
    }
    return GOLDEN_ITERATION_LIMIT;
}

static void qp_init(golden_qp_t *q)
{
    for (int i = 0; i < GOLDEN_LDV; ++i) {
        for (int j = 0; j < GOLDEN_LDV; ++j) {
            q->H[i][j] = 0.0;
            q->Q[i][j] = 0.0;
            q->R[i][j] = 0.0;
        }
        q->inverse[i] = q->R_inverse[i] = q->y0[i] = q->y[i] = q->x[i] = 0.0;
        q->m[i] = q->v[i] = q->d[i] = q->lam[i] = 0.0;
        q->weight[i] = q->proximal[i] = q->center[i] = q->direction[i] = 0.0;
        q->work[i] = 0;
    }
    for (int j = 0; j < GOLDEN_NG; ++j) {
        for (int i = 0; i < GOLDEN_LDV; ++i) {
            q->A[j][i] = 0.0;
        }
    }
    for (int i = 0; i < GOLDEN_NV; ++i) {
        q->g[i] = 0.0;
    }
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG; ++c) {
        q->lower[c] = -(golden_real)INFINITY;
        q->upper[c] = (golden_real)INFINITY;
        q->penalty[c] = (golden_real)INFINITY;
        q->slack[c] = 0.0;
        q->snapshot[c] = 0;
    }
    q->scale = q->shift = q->total = q->step = 0.0;
    q->iterations = q->changes = q->dropped = q->factorized = q->elastic = 0;
    q->semidefinite = q->face = 0;
    qp_fail(q, GOLDEN_OK);
}

static golden_status_t qp_factorize(golden_qp_t *q)
{
    golden_status_t status = qp_factorize_hessian(q);
    q->nw = 0;
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG && status == GOLDEN_OK; ++c) {
        if (q->lower[c] >= q->upper[c] && !qp_saturated(q, c)) {
            status = qp_predict_active(q, c, q->side[c] < 0 ? -1 : 1);
        }
    }
    for (int c = 0; c < GOLDEN_NV + GOLDEN_NG && status == GOLDEN_OK; ++c) {
        if (q->side[c] != 0 && q->lower[c] < q->upper[c] && !qp_saturated(q, c)) {
            status = qp_predict_active(q, c, q->side[c]);
        }
    }
    q->factorized = status == GOLDEN_OK;
    return q->factorized ? GOLDEN_OK : qp_fail(q, status);
}

static golden_status_t qp_solve(golden_qp_t *q)
{
    golden_status_t status = q->factorized ? qp_take_bounds(q) : GOLDEN_NUMERICAL_FAILURE;
    q->iterations = q->changes = 0;
    if (status != GOLDEN_OK) {
        return qp_fail(q, status);
    }
    if (q->semidefinite) {
        status = qp_iterate_proximal(q);
    } else {
        qp_set_origin(q);
        status = isfinite(q->scale) ? qp_iterate(q) : GOLDEN_NUMERICAL_FAILURE;
    }
    if (status == GOLDEN_NUMERICAL_FAILURE || !qp_write_result(q)) {
        return qp_fail(q, GOLDEN_NUMERICAL_FAILURE);
    }
    return status;
}
