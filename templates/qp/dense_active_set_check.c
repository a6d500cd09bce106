/* Contract of this part: the optimality conditions of an answer, recomputed from the data, and iterative refinement. */

/* y += c a and size += m |a|, n entries. */
static inline void add_multiple(real_t *y, real_t *size, const real_t *a, real_t c, real_t m, int n)
{
    const int fours = n / 4 * 4;
    for (int j = 0; j < fours; j += 4) {
#if SCALAR && !SMALL
        const real_t a0 = a[j], a1 = a[j + 1], a2 = a[j + 2], a3 = a[j + 3];
        y[j] += c * a0;
        y[j + 1] += c * a1;
        y[j + 2] += c * a2;
        y[j + 3] += c * a3;
        size[j] += m * FABS(a0);
        size[j + 1] += m * FABS(a1);
        size[j + 2] += m * FABS(a2);
        size[j + 3] += m * FABS(a3);
#else
        for (int l = 0; l < 4; ++l) {
            y[j + l] += c * a[j + l];
            size[j + l] += m * FABS(a[j + l]);
        }
#endif
    }
    for (int j = fours; j < n; ++j) {
        y[j] += c * a[j];
        size[j] += m * FABS(a[j]);
    }
}

/* y_j += sum_i c_i A_ij and size_j += sum_i m_i |A_ij|: four rows, columns from .. to - 1. */
static inline void add_panel(
    real_t *y, real_t *size, const real_t (*A)[LDV], const real_t *c, const real_t *m, int from, int to)
{
    const real_t c0 = c[0], c1 = c[1], c2 = c[2], c3 = c[3];
    const real_t m0 = m[0], m1 = m[1], m2 = m[2], m3 = m[3];
    for (int j = from; j < to; j += 4) {
        for (int l = 0; l < 4; ++l) {
            y[j + l] += (c0 * A[0][j + l] + c1 * A[1][j + l]) + (c2 * A[2][j + l] + c3 * A[3][j + l]);
            size[j + l] +=
                (m0 * FABS(A[0][j + l]) + m1 * FABS(A[1][j + l])) + (m2 * FABS(A[2][j + l]) + m3 * FABS(A[3][j + l]));
        }
    }
}

/* y = L c, four entries; l: the entries of L below its diagonal, which is one. */
static inline void multiply_lower(const real_t *l, const real_t *c, real_t *y)
{
    y[0] = c[0];
    y[1] = c[1] + l[0] * c[0];
    y[2] = c[2] + l[1] * c[0] + l[2] * c[1];
    y[3] = c[3] + l[3] * c[0] + l[4] * c[1] + l[5] * c[2];
}

/* y = L'c, four entries. */
static inline void multiply_upper(const real_t *l, const real_t *c, real_t *y)
{
    y[0] = c[0] + l[0] * c[1] + l[1] * c[2] + l[3] * c[3];
    y[1] = c[1] + l[2] * c[2] + l[4] * c[3];
    y[2] = c[2] + l[5] * c[3];
    y[3] = c[3];
}

/* Entries of L below the diagonal in block b, and their magnitudes. */
static inline void qp_take_block(const qp_t *q, int b, real_t *l, real_t *magnitude)
{
    const real_t *h1 = q->H[b + 1] + b, *h2 = q->H[b + 2] + b, *h3 = q->H[b + 3] + b;
    l[0] = h1[0];
    l[1] = h2[0];
    l[2] = h2[1];
    l[3] = h3[0];
    l[4] = h3[1];
    l[5] = h3[2];
    for (int i = 0; i < 6; ++i) {
        magnitude[i] = FABS(l[i]);
    }
}

/* r = L'x and size = |L'| |x|. */
static void qp_multiply_upper(const qp_t *q, real_t *r, real_t *size)
{
    real_t m[LDV], l[6], magnitude[6];
    for (int b = 0; b < LDH; b += 4) {
        for (int i = b; i < b + 4; ++i) {
            m[i] = FABS(q->x[i]);
        }
        qp_take_block(q, b, l, magnitude);
        multiply_upper(l, q->x + b, r + b);
        multiply_upper(magnitude, m + b, size + b);
    }
    for (int b = 4; b < LDH; b += 4) {
        add_panel(r, size, q->H + b, q->x + b, m + b, 0, b);
    }
}

/* r := L D r and size := |L| D size. */
static void qp_multiply_lower(const qp_t *q, real_t *r, real_t *size)
{
    real_t c[4], m[4], l[6], magnitude[6];
    for (int b = LDH - 4; b >= 0; b -= 4) {
        for (int i = 0; i < 4; ++i) {
            c[i] = q->H[b + i][b + i] * r[b + i];
            m[i] = q->H[b + i][b + i] * size[b + i];
        }
        qp_take_block(q, b, l, magnitude);
        multiply_lower(l, c, r + b);
        multiply_lower(magnitude, m, size + b);
        add_panel(r, size, q->H + b, c, m, b + 4, LDH);
    }
}

