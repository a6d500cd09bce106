/* Contract of this part: the factorised working set, rows that enter and leave it, the minimiser on it. */

/* w := R^{-T} w */
static void qp_forward_working_set(const qp_t *q, real_t *w)
{
    for (int b = 0; b < q->nw; b += 4) {
        const real_t *r0 = q->work.basis.R[b], *r1 = q->work.basis.R[b + 1], *r2 = q->work.basis.R[b + 2], *r3 = q->work.basis.R[b + 3];
        const real_t w0 = (w[b] - qp_dot(r0, w, b)) * q->R_inverse[b];
        const real_t w1 = (w[b + 1] - qp_dot(r1, w, b) - r1[b] * w0) * q->R_inverse[b + 1];
        const real_t w2 = (w[b + 2] - qp_dot(r2, w, b) - r2[b] * w0 - r2[b + 1] * w1) * q->R_inverse[b + 2];
        const real_t w3 = (w[b + 3] - qp_dot(r3, w, b) - r3[b] * w0 - r3[b + 1] * w1 - r3[b + 2] * w2) *
                              q->R_inverse[b + 3];
        w[b] = w0;
        w[b + 1] = w1;
        w[b + 2] = w2;
        w[b + 3] = w3;
    }
}

/* x = R^{-1} c */
static void qp_backward_working_set(const qp_t *q, const real_t *c, real_t *x)
{
    for (int k = 0; k < (q->nw + 3) / 4 * 4; ++k) {
        x[k] = c[k];
    }
    for (int b = (q->nw + 3) / 4 * 4 - 4; b >= 0; b -= 4) {
        const real_t *r1 = q->work.basis.R[b + 1] + b, *r2 = q->work.basis.R[b + 2] + b, *r3 = q->work.basis.R[b + 3] + b;
        const real_t x3 = x[b + 3] * q->R_inverse[b + 3];
        const real_t x2 = (x[b + 2] - r3[2] * x3) * q->R_inverse[b + 2];
        const real_t x1 = (x[b + 1] - r3[1] * x3 - r2[1] * x2) * q->R_inverse[b + 1];
        const real_t x0 = (x[b] - r3[0] * x3 - r2[0] * x2 - r1[0] * x1) * q->R_inverse[b];
        x[b] = x0;
        x[b + 1] = x1;
        x[b + 2] = x2;
        x[b + 3] = x3;
        qp_add_panel(x, q->work.basis.R[b], -x0, -x1, -x2, -x3, 0, b);
    }
}

/* d = Q v */
static void qp_coefficients(const qp_t *q, const real_t *v, real_t *d)
{
    for (int b = 0; b < q->nw; b += 4) {
        const real_t d0 = qp_dot(q->work.basis.Q[b], v, LDV), d1 = qp_dot(q->work.basis.Q[b + 1], v, LDV);
        const real_t d2 = qp_dot(q->work.basis.Q[b + 2], v, LDV), d3 = qp_dot(q->work.basis.Q[b + 3], v, LDV);
        d[b] = d0;
        d[b + 1] = d1;
        d[b + 2] = d2;
        d[b + 3] = d3;
    }
}

/* v := v - Q'd */
static void qp_subtract_span(const qp_t *q, const real_t *d, real_t *v)
{
    for (int b = 0; b < q->nw; b += 4) {
        qp_add_panel(v, q->work.basis.Q[b], -d[b], -d[b + 1], -d[b + 2], -d[b + 3], 0, LDV);
    }
}

/* The normal of row c in y: m = D^{-1/2} L^{-1} a_c. Returns m'm. */
static real_t qp_normal(qp_t *q, int c)
{
    if (c < NV) {
        for (int j = 0; j < LDV; ++j) {
            q->m[j] = R(0.0);
        }
        q->m[c] = R(1.0);
        qp_forward(q, q->m, c);
    } else {
        for (int j = 0; j < LDV; ++j) {
            q->m[j] = q->A[c - NV][j];
        }
        qp_forward(q, q->m, 0);
    }
    return qp_dot(q->m, q->m, LDV);
}

