#include "hessians/eigen.c"

/* H := V diag(d) V', lower triangle of n rows, where V has the rows of `work`. */
static void compose(real_t (*H)[LDV], int n, const real_t *d, real_t (*work)[LDV])
{
    for (int i = 0; i < n; ++i) {
        (void)memset(H[i], 0, (size_t)(i + 1) * sizeof H[0][0]);
    }
    for (int k = 0; k < n; ++k) {
        const real_t *v = work[k];
        for (int i = 0; i < n; ++i) {
            const real_t b = d[k] * v[i];
            for (int j = 0; j <= i; ++j) {
                H[i][j] += b * v[j];
            }
        }
    }
}

/* Computes unit[j], the typical curvature of variable j, from the diagonal of H and from entries beside it that exceed
 * it. */
static void condensed_units(real_t (*H)[LDV], int n, real_t terms, real_t *unit)
{
    const real_t least = FACTOR_HESSIAN_FLOOR * terms;
    for (int i = 0; i < n; i++) {
        unit[i] = (FABS(H[i][i]) > least) ? FABS(H[i][i]) : least;
        unit[i] = (unit[i] > R(0)) ? unit[i] : R(1);
    }
    extend_units(H[0], LDV, n, unit);
}

/* Replaces H (lower triangle of n rows) by r V f(Lambda) V' r, where r^-1 H r^-1 = V Lambda V' in units r_i^2 of the
 * curvature; f = max(Lambda, floor) or, if MIRROR, |Lambda|. Where Lambda is negative, a share of the most negative one
 * is added, so that small ones do not lead to large steps. The floor is relative to the largest |Lambda|, at least 1.
 * Returns 0, with H unchanged, if H is zero or not finite. `work` has the size of H. */
static int regularize_reduced(real_t (*H)[LDV], int n, real_t terms, real_t share, real_t (*work)[LDV])
{
    real_t d[LDV], e[LDV], r[LDV], probe = R(0), least = R(0), smallest = R(1);
    condensed_units(H, n, terms, r);
    for (int i = 0; i < n; ++i) {
        r[i] = SQRT(r[i]);
        for (int j = 0; j <= i; ++j) {
            work[j][i] = H[i][j] / (r[i] * r[j]);
            work[i][j] = work[j][i];
            probe += FABS(work[i][j]);
        }
    }
    if (!(probe > R(0)) || !isfinite(probe)) {
        return 0;
    }
    decompose(work, d, e, n);
    for (int k = 0; k < n; ++k) {
        smallest = (FABS(d[k]) > smallest) ? FABS(d[k]) : smallest;
        least = (d[k] < least) ? d[k] : least;
    }
    smallest *= FACTOR_HESSIAN_FLOOR;
    for (int k = 0; k < n; ++k) {
        const real_t a = (MIRROR && d[k] < R(0)) ? -d[k] - share * least : d[k];
        d[k] = (a < smallest) ? smallest : a;
    }
    compose(H, n, d, work);
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            H[i][j] *= r[i] * r[j];
        }
    }
    return 1;
}

/* Returns the magnitude of the terms that the condensed Hessian sums: largest |R_jj| + sum_i B_ij^2 |Q_ii of the next
 * node|. */
static real_t condensed_terms(const solver_t *s)
{
    real_t largest = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = NX; j < NZ; j++) {
            real_t sum = FABS(HESSIAN(s, k)[j][j]);
            for (int i = 0; i < NX; i++) {
                const real_t b = s->node[k].S[i][j];
                const real_t next = (k + 1 < N) ? HESSIAN(s, k + 1)[i][i] : s->hessian.Q_N[i][i];
                sum += b * b * FABS(next);
            }
            largest = (sum > largest) ? sum : largest;
        }
    }
    return largest;
}

/* Adds weight a a' for row m, where the weight gives its direction the curvature `hold` in the units; stores the weight
 * in condensed.held. */
