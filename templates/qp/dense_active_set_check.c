/* This part computes the optimality conditions of an answer from the original data, and refines the answer. */

/* y += c a and size += m |a|, n entries. */
static inline void add_multiple(real_t *y, real_t *size, const real_t *a, real_t c, real_t m, int n)
{
    const int end = n / 4 * 4;
    for (int j = 0; j < end; j += 4) {
        if (SCALAR && !SMALL) {
            const real_t a0 = a[j], a1 = a[j + 1], a2 = a[j + 2], a3 = a[j + 3];
            y[j] += c * a0;
            y[j + 1] += c * a1;
            y[j + 2] += c * a2;
            y[j + 3] += c * a3;
            size[j] += m * FABS(a0);
            size[j + 1] += m * FABS(a1);
            size[j + 2] += m * FABS(a2);
            size[j + 3] += m * FABS(a3);
        } else {
            for (int l = 0; l < 4; ++l) {
                y[j + l] += c * a[j + l];
                size[j + l] += m * FABS(a[j + l]);
            }
        }
    }
    for (int j = end; j < n; ++j) {
        y[j] += c * a[j];
        size[j] += m * FABS(a[j]);
    }
}

/* r = H x, where H = L D L' - E, and size = |L| D |L'| |x| + a small multiple of sqrt(D) (|y0| + |y|), as y may be a
 * small difference. */
static void qp_multiply_hessian(const qp_t *q, real_t *r, real_t *size)
{
    const int n = NV - NSL;
    const real_t unit = R(1.0 / 256) * (q->scale + norm(q->work.basis.y));
    copy(r, q->x);
    for (int i = 0; i < LDV; ++i) {
        size[i] = FABS(r[i]);
    }
    for (int i = 0; i < n; ++i) {
        add_multiple(r, size, q->H[i], q->x[i], FABS(q->x[i]), i);
    }
    for (int k = n - 1; k >= 0; --k) {
        const real_t *column = q->H[k];
        r[k] *= column[k];
        size[k] *= column[k];
        add_multiple(r + k + 1, size + k + 1, column + k + 1, r[k], size[k], n - k - 1);
    }
    for (int k = 0; k < n; ++k) {
        r[k] -= q->semidefinite ? q->proximal[k] * q->x[k] : R(0);
        size[k] += unit * q->H[k][k] * q->inverse[k];
    }
    for (int i = n; i < NV; ++i) {
        r[i] = qp_curvature(q, i) * q->x[i];
        size[i] = unit / q->inverse[i] + FABS(r[i]);
    }
}

/* r = H x + g + mult[0..NV) + A'mult[NV..NV+NG), and size, the sum of the magnitudes of the terms. */
static void qp_stationarity(const qp_t *q, real_t *r, real_t *size)
{
    qp_multiply_hessian(q, r, size);
    add_multiple(r, size, q->g, R(1), R(1), NV);
    add_multiple(r, size, q->mult, R(1), R(1), NV);
    for (int c = NV; c < NV + NG; ++c) {
        if (q->side[c] != INACTIVE) {
            add_multiple(r, size, q->A[c - NV], q->mult[c], FABS(q->mult[c]), NV - NSL);
            if (NSL) {
                const int slack = qp_moving_slack(q, c);
                if (slack >= 0) {
                    r[slack] -= q->mult[c];
                    size[slack] += FABS(q->mult[c]);
                }
            }
        }
    }
}

/* Returns the violation of row c by x, in both directions if the row is a member; for a saturated row the distance from
 * its bound towards the inside. Positive above the bound. */
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

/* Takes one step of iterative refinement on the working set: x and lam are corrected for the gradient r and for the
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

/* Writes the result; a result that violates its conditions is refined up to twice. Returns 0 if they still do not
 * hold. */
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
