/* This part factorises H = L D L' = C C' and substitutes with the factors. */

/* Returns the fraction of the diagonal entry below which a pivot may be zero. */
static inline real_t qp_zero_pivot(void)
{
    const real_t root = SQRT(TOL_UNIT / 256), least = 4096 * TOL_UNIT;
    return least < root ? least : root;
}

/* Returns the weight of the proximal term as a fraction of the diagonal entry. */
static inline real_t qp_proximal_share(void)
{
    return SQRT(SQRT(TOL_UNIT / 65536));
}

/* y := C^{-1} y = D^{-1/2} L^{-1} y, where y_i = 0 for i < first. */
static void qp_forward(const qp_t *q, real_t *y, int first)
{
    for (int b = first - first % 4; b < LDH; b += 4) {
        real_t c[4];
        solve_block(q->H + b, b, y + b, c);
        y[b] = c[0] * q->inverse[b];
        y[b + 1] = c[1] * q->inverse[b + 1];
        y[b + 2] = c[2] * q->inverse[b + 2];
        y[b + 3] = c[3] * q->inverse[b + 3];
        subtract_panel(y, q->H + b, c, b + 4, LDH);
    }
    for (int i = LDH; i < LDV; ++i) {
        y[i] *= q->inverse[i];
    }
}

/* z = C^{-T} y = L^{-T} D^{-1/2} y. */
static void qp_backward(const qp_t *q, const real_t *y, real_t *z)
{
    for (int j = 0; j < LDV; ++j) {
        z[j] = y[j] * q->inverse[j];
    }
    solve_unit_upper(q->H, z, LDH);
}

/* Returns the median of the positive numbers in v; 1 if there is none. */
static real_t qp_median(const real_t *v)
{
    real_t middle = R(0);
    int positive = 0;
    for (int i = 0; i < NV - NSL; ++i) {
        positive += v[i] > R(0);
    }
    for (int i = 0; i < NV - NSL; ++i) {
        int smaller = 0;
        for (int j = 0; j < NV - NSL; ++j) {
            smaller += v[j] > R(0) && v[j] < v[i];
        }
        middle = 2 * smaller <= positive && v[i] > middle ? v[i] : middle;
    }
    return middle > R(0) && isfinite(middle) ? middle : R(1);
}

/* Returns the smallest positive distance between the bounds of variable i and of the rows that contain it; 1 if there
 * is none. */
static real_t qp_length(const qp_t *q, int i)
{
    const real_t width = q->upper[i] - q->lower[i];
    real_t least = width > R(0) ? width : INF;
    for (int j = 0; j < NG; ++j) {
        const real_t a = FABS(q->A[j][i]), room = q->upper[NV + j] - q->lower[NV + j];
        if (room > R(0) && room < least * a) {
            least = room / a;
        }
    }
    return least < INF ? least : R(1);
}

/* H += diag(proximal). The weights are a fraction of the diagonal of H or, where that is (nearly) zero, of the cost
 * divided by the square of a length. The cost is the median over the variables, because some bounds are too wide to be
 * relevant. Returns 0 if a diagonal entry is negative, or zero in a row that is not zero. */
static int qp_add_proximal_term(qp_t *q, const real_t *reference)
{
    real_t length[NV - NSL], cost[NV - NSL];
    int valid = 1;
    for (int i = 0; i < NV - NSL; ++i) {
        length[i] = qp_length(q, i);
        cost[i] = reference[i] * length[i] * length[i];
    }
    const real_t middle = qp_median(cost);
    for (int i = 0; i < NV - NSL; ++i) {
        const real_t other = middle / (length[i] * length[i]);
        const int known = reference[i] > TOL_QP_PIVOT * other;
        q->proximal[i] = known ? qp_proximal_share() * reference[i] : R(1.0 / 64) * other;
        q->H[i][i] += q->proximal[i];
        valid &= reference[i] >= R(0);
        cost[i] = known ? -R(1) : qp_zero_pivot() * other; /* now a limit for the entries beside the diagonal */
        for (int j = 0; j < i; ++j) {
            const real_t square = q->H[i][j] * q->H[i][j];
            valid &= cost[i] < R(0) || square <= cost[i] * reference[j];
            valid &= cost[j] < R(0) || square <= cost[j] * reference[i];
        }
    }
    return valid;
}

/* Sets pivot k of L D L' and returns its inverse. A pivot that is zero, negative or not finite becomes NaN, as do all
 * later ones. */
