#include "hessians/eigen.c"

/* Replaces H (lower triangle of n rows) by V f(Lambda) V', f = max(|Lambda|, floor) if MIRROR, else max(Lambda, floor);
 * the floor is relative to the largest |Lambda|. Returns 0, with H unchanged, if H is zero or not finite. `work` has
 * the size of H. */
static int regularize_reduced(real_t (*H)[LDV], int n, real_t (*work)[LDV])
{
    real_t d[LDV], e[LDV], scale = R(0), smallest = R(0);
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            const real_t a = FABS(H[i][j]);
            scale = (a > scale) ? a : scale;
        }
    }
    if (!(scale > R(0)) || !isfinite(scale)) {
        return 0;
    }
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            work[i][j] = work[j][i] = H[i][j] / scale;
            H[i][j] = R(0);
        }
    }
    decompose(work, d, e, n);
    for (int k = 0; k < n; ++k) {
        smallest = (FABS(d[k]) > smallest) ? FABS(d[k]) : smallest;
    }
    smallest *= regularization[0];
    for (int k = 0; k < n; ++k) {
        const real_t a = (MIRROR && d[k] < R(0)) ? -d[k] : d[k];
        const real_t value = scale * ((a < smallest) ? smallest : a);
        const real_t *v = work[k];
        for (int i = 0; i < n; ++i) {
            const real_t b = value * v[i];
            for (int j = 0; j <= i; ++j) {
                H[i][j] += b * v[j];
            }
        }
    }
    return 1;
}

/* If the condensed Hessian is not positive definite, it is formed again and regularised. */
static status_t condense_factorize(solver_t *s)
{
    const status_t status = qp_factorize(&s->qp);
    s->condensed.regularized = status == NUMERICAL_FAILURE;
    if (!s->condensed.regularized) {
        return status;
    }
    condense_matrices(s);
    return regularize_reduced(s->qp.H, NV - NSL, s->qp.work.basis.Q) ? qp_factorize(&s->qp) : status;
}