/* m = Q'd + v with Q v = 0; a second pass where cancellation has cost orthogonality. Returns v'v. */
static real_t qp_project(qp_t *q, real_t mm)
{
    real_t e[LDV], vv = mm;
    for (int j = 0; j < LDV; ++j) {
        q->v[j] = q->m[j];
    }
    if (q->nw > 0) {
        qp_coefficients(q, q->v, q->d);
        qp_subtract_span(q, q->d, q->v);
        vv = qp_dot(q->v, q->v, LDV);
        if (vv < R(0.5) * mm) {
            qp_coefficients(q, q->v, e);
            qp_subtract_span(q, e, q->v);
            for (int k = 0; k < q->nw; ++k) {
                q->d[k] += e[k];
            }
            vv = qp_dot(q->v, q->v, LDV);
        }
    }
    return vv;
}

/* Row c enters the working set on the given side with multiplier lam; m = Q'd + v is its projection. */
static void qp_append(qp_t *q, int c, int side, real_t vv, real_t lam)
{
    const int k = q->nw;
    const real_t norm = SQRT(vv), scale = R(1.0) / norm;
    if (k % 4 == 0) {
        for (int i = k; i < k + 4; ++i) {
            q->R_inverse[i] = R(0.0);
            for (int j = 0; j < LDV; ++j) {
                q->work.basis.Q[i][j] = R(0.0);
                q->work.basis.R[i][j] = R(0.0);
            }
        }
    }
    for (int j = 0; j < LDV; j += 4) {
        real_t u[4];
        for (int l = 0; l < 4; ++l) {
            u[l] = q->v[j + l] * scale;
        }
        for (int l = 0; l < 4; ++l) {
            q->work.basis.Q[k][j + l] = u[l];
        }
    }
    for (int j = 0; j < k; ++j) {
        q->work.basis.R[k][j] = q->d[j];
    }
    q->work.basis.R[k][k] = norm;
    q->R_inverse[k] = scale;
    q->lam[k] = lam;
    q->row[k] = c;
    q->side[c] = side;
    q->nw = k + 1;
}

/* Givens rotation of the rows k, k+1 of R (columns of its transpose) and of Q that restores R_{k+1,k} = 0. */
static void qp_rotate(qp_t *q, int k)
{
    const real_t a = q->work.basis.R[k][k], b = q->work.basis.R[k][k + 1];
    const real_t norm = SQRT(a * a + b * b), scale = R(1.0) / norm, c = a * scale, s = b * scale;
    q->work.basis.R[k][k] = norm;
    q->work.basis.R[k][k + 1] = R(0.0);
    q->R_inverse[k] = scale;
    for (int i = k + 1; i < q->nw; ++i) {
        const real_t u = q->work.basis.R[i][k], v = q->work.basis.R[i][k + 1];
        q->work.basis.R[i][k] = c * u + s * v;
        q->work.basis.R[i][k + 1] = c * v - s * u;
    }
    for (int j = 0; j < LDV; j += 4) {
        real_t u[4], v[4];
        for (int l = 0; l < 4; ++l) {
            u[l] = c * q->work.basis.Q[k][j + l] + s * q->work.basis.Q[k + 1][j + l];
            v[l] = c * q->work.basis.Q[k + 1][j + l] - s * q->work.basis.Q[k][j + l];
        }
        for (int l = 0; l < 4; ++l) {
            q->work.basis.Q[k][j + l] = u[l];
            q->work.basis.Q[k + 1][j + l] = v[l];
        }
    }
}

/* Member k leaves the working set. */
static void qp_remove(qp_t *q, int k)
{
    const int last = q->nw - 1;
    q->side[q->row[k]] = 0;
    for (int i = k; i < last; ++i) {
        q->row[i] = q->row[i + 1];
        q->lam[i] = q->lam[i + 1];
        for (int j = 0; j <= i + 1; ++j) {
            q->work.basis.R[i][j] = q->work.basis.R[i + 1][j];
        }
    }
    q->nw = last;
    for (int i = k; i < last; ++i) {
        qp_rotate(q, i);
    }
    q->R_inverse[last] = R(0.0);
    for (int j = 0; j < LDV; ++j) {
        q->work.basis.Q[last][j] = R(0.0);
        q->work.basis.R[last][j] = R(0.0);
    }
    ++q->changes;
}

