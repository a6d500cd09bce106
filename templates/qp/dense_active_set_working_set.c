/* This part factorises the working set, updates the factors when rows enter and leave, and computes the minimiser on
 * the working set. */

/* Values of side[]. */
enum { AT_LOWER = -1, INACTIVE = 0, AT_UPPER = 1 };

static inline int qp_is_member(const qp_t *q, int c)
{
    return q->side[c] == AT_UPPER || q->side[c] == AT_LOWER;
}

static int qp_is_equality(const qp_t *q, int c)
{
    return q->lower[c] >= q->upper[c];
}

static inline int qp_is_slack(int c)
{
    return NV - NSL <= c && c < NV;
}

/* Returns the bound of row c on its side. */
static real_t qp_bound(const qp_t *q, int c)
{
    return q->side[c] > 0 ? q->upper[c] : q->lower[c];
}

#if NSL
#include "qp/dense_active_set_slack.c"
#endif

/* a_c'z */
static inline real_t qp_value(const qp_t *q, int c, const real_t *z)
{
    if (NG == 0 || c < NV) {
        return z[c];
    }
    if (NSL) {
        return dot(q->A[c - NV], z, LDH) - (qp_slack(c) < 0 ? R(0) : z[qp_slack(c)]);
    } else {
        return dot(q->A[c - NV], z, LDH);
    }
}

/* Returns the magnitude of the bound of row c on the given side and of the terms that it sums up. */
static inline real_t qp_bound_size(const qp_t *q, int c, int side)
{
    const real_t bound = FABS(side > 0 ? q->upper[c] : q->lower[c]);
    if (NG) {
        return c < NV ? bound : bound + q->terms[c - NV];
    } else {
        return bound;
    }
}

/* Returns |D^{-1/2} a_c|, an estimate of |m|, where D^{1/2} is the diagonal of C. */
static real_t qp_row_norm(const qp_t *q, int c)
{
    if (NG) {
        if (c >= NV) {
            real_t squares = R(0);
            for (int j = 0; j < NV - NSL; ++j) {
                const real_t a = q->A[c - NV][j] * q->inverse[j];
                squares += a * a;
            }
            if (NSL) {
                squares += qp_compliance(q, c);
            }
            return SQRT(squares);
        }
    }
    return q->inverse[c];
}

/* Returns a lower bound of the magnitude of the terms of a_c'x and of the bounds. */
static real_t qp_row_size(const qp_t *q, int c)
{
    if (NG) {
        if (c >= NV) {
            real_t sum = q->terms[c - NV];
            for (int j = 0; j < NV - NSL; ++j) {
                sum += FABS(q->A[c - NV][j] * q->x[j]);
            }
            if (NSL) {
                return sum + (qp_slack(c) < 0 ? R(0) : FABS(q->x[qp_slack(c)]));
            } else {
                return sum;
            }
        }
    }
    return FABS(q->x[c]) + q->inverse[c] * FABS(q->work.basis.y[c]);
}

/* Returns the number of members of the working set, rounded up to whole panels. */
static int qp_panel_count(const qp_t *q)
{
    return (q->nw + 3) / 4 * 4;
}

/* Returns the squared norm of the normal of member k. */
static real_t qp_square(const qp_t *q, int k)
{
    return dot(q->work.basis.R[k], q->work.basis.R[k], qp_panel_count(q));
}

/* d = Q v */
static void qp_coefficients(const qp_t *q, const real_t *v, real_t *d)
{
    const int n = qp_panel_count(q);
    for (int k = 0; k < n; ++k) {
        d[k] = dot(q->work.basis.Q[k], v, LDV);
    }
}

/* v := v - Q'd */
static void qp_subtract_span(const qp_t *q, const real_t *d, real_t *v)
{
    for (int b = 0; b < q->nw; b += 4) {
        subtract_panel(v, q->work.basis.Q + b, d + b, 0, LDV);
    }
}

/* r := R^{-1} r */
static void qp_solve_triangle(const qp_t *q, real_t *r)
{
    solve_upper(q->work.basis.R, q->R_inverse, r, q->nw);
}

/* Loads m = a_c of a general row. */
static void qp_take_row(const qp_t *q, int c, real_t *m)
{
    clear(m);
    (void)memcpy(m, q->A[c - NV], sizeof q->A[0]);
    if (qp_moving_slack(q, c) >= 0) {
        m[qp_slack(c)] = -R(1);
    }
}

/* Computes the normal of row c in the coordinates y, m = C^{-1} a_c. Returns m'm. */
static real_t qp_normal(qp_t *q, int c)
{
    /* 0 <= c <= NV + NG - 1 */
    real_t *m = q->work.basis.m;
    if (NG) {
        if (c >= NV) {
            if (NSL) {
                qp_take_row(q, c, m);
            } else {
                copy(m, q->A[c - NV]);
            }
            qp_forward(q, m, 0);
            return dot(m, m, LDV);
        }
    }
    clear(m);
    m[c] = R(1);
    qp_forward(q, m, c);
    return dot(m, m, LDV);
}

/* m = Q'd + v with Q v = 0; a second pass restores orthogonality after cancellation. Returns v'v. */
static real_t qp_project(qp_t *q, real_t mm)
{
    basis_t *w = &q->work.basis;
    real_t vv = mm;
    copy(w->v, w->m);
    if (q->nw == 0) {
        return vv;
    }
    qp_coefficients(q, w->v, w->d);
    qp_subtract_span(q, w->d, w->v);
    vv = dot(w->v, w->v, LDV);
    if (vv < R(0.5) * mm) {
        real_t e[LDV];
        clear(e);
        qp_coefficients(q, w->v, e);
        qp_subtract_span(q, e, w->v);
        for (int k = 0; k < q->nw; ++k) {
            w->d[k] += e[k];
        }
        vv = dot(w->v, w->v, LDV);
    }
    return vv;
}

