/* riccati_convexify   makes the QP convex if it is not. Called before qp_factorize, when side[] is the predicted
 *                     working set. Returns 1 if the present factors are those without fixed controls and without rows.
 *
 * The reduced Hessian in what is free is positive definite if and only if the pivots of the recursion are positive. If
 * they are not, the predicted working set is held: held[m] a_m a_m' for equations and for the rows of that set, and
 * additions to the diagonal for its controls. A Hessian that is positive definite on the null space of these rows
 * becomes positive definite if they are held strongly enough (Finsler's lemma); near a solution their values do not
 * change, so that neither the step nor the rate of convergence does. If that is not sufficient, a multiple of the units
 * is added to the diagonal of what is free. The multipliers lam are not affected: lam contains what held rows add, and
 * the diagonal belongs to variables that have no multiplier lam. */

/* Computes the scale of component j of z: the maximum over the stages of |Q_jj| + sum_i S_ij^2 |Q_ii of the next
 * stage|. Returns 0 if it is not finite. */
static int riccati_units(solver_t *s, real_t *unit)
{
    real_t largest = R(0), probe = R(0);
    (void)memset(unit, 0, sizeof unit[0] * NZ);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NZ; j++) {
            real_t sum = FABS(stage_Q(s, k)[j][j]);
            for (int i = 0; i < NX; i++) {
                const real_t a = stage_S(s, k)[i][j];
                const real_t next = (k + 1 < N) ? stage_Q(s, k + 1)[i][i] : stage_Q_N(s)[i][i];
                sum += a * a * FABS(next);
            }
            unit[j] = (sum > unit[j]) ? sum : unit[j];
            largest = (sum > largest) ? sum : largest;
            probe += R(0) * sum;
        }
    }
    for (int j = 0; j < NZ; j++) {
        if (!(unit[j] > R(0))) {
            unit[j] = (largest > R(0)) ? largest : R(1);
        }
    }
    return isfinite(probe) != 0;
}

#include "hessians/linear_curvature.c"

/* Raises the units to at least the curvature of linear costs. */
static void riccati_raise_units(solver_t *s, real_t *unit)
{
    for (int c = 0; c < N * NU; c++) {
        const real_t slope = stage_g(s, c / NU)[NX + c % NU];
        const real_t least = linear_curvature(slope, s->qp.lower[c], s->qp.upper[c]);
        if (least > unit[NX + c % NU]) {
            unit[NX + c % NU] = least;
        }
    }
}

/* Returns the weight of row m that gives its direction the curvature `hold`, in units of the variables. */
static real_t riccati_row_hold(const solver_t *s, int m, real_t hold)
{
    const real_t *unit = s->riccati.unit;
    real_t sum = R(0);
    if (!row_is_state(m)) {
        const real_t *a = row_gradient(s, m);
        for (int i = 0; i < (row_node(m) < N ? NZ : NX); i++) {
            sum += a[i] * a[i] / unit[i];
        }
        return (sum > R(0)) ? hold / sum : R(0);
    }
    sum = unit[row_index(m)];
    return hold * sum;
}

/* Returns 1 for equations and rows of the predicted working set. */
static int riccati_is_held(const qp_t *q, int m)
{
    const int c = NV + m;
    return !(q->penalty[m] < INF) && (q->lower[c] >= q->upper[c] || q->side[c] != 0);
}

/* Runs the recursion with the predicted working set held, and all variables without multiplier shifted. Returns 0 if a
 * pivot is not positive. */
static int riccati_try(solver_t *s, real_t hold, real_t shift)
{
    riccati_t *r = &s->riccati;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t held = (s->qp.side[k * NU + j] != 0) ? hold : R(0);
            r->diagonal[k][j] = (shift + held) * r->unit[NX + j];
        }
    }
    for (int f = 0; f < NF; f++) {
        r->diagonal_free[f] = shift * r->unit[free_state[f]];
    }
    for (int m = 0; m < NG; m++) {
        r->held[m] = riccati_is_held(&s->qp, m) ? riccati_row_hold(s, m, hold) : R(0);
    }
    return riccati_factorize(s, N);
}

/* Finds the smallest shift, up to a factor of four, for which the recursion succeeds, and runs it with a margin,
 * because a full step with a smaller shift may be too long. The search starts at the shift of the previous QP. Returns
 * 0 if there is none. */
static int riccati_shift(solver_t *s, real_t hold)
{
    const real_t least = FACTOR_HESSIAN_FLOOR, before = s->riccati.shift;
    real_t high = (before > least) ? before : FACTOR_SHIFT_FIRST;
    int trial;
    if (riccati_try(s, hold, least)) {
        return 1;
    }
    for (trial = 0; !riccati_try(s, hold, high); trial++) {
        /* at most MAX_SHIFTS + 1 passes */
        if (trial == MAX_SHIFTS) {
            return 0;
        }
        high *= FACTOR_SHIFT_RATIO;
    }
    for (int n = 0; n < MAX_SHIFTS && trial == 0 && high > FACTOR_SHIFT_RATIO * least; n++) {
        if (!riccati_try(s, hold, high / FACTOR_SHIFT_RATIO)) {
            break;
        }
        high /= FACTOR_SHIFT_RATIO;
    }
    s->riccati.shift = high;
    if (MIRROR) {
        /* this mirrors the negative eigenvalue */
        return riccati_try(s, hold, R(2) * high);
    }
    return riccati_try(s, hold, FACTOR_SHIFT_MARGIN * high);
}

/* Adds the shifts of the last trial, and the terms that hold the working set, to the Hessian of the QP. */
static void riccati_keep_diagonal(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            stage_Q(s, k)[NX + j][NX + j] += s->riccati.diagonal[k][j];
        }
    }
    for (int f = 0; f < NF; f++) {
        stage_Q(s, 0)[free_state[f]][free_state[f]] += s->riccati.diagonal_free[f];
    }
    s->hessian.changed = 1;
}

static void riccati_clear_diagonal(riccati_t *r)
{
    (void)memset(r->diagonal, 0, sizeof r->diagonal);
    (void)memset(r->diagonal_free, 0, sizeof r->diagonal_free);
}

static int riccati_convexify(solver_t *s)
{
    riccati_t *r = &s->riccati;
    int found;
    riccati_clear_diagonal(r);
    (void)memset(r->weight, 0, sizeof r->weight);
    (void)memset(r->held, 0, sizeof r->held);
    (void)memset(r->fixed, 0, sizeof r->fixed);
    r->regularize = 0;
    if (riccati_factorize(s, N)) {
        return 1;
    }
    if (!riccati_units(s, r->unit)) {
        return 0;
    }
    riccati_raise_units(s, r->unit);
    for (int k = 0; k < N; k++) {
        extend_units(stage_Q(s, k)[0], NZ, NZ, r->unit);
    }
    found = riccati_try(s, R(0), FACTOR_SHIFT_SMALL) || riccati_try(s, R(1), R(0)) ||
        riccati_try(s, FACTOR_SHIFT_FIRM_HOLD, R(0)) || riccati_shift(s, FACTOR_SHIFT_FIRM_HOLD);
    if (found) {
        riccati_keep_diagonal(s);
    }
    riccati_clear_diagonal(r);
    return found;
}