static inline real_t qp_pivot(qp_t *q, int k, real_t pivot, const real_t *reference)
{
    q->H[k][k] = pivot > qp_zero_pivot() * reference[k] && isfinite(pivot) ? pivot : (real_t)NAN;
    q->inverse[k] = R(1) / q->H[k][k];
    return q->inverse[k];
}

/* Factorises the diagonal panel b as L D L', with X = L D; L is stored below and above the diagonal. */
static void qp_factorize_diagonal(qp_t *q, int b, const real_t *reference)
{
    real_t *h0 = q->H[b] + b, *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b, *h3 = q->H[b + 3] + b;
    const real_t x10 = h1[0], x20 = h2[0], x30 = h3[0], e0 = qp_pivot(q, b, h0[0], reference);
    const real_t l10 = x10 * e0, l20 = x20 * e0, l30 = x30 * e0;
    const real_t x21 = h2[1] - l20 * x10, x31 = h3[1] - l30 * x10;
    const real_t e1 = qp_pivot(q, b + 1, h1[1] - l10 * x10, reference), l21 = x21 * e1, l31 = x31 * e1;
    const real_t x32 = h3[2] - l30 * x20 - l31 * x21;
    const real_t l32 = x32 * qp_pivot(q, b + 2, h2[2] - l20 * x20 - l21 * x21, reference);
    qp_pivot(q, b + 3, h3[3] - l30 * x30 - l31 * x31 - l32 * x32, reference);
    h1[0] = l10;
    h0[1] = l10;
    h2[0] = l20;
    h0[2] = l20;
    h3[0] = l30;
    h0[3] = l30;
    h2[1] = l21;
    h1[2] = l21;
    h3[1] = l31;
    h1[3] = l31;
    h3[2] = l32;
    h2[3] = l32;
}

/* Computes the columns of panel b of X = L D and of L, then the trailing lower triangle: H_ij -= sum_k X_ik L_jk. */
static void qp_factorize_panel(qp_t *q, int b)
{
    const qp_t *known = q;
    for (int i = b + 4; i < LDH; ++i) {
        real_t *h = q->H[i] + b, x[4];
        solve_block(known->H + b, b, h, x);
        (void)memcpy(h, x, sizeof x);
        q->H[b][i] = x[0] * q->inverse[b];
        q->H[b + 1][i] = x[1] * q->inverse[b + 1];
        q->H[b + 2][i] = x[2] * q->inverse[b + 2];
        q->H[b + 3][i] = x[3] * q->inverse[b + 3];
    }
    for (int i = b + 4; i < NV - NSL; ++i) {
        subtract_panel(q->H[i], known->H + b, q->H[i] + b, b + 4, i + 1);
        for (int l = b; l < b + 4; ++l) {
            q->H[i][l] *= q->inverse[l];
        }
    }
}

/* H = L D L' in place. Returns 0 if a pivot is not positive. */
static int qp_factorize_panels(qp_t *q, const real_t *reference)
{
    for (int b = 0; b < LDH; b += 4) {
        qp_factorize_diagonal(q, b, reference);
        qp_factorize_panel(q, b);
    }
    return isfinite(q->inverse[LDH - 1]);
}

/* Returns the curvature of variable i, a slack or padding. */
static real_t qp_curvature(const qp_t *q, int i)
{
    return i < NV ? q->curvature[i - (NV - NSL)] : R(1);
}

/* H + diag(proximal) = L D L' in place, inverse = D^{-1/2}. Rows after those of H complete the last panel. If a pivot
 * of H may be zero, H is restored from a copy, and the proximal term is added. */
static status_t qp_factorize_hessian(qp_t *q)
{
    real_t reference[LDH];
    int valid;
    for (int i = NV - NSL; i < LDH; ++i) {
        clear(q->H[i]);
        if (NSL) {
            q->H[i][i] = qp_curvature(q, i);
        } else {
            q->H[i][i] = R(1);
        }
    }
    (void)memcpy(q->work.basis.Q, q->H, sizeof q->H);
    for (int i = 0; i < LDH; ++i) {
        reference[i] = q->H[i][i];
    }
    valid = qp_factorize_panels(q, reference);
    q->semidefinite = !valid;
    if (!valid) {
        (void)memcpy(q->H, q->work.basis.Q, sizeof q->H);
        valid = qp_add_proximal_term(q, reference) && qp_factorize_panels(q, reference);
    }
    for (int i = 0; i < LDH; ++i) {
        q->inverse[i] = SQRT(q->inverse[i]);
    }
    for (int i = LDH; i < LDV; ++i) {
        q->inverse[i] = R(1) / SQRT(qp_curvature(q, i));
    }
    return valid ? OK : NUMERICAL_FAILURE;
}