/* r = H x, where H = L D L' - E, and size = |L| D |L'| |x| + a small multiple of sqrt(D) (|y0| + |y|), for y may be a
 * small difference. */
static void qp_multiply_hessian(const qp_t *q, real_t *r, real_t *size)
{
    const real_t unit = R(1.0 / 256) * (q->scale + norm(q->work.basis.y));
    qp_multiply_upper(q, r, size);
    qp_multiply_lower(q, r, size);
    for (int k = 0; k < NV - NSL; ++k) {
        r[k] -= q->semidefinite ? q->proximal[k] * q->x[k] : R(0);
        size[k] += unit * q->H[k][k] * q->inverse[k];
    }
#if NSL
    for (int i = NV - NSL; i < LDV; ++i) {
        r[i] = qp_curvature(q, i) * q->x[i];
        size[i] = unit / q->inverse[i] + FABS(r[i]);
    }
#endif
}

/* r = H x + g + mult[0..NV) + A'mult[NV..NV+NG), and size, the sum of the magnitudes of the terms. */
static void qp_stationarity(const qp_t *q, real_t *r, real_t *size)
{
    qp_multiply_hessian(q, r, size);
    add_multiple(r, size, q->g, R(1), R(1), NV);
    add_multiple(r, size, q->mult, R(1), R(1), NV);
#if NG
    for (int c = NV; c < NV + NG; ++c) {
        if (q->side[c] != INACTIVE) {
            add_multiple(r, size, q->A[c - NV], q->mult[c], FABS(q->mult[c]), NV - NSL);
#if NSL
            const int slack = qp_moving_slack(q, c);
            if (slack >= 0) {
                r[slack] -= q->mult[c];
                size[slack] += FABS(q->mult[c]);
            }
#endif
        }
    }
#endif
}

/* Violation of row c by x, in both directions if the row is a member; of a saturated row the distance from its bound
 * towards the inside. Positive above the bound. */
static real_t qp_excess(const qp_t *q, int c)
{
    real_t over, under;
    const real_t value = qp_violations(q, c, q->x, &over, &under);
    if (qp_is_member(q, c)) {
        return value - qp_bound(q, c);
    }
    return over > R(0) ? over : under > R(0) ? -under : R(0);
}

/* Returns 1 if x and mult satisfy the optimality conditions up to rounding: of the terms of a row or, if all of them
 * nearly vanish, of the cancellation in y = y0 - Q'R lam. r: gradient of the Lagrangian. */
static int qp_is_optimal(const qp_t *q, real_t *r)
{
    real_t size[LDV];
    int optimal = 1;
    qp_stationarity(q, r, size);
    for (int i = 0; i < NV; ++i) {
        optimal &= FABS(r[i]) <= TOL_QP_RESIDUAL * size[i];
    }
    for (int c = 0; c < NV + NG && optimal; ++c) {
        const real_t excess = FABS(qp_excess(q, c));
        optimal = excess <= R(0) || excess <= TOL_QP_RESIDUAL * qp_row_size(q, c) ||
            excess <= TOL_QP_RESIDUAL * TOL_UNIT * q->scale * qp_row_norm(q, c);
    }
    return optimal;
}

/* One step of iterative refinement on the working set: x and lam take the corrections for the gradient r and for the
 * residuals of the members. */
static void qp_refine(qp_t *q, real_t *r)
{
    real_t c[LDV] = {0}, w[LDV];
    for (int k = 0; k < q->nw; ++k) {
        w[k] = qp_excess(q, q->row[k]);
    }
    qp_forward(q, r, 0);
    qp_solve_transposed(q, w);
    qp_move_to_bounds(q, w, c, r);
    qp_solve_triangle(q, c);
    qp_backward(q, r, r);
    for (int i = 0; i < LDV; ++i) {
        q->x[i] -= r[i];
    }
    for (int k = 0; k < q->nw; ++k) {
        q->lam[k] -= c[k];
    }
}

/* Writes the result; what fails its conditions is refined up to twice. Returns 0 if they still do not hold. */
static int qp_accept(qp_t *q)
{
    real_t r[LDV];
    for (int step = 0; qp_write_result(q); ++step) { /* at most 3 passes */
        if (qp_is_optimal(q, r)) {
            return 1;
        }
        if (step == 2) {
            return 0;
        }
        qp_refine(q, r);
    }
    return 0;
}
