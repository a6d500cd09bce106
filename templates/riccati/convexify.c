/* riccati_convexify   makes the QP convex if it is not. Called before qp_factorize, when side[] is the predicted
 *                     working set. Returns 1 if the present factors are those without fixed controls and without rows.
 *
 * The reduced Hessian in the controls and the free components of x_0 is positive definite if and only if the pivots of
 * the recursion without fixed controls are positive. If they are not, terms are added to the diagonal of the Hessian
 * for these variables. The terms are the same at all stages and add the same amount to the reduced Hessian:
 *     shift  for all of them: the smallest one, up to a factor of four, for which the pivots are positive with the
 *            controls of the predicted working set fixed, plus one eighth; twice the smallest one if MIRROR, as if the
 *            negative eigenvalue changed its sign; only the floor if that is sufficient
 *     hold   for the controls of the predicted working set: large enough for the pivots to be positive without fixing
 *            these controls. Near a solution they do not move, so that the hold changes neither the step nor the rate
 *            of convergence (Debreu's lemma: a matrix that is positive definite on the null space of E becomes positive
 *            definite if a sufficiently large multiple of E'E is added).
 * The multipliers lam are not affected: the terms belong to variables that have no multiplier lam. */

/* Scale of component j of z: the maximum over the stages of |Q_jj| + sum_i S_ij^2 |Q_ii of the next stage|. Returns 0
 * if it is not finite. */
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

/* The recursion with shift and hold; if `given`, the controls of the predicted working set are fixed. Returns 0 if a
 * pivot is not positive. */
static int riccati_try(solver_t *s, const real_t *unit, real_t shift, real_t hold, int given)
{
#if BUDGET
    if (!qp_afford(&s->qp, COST_SHIFT)) {
        return 0;
    }
#endif
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

/* Smallest shift, up to a factor of four, for which the recursion succeeds; the search starts at the shift of the
 * previous QP. Negative if there is none. */
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
        /* at most MAX_SHIFTS + 1 passes */
        if (trial == MAX_SHIFTS) {
            return -R(1);
        }
        high *= R(4);
    }
    for (int n = 0; n < MAX_SHIFTS && trial == 0 && high > R(4) * least; n++) {
        if (!riccati_try(s, unit, R(0.25) * high, R(0), given)) {
            break;
        }
        high *= R(0.25);
    }
    s->riccati.shift = high;
    return (MIRROR ? R(2) : R(1.125)) * high;
}

/* The recursion without fixed controls, with a hold on the predicted working set that is large enough. Returns 0 if
 * none is found. */
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

/* Adds the shifts and holds of the last trial to the Hessian of the QP. */
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