/* Adds row c to the working set on the given side with multiplier lam; m = Q'd + v is its projection. */
static void qp_append(qp_t *q, int c, int side, real_t vv, real_t lam)
{
    basis_t *w = &q->work.basis;
    const int k = q->nw;
    const real_t length = SQRT(vv), scale = R(1) / length;
    for (int i = k; k % 4 == 0 && i < k + 4; ++i) {
        clear(w->Q[i]);
        clear(w->R[i]);
    }
    for (int j = 0; j < LDV; ++j) {
        w->Q[k][j] = w->v[j] * scale;
    }
    for (int j = 0; j < k; ++j) {
        w->R[k][j] = w->d[j];
    }
    w->R[k][k] = length;
    q->R_inverse[k] = scale;
    q->lam[k] = lam;
    q->row[k] = c;
    q->side[c] = side;
    q->nw = k + 1;
    ++q->changes;
}

/* (u, v) := (c u + s v, c v - s u). */
static inline void rotate(real_t c, real_t s, real_t *u, real_t *v)
{
    const real_t old = *u;
    *u = c * old + s * *v;
    *v = c * *v - s * old;
}

/* Rotates the rows k, k+1 of R (columns of its transpose) and of Q so that R_{k+1,k} = 0 again (Givens). */
static void qp_rotate(qp_t *q, int k)
{
    basis_t *w = &q->work.basis;
    const real_t a = w->R[k][k], b = w->R[k][k + 1], length = SQRT(a * a + b * b);
    const real_t scale = R(1) / length, c = a * scale, s = b * scale;
    w->R[k][k] = length;
    w->R[k][k + 1] = R(0);
    q->R_inverse[k] = scale;
    for (int i = k + 1; i < q->nw; ++i) {
        rotate(c, s, &w->R[i][k], &w->R[i][k + 1]);
    }
    for (int j = 0; j < LDV; ++j) {
        rotate(c, s, &w->Q[k][j], &w->Q[k + 1][j]);
    }
}

/* Removes member k from the working set. */
static void qp_remove(qp_t *q, int k)
{
    /* 0 <= k <= NV - 1 */
    basis_t *w = &q->work.basis;
    const int last = q->nw - 1;
    q->side[q->row[k]] = INACTIVE;
    for (int i = k; i < last; ++i) {
        q->row[i] = q->row[i + 1];
        q->lam[i] = q->lam[i + 1];
        copy(w->R[i], w->R[i + 1]);
    }
    q->nw = last;
    for (int i = k; i < last; ++i) {
        qp_rotate(q, i);
    }
    q->R_inverse[last] = R(0);
    clear(w->Q[last]);
    clear(w->R[last]);
    ++q->changes;
}

#if NSL
#include "qp/dense_active_set_yield.c"
#endif

#if ELASTIC
#include "qp/dense_active_set_elastic.c"
#endif

/* y0 = -C^{-1} (g - proximal center + sum_saturated mult_c a_c); scale = |y0| plus the magnitude of the saturated
 * terms. */
static void qp_set_origin(qp_t *q)
{
    clear(q->y0);
    for (int i = 0; i < NV; ++i) {
        q->y0[i] = q->semidefinite ? q->proximal[i] * q->center[i] - q->g[i] : -q->g[i];
    }
    q->scale = R(0);
    if (ELASTIC) {
        qp_add_saturated(q);
    }
    qp_forward(q, q->y0, 0);
    q->scale += norm(q->y0);
}

/* Returns 1 if y is a small difference of large terms. */
static int qp_has_cancellation(const qp_t *q)
{
    const real_t size = FACTOR_DENSE_CANCELLED * q->scale;
    return dot(q->work.basis.y, q->work.basis.y, LDV) < size * size;
}

/* c = Q v - w, then v := v - Q'c, which satisfies Q v = w. */
static void qp_move_to_bounds(const qp_t *q, const real_t *w, real_t *c, real_t *v)
{
    qp_coefficients(q, v, c);
    for (int k = 0; k < q->nw; ++k) {
        c[k] -= w[k];
    }
    qp_subtract_span(q, c, v);
}

/* w := R^{-T} w */
static void qp_solve_transposed(const qp_t *q, real_t *w)
{
    for (int k = 0; k < q->nw; ++k) {
        for (int j = 0; j < k; ++j) {
            w[k] -= q->work.basis.R[k][j] * w[j];
        }
        w[k] *= q->R_inverse[k];
    }
}

/* Computes y and lam on the working set, where t are the active bounds: R'w = t, c = Q y0 - w, y = y0 - Q'c, lam =
 * R^{-1} c. After cancellation a second pass, with y instead of y0, restores Q y = w. */
static void qp_minimize_on_working_set(qp_t *q)
{
    real_t w[LDV];
    for (int k = 0; k < q->nw; ++k) {
        w[k] = qp_bound(q, q->row[k]);
    }
    qp_solve_transposed(q, w);
    copy(q->work.basis.y, q->y0);
    qp_move_to_bounds(q, w, q->lam, q->work.basis.y);
    qp_solve_triangle(q, q->lam);
    if (qp_has_cancellation(q)) {
        real_t c[LDV];
        qp_move_to_bounds(q, w, c, q->work.basis.y);
    }
}
