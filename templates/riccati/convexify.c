/* riccati_convexify   before qp_factorize, side[] being the predicted working set: makes the QP convex if it is not. Returns 1 if
 *                     the factors at hand are those without given controls and without rows.
 *
 * The reduced Hessian, that of the controls and of the free components of x_0, is positive definite if and only if the pivots of
 * the recursion without given controls are. Where they are not, these variables get an addition to the diagonal of the
 * Hessian, which is the same at all stages and adds as much to the reduced Hessian:
 *     shift  on all of them: the smallest one, up to a factor of four, with which the pivots are positive while the controls of
 *            the predicted set are given, and an eighth more; twice that smallest one if MIRROR, as if the negative eigenvalue
 *            changed its sign; or only the floor if that is enough
 *     hold   on the controls of the predicted set: what makes the pivots positive without them being given. Near a solution
 *            they do not move, so this changes neither the step nor the rate of convergence (Debreu's lemma: a matrix that is
 *            positive definite on the null space of E is so everywhere with the addition of a large multiple of E'E).
 * Multipliers lam do not see it: the additions belong to variables that have no multiplier lam. */

/* The unit of component j of z: the largest |Q_jj| + sum_i S_ij^2 |Q_ii of the next stage|. 0 if it is not finite. */
static int riccati_units(solver_t *s, real_t *unit)
{
    real_t largest = R(0), probe = R(0);
    memset(unit, 0, sizeof unit[0] * NZS);
    for (int k = 0; k < NS; k++) {
        for (int j = 0; j < NZS && k * NUS + j - NXS < N * NU; j++) {
            real_t sum = FABS(stage_Q(s, k)[j][j]);
            for (int i = 0; i < NXS; i++) {
                const real_t a = stage_S(s, k)[i][j];
                const real_t next = (k + 1 < NS) ? stage_Q(s, k + 1)[i][i] : stage_Q_N(s)[i][i];
                sum += a * a * FABS(next);
            }
            unit[j] = (sum > unit[j]) ? sum : unit[j];
            largest = (sum > largest) ? sum : largest;
            probe += R(0) * sum;
        }
    }
    for (int j = 0; j < NZS; j++) {
        if (!(unit[j] > R(0))) {
            unit[j] = (largest > R(0)) ? largest : R(1);
        }
    }
    return isfinite(probe) != 0;
}

/* The recursion with shift and hold; given: the controls of the predicted set are. 0 if a pivot is not positive. */
static int riccati_try(solver_t *s, const real_t *unit, real_t shift, real_t hold, int given)
{
    riccati_t *r = &s->riccati;
    for (int k = 0; k < NS; k++) {
        for (int j = 0; j < NUS && k * NUS + j < N * NU; j++) {
            const int c = k * NUS + j, held = s->qp.side[c] != 0;
            r->fixed[c] = given && held;
            r->diagonal[k][j] = (held ? shift + hold : shift) * unit[NXS + j];
        }
    }
#if NF
    for (int f = 0; f < NF; f++) {
        r->diagonal_free[f] = shift * unit[free_state[f]];
    }
#endif
    return riccati_factorize(s, NS);
}

/* The smallest shift, up to a factor of four, with which the recursion succeeds; looked for near that of the QP before. Negative
 * if there is none. */
static real_t riccati_smallest_shift(solver_t *s, const real_t *unit, int given)
{
    const real_t least = regularization[0], before = s->riccati.shift;
    real_t high = (before > least) ? before : R(1e-3);
    int trial;
    if (riccati_try(s, unit, R(0), R(0), given)) {
        return R(0);
    }
    if (riccati_try(s, unit, least, R(0), given)) {
        return least;
    }
    for (trial = 0; !riccati_try(s, unit, high, R(0), given); trial++) {
        if (trial == MAX_SHIFTS) {
            return -R(1);
        }
        high *= R(4);
    }
    while (trial == 0 && high > R(4) * least && riccati_try(s, unit, R(0.25) * high, R(0), given)) {
        high *= R(0.25);
    }
    s->riccati.shift = high;
    return (MIRROR ? R(2) : R(1.125)) * high;
}

/* The recursion without given controls, and with a hold on those of the predicted set that is large enough. 0 if none is. */
static int riccati_hold(solver_t *s, const real_t *unit, real_t shift)
{
    real_t hold = R(0.25) * s->riccati.hold;
    if (shift > R(0) && riccati_try(s, unit, shift, R(0), 0)) {
        return 1;
    }
    hold = (hold > R(1e-3)) ? hold : R(1e-3);
    for (int trial = 0; trial < MAX_SHIFTS; trial++) {
        if (riccati_try(s, unit, shift, hold, 0)) {
            s->riccati.hold = hold;
            return 1;
        }
        hold *= R(4);
    }
    return 0;
}

/* Shifts and holds of the last trial become part of the QP. */
static void riccati_keep_diagonal(solver_t *s)
{
    for (int k = 0; k < NS; k++) {
        for (int j = 0; j < NUS; j++) {
            stage_Q(s, k)[NXS + j][NXS + j] += s->riccati.diagonal[k][j];
        }
    }
#if NF
    for (int f = 0; f < NF; f++) {
        stage_Q(s, 0)[free_state[f]][free_state[f]] += s->riccati.diagonal_free[f];
    }
#endif
    s->hessian.changed = 1;
}

static void riccati_clear_diagonal(riccati_t *r)
{
    memset(r->diagonal, 0, sizeof r->diagonal);
#if NF
    memset(r->diagonal_free, 0, sizeof r->diagonal_free);
#endif
}

static int riccati_convexify(solver_t *s)
{
    riccati_t *r = &s->riccati;
    real_t unit[NZS], shift;
    int found;
    riccati_clear_diagonal(r);
#if NG
    memset(r->weight, 0, sizeof r->weight);
#endif
    memset(r->fixed, 0, sizeof r->fixed);
    r->regularize = 0;
    if (riccati_factorize(s, NS)) {
        return 1;
    }
    if (!riccati_units(s, unit)) {
        return 0;
    }
    shift = riccati_smallest_shift(s, unit, 1);
    found = shift >= R(0) && riccati_hold(s, unit, shift);
    if (!found) {
        shift = riccati_smallest_shift(s, unit, 0);
        found = shift > R(0) && riccati_try(s, unit, shift, R(0), 0);
    }
    if (found) {
        riccati_keep_diagonal(s);
    }
    riccati_clear_diagonal(r);
    return found;
}