/* Active bound of member k. */
static real_t qp_active_bound(const qp_t *q, int k)
{
    const int c = q->row[k];
    return q->side[c] > 0 ? q->upper[c] : q->lower[c];
}

/* The largest multiplier that row c may have. */
static inline real_t qp_limit(const qp_t *q, int c)
{
    return q->penalty[c];
}

static inline int qp_saturated(const qp_t *q, int c)
{
    return q->side[c] > 1 || q->side[c] < -1;
}

/* Multiplier of row c, not a member. */
static inline real_t qp_outside_multiplier(const qp_t *q, int c)
{
    return !qp_saturated(q, c) ? R(0.0) : q->side[c] > 0 ? qp_limit(q, c) : -qp_limit(q, c);
}

/* Member k leaves the working set with its multiplier at the limit of the given side: y0 -= mult m, m = Q'R. */
static void qp_saturate(qp_t *q, int k, int side)
{
    const int c = q->row[k];
    const real_t limit = qp_limit(q, c), mult = side > 0 ? limit : -limit;
    for (int i = 0; i <= k; ++i) {
        for (int j = 0; j < LDV; ++j) {
            q->y0[j] -= mult * q->work.basis.R[k][i] * q->work.basis.Q[i][j];
        }
    }
    q->shift += limit * SQRT(qp_dot(q->work.basis.R[k], q->work.basis.R[k], (k + 4) / 4 * 4));
    qp_remove(q, k);
    q->side[c] = 2 * side;
}

/* y0 = -D^{-1/2} L^{-1} (g - proximal center + sum_saturated mult_c a_c) and its size; shift: sum of |mult_c| |D^{-1/2} a_c|. */
static void qp_set_origin(qp_t *q)
{
    for (int i = 0; i < NV; ++i) {
        q->y0[i] = -q->g[i];
    }
    for (int i = NV; i < LDV; ++i) {
        q->y0[i] = R(0.0);
    }
    for (int i = 0; q->semidefinite && i < NV; ++i) {
        q->y0[i] += q->proximal[i] * q->center[i];
    }
    q->shift = R(0.0);
    for (int i = 0; q->elastic && i < NV; ++i) {
        if (qp_saturated(q, i)) {
            q->y0[i] -= qp_outside_multiplier(q, i);
            q->shift += q->penalty[i] * q->inverse[i];
        }
    }
    for (int j = 0; q->elastic && j < NG; ++j) {
        if (qp_saturated(q, NV + j)) {
            const real_t *a = q->A[j], mult = qp_outside_multiplier(q, NV + j);
            real_t squares = R(0.0);
            for (int i = 0; i < NV; ++i) {
                q->y0[i] -= mult * a[i];
                squares += (a[i] * q->inverse[i]) * (a[i] * q->inverse[i]);
            }
            q->shift += q->penalty[NV + j] * SQRT(squares);
        }
    }
    qp_forward(q, q->y0, 0);
    q->scale = SQRT(qp_dot(q->y0, q->y0, LDV));
}

/* 1 if y is the small difference of large terms. */
static int qp_cancelled(const qp_t *q)
{
    const real_t size = R(0.125) * (q->scale + q->shift);
    return qp_dot(q->y, q->y, LDV) < size * size;
}

/* y and lam of the working set; t the active bounds: R'w = t, c = Q y0 - w, y = y0 - Q'c, lam = R^{-1} c. After cancellation
 * a second pass, with y in place of y0, makes Q y = w again. */
static void qp_minimize_on_working_set(qp_t *q)
{
    real_t w[LDV], c[LDV];
    for (int k = 0; k < q->nw; ++k) {
        w[k] = qp_active_bound(q, k);
    }
    for (int k = q->nw; k % 4 != 0; ++k) {
        w[k] = R(0.0);
    }
    qp_forward_working_set(q, w);
    qp_coefficients(q, q->y0, c);
    for (int k = 0; k < q->nw; ++k) {
        c[k] -= w[k];
    }
    for (int j = 0; j < LDV; ++j) {
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
