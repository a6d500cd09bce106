/* riccati_convexify   before qp_factorize, side[] being the predicted working set: makes the QP convex if it is not. Returns 1 if
 *                     the factors at hand are those without given controls and without rows.
 *
 * The reduced Hessian, that of the controls and of the free components of x_0, is positive definite if and only if the pivots of
 * the recursion without given controls are. Where they are not, these variables get an addition to the diagonal of the
 * Hessian, which is the same at all stages and adds as much to the reduced Hessian:
 *     shift  on all of them: the smallest one, up to a factor of four, with which the pivots are positive while the controls of
 *            the predicted set are given, and an eighth more; twice that smallest one if GOLDEN_MIRROR, as if the negative eigenvalue
 *            changed its sign; or only the floor if that is enough
 *     hold   on the controls of the predicted set: what makes the pivots positive without them being given. Near a solution
 *            they do not move, so this changes neither the step nor the rate of convergence (Debreu's lemma: a matrix that is
 *            positive definite on the null space of E is so everywhere with the addition of a large multiple of E'E).
 * Multipliers lam do not see it: the additions belong to variables that have no multiplier lam. */

/* The unit of component j of z: the largest |Q_jj| + sum_i S_ij^2 |Q_ii of the next stage|. 0 if it is not finite. */
static int riccati_units(golden_solver_t *s, golden_real *unit)
{
    golden_real largest = 0.0, probe = 0.0;
    int k, i, j;
    memset(unit, 0, sizeof unit[0] * GOLDEN_NZS);
    for (k = 0; k < GOLDEN_NS; k++) {
        for (j = 0; j < GOLDEN_NZS && k * GOLDEN_NUS + j - GOLDEN_NXS < GOLDEN_N * GOLDEN_NU; j++) {
            golden_real sum = fabs(stage_Q(s, k)[j][j]);
            for (i = 0; i < GOLDEN_NXS; i++) {
                const golden_real a = stage_S(s, k)[i][j];
                const golden_real next = (k + 1 < GOLDEN_NS) ? stage_Q(s, k + 1)[i][i] : stage_Q_N(s)[i][i];
                sum += a * a * fabs(next);
            }
            unit[j] = (sum > unit[j]) ? sum : unit[j];
            largest = (sum > largest) ? sum : largest;
            probe += 0.0 * sum;
        }
    }
    for (j = 0; j < GOLDEN_NZS; j++) {
        if (!(unit[j] > 0.0)) {
            unit[j] = (largest > 0.0) ? largest : 1.0;
        }
    }
    return isfinite(probe) != 0;
}

/* The recursion with shift and hold; given: the controls of the predicted set are. 0 if a pivot is not positive. */
static int riccati_try(golden_solver_t *s, const golden_real *unit, golden_real shift, golden_real hold, int given)
{
    golden_riccati_t *r = &s->riccati;
    int c, f;
    for (c = 0; c < GOLDEN_N * GOLDEN_NU; c++) {
        const int j = GOLDEN_NXS + c % GOLDEN_NUS, held = s->qp.side[c] != 0;
        r->fixed[c] = given && held;
        r->diagonal[c / GOLDEN_NUS][j] = (held ? shift + hold : shift) * unit[j];
    }
    for (f = 0; f < GOLDEN_NF; f++) {
        r->diagonal[0][free_state[f]] = shift * unit[free_state[f]];
    }
    return riccati_factorize(s, GOLDEN_NS);
}

/* The smallest shift, up to a factor of four, with which the recursion succeeds; looked for near that of the QP before. Negative
 * if there is none. */
static golden_real riccati_smallest_shift(golden_solver_t *s, const golden_real *unit, int given)
{
    const golden_real least = regularization[0], before = s->riccati.shift;
    golden_real high = (before > least) ? before : 0.001;
    int trial;
    if (riccati_try(s, unit, 0.0, 0.0, given)) {
        return 0.0;
    }
    if (riccati_try(s, unit, least, 0.0, given)) {
        return least;
    }
    for (trial = 0; !riccati_try(s, unit, high, 0.0, given); trial++) {
        if (trial == GOLDEN_MAX_SHIFTS) {
            return -1.0;
        }
        high *= 4.0;
    }
    while (trial == 0 && high > 4.0 * least && riccati_try(s, unit, 0.25 * high, 0.0, given)) {
        high *= 0.25;
    }
    s->riccati.shift = high;
    return (GOLDEN_MIRROR ? 2.0 : 1.125) * high;
}

/* The recursion without given controls, and with a hold on those of the predicted set that is large enough. 0 if none is. */
static int riccati_hold(golden_solver_t *s, const golden_real *unit, golden_real shift)
{
    golden_real hold = 0.25 * s->riccati.hold;
    int trial;
    if (shift > 0.0 && riccati_try(s, unit, shift, 0.0, 0)) {
        return 1;
    }
    hold = (hold > 0.001) ? hold : 0.001;
    for (trial = 0; trial < GOLDEN_MAX_SHIFTS; trial++) {
        if (riccati_try(s, unit, shift, hold, 0)) {
            s->riccati.hold = hold;
            return 1;
        }
        hold *= 4.0;
    }
    return 0;
}

/* Shifts and holds of the last trial become part of the QP. */
static void riccati_keep_diagonal(golden_solver_t *s)
{
    int k, j;
    for (k = 0; k < GOLDEN_NS; k++) {
        for (j = 0; j < GOLDEN_NZS; j++) {
            stage_Q(s, k)[j][j] += s->riccati.diagonal[k][j];
        }
    }
    s->hessian.changed = 1;
}

static int riccati_convexify(golden_solver_t *s)
{
    golden_riccati_t *r = &s->riccati;
    golden_real unit[GOLDEN_NZS], shift;
    int found;
    memset(r->diagonal, 0, sizeof r->diagonal);
    memset(r->weight, 0, sizeof r->weight);
    memset(r->fixed, 0, sizeof r->fixed);
    r->regularize = 0;
    if (riccati_factorize(s, GOLDEN_NS)) {
        return 1;
    }
    if (!riccati_units(s, unit)) {
        return 0;
    }
    shift = riccati_smallest_shift(s, unit, 1);
    found = shift >= 0.0 && riccati_hold(s, unit, shift);
    if (!found) {
        shift = riccati_smallest_shift(s, unit, 0);
        found = shift > 0.0 && riccati_try(s, unit, shift, 0.0, 0);
    }
    if (found) {
        riccati_keep_diagonal(s);
    }
    memset(r->diagonal, 0, sizeof r->diagonal);
    return found;
}