static void hold_row(solver_t *s, int m, int n, const real_t *unit, real_t hold)
{
    const real_t *a = s->qp.A[m];
    real_t sum = R(0);
    for (int j = 0; j < n; j++) {
        sum += a[j] * a[j] / unit[j];
    }
    const real_t weight = (sum > R(0)) ? hold / sum : R(0);
    s->condensed.held[m] = weight;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            s->qp.H[i][j] += weight * a[i] * a[j];
        }
    }
}

/* Returns 1 if row m is held: an equation, or a hard row of the predicted working set. */
static int is_held(const solver_t *s, int m)
{
    if (row_is_soft(s, m)) {
        return 0;
    }
    return s->qp.side[NV + m] != 0 || row_lower(s, m) >= row_upper(s, m);
}

/* Adds terms for the predicted working set to the Hessian. They make it convex if the Hessian on the null space of that
 * set is (Finsler's lemma), and do not change the step near a solution. */
static void hold_working_set(solver_t *s, real_t terms, real_t hold)
{
    const int n = NV - NSL;
    real_t unit[LDV];
    condensed_units(s->qp.H, n, terms, unit);
    for (int c = 0; c < n; c++) {
        s->qp.H[c][c] += (s->qp.side[c] != 0) ? hold * unit[c] : R(0);
    }
    for (int m = 0; m < NG; m++) {
        if (is_held(s, m)) {
            hold_row(s, m, n, unit, hold);
        }
    }
}

#include "hessians/linear_curvature.c"

/* Adds to the diagonal a small curvature for variables with a linear cost. */
static void add_linear_units(solver_t *s)
{
    for (int c = 0; c < NVU; c++) {
        s->qp.H[c][c] +=
            FACTOR_REDUCED_LINEAR_SHARE * linear_curvature(s->condensed.g[c], s->qp.lower[c], s->qp.upper[c]);
    }
}

/* Factorises the condensed Hessian. If it is not positive definite, it is formed again and the predicted working set is
 * held, at first weakly. If that is not sufficient, it is regularised. */
static status_t condense_factorize(solver_t *s)
{
    int32_t predicted[NV + NG]; /* a failure clears the working set */
    (void)memcpy(predicted, s->qp.side, sizeof predicted);
    status_t status = qp_factorize(&s->qp);
    s->condensed.regularized = status == NUMERICAL_FAILURE;
    (void)memset(s->condensed.held, 0, sizeof s->condensed.held);
    if (status == OK && s->qp.semidefinite) {
        condense_matrices(s);
        (void)memcpy(s->qp.side, predicted, sizeof predicted);
        add_linear_units(s);
        s->condensed.regularized = 1;
        return qp_factorize(&s->qp);
    }
    if (!s->condensed.regularized) {
        return status;
    }
    const real_t terms = condensed_terms(s);
    for (int trial = 0; trial < 3 && status == NUMERICAL_FAILURE; trial++) {
        condense_matrices(s);
        (void)memcpy(s->qp.side, predicted, sizeof predicted);
        hold_working_set(s, terms, (trial == 0) ? R(1) : FACTOR_SHIFT_FIRM_HOLD);
        if (trial == 2 &&
            !regularize_reduced(s->qp.H, NV - NSL, terms, FACTOR_REDUCED_MIRRORED_SHARE, s->qp.work.basis.Q)) {
            return status;
        }
        status = qp_factorize(&s->qp);
    }
    return status;
}

/* Returns the multiplier of row m. If the row is at its bound, the part is subtracted that its term in the Hessian
 * adds. */
static real_t released_multiplier(const solver_t *s, int m)
{
    const real_t before = s->qp.mult[NV + m];
    const int equation = row_lower(s, m) >= row_upper(s, m);
    if (!(s->condensed.held[m] > R(0)) || !(before < R(0) || before > R(0) || equation)) {
        return before;
    }
    real_t change = R(0);
    for (int j = 0; j < NV - NSL; j++) {
        change += s->qp.A[m][j] * s->qp.z[j];
    }
    const real_t after = before + s->condensed.held[m] * change;
    return (!equation && before * after < R(0)) ? R(0) : after;
}
