/* The watch on plans: what samples on end say of one, and how much of it is given up. Counts and what follows:
 *
 *     failing = TWICE: failures. All states restart at the measured one.
 *     failing = FOR_GOOD: failures. Nothing is kept.
 *     unconverged = PATIENCE: samples that were NOT_CONVERGED. Nothing is kept.
 *     unsettled = PATIENCE / 2: samples in which lam changed by half its size. Multipliers are forgotten.
 *     unsettled = PATIENCE: the same. Nothing is kept.
 *
 * A single failure may come from its sample alone: then only the working set is discarded if the QP solver did not
 * converge. The second one counts as the third if there is no finite linearisation at the plan (broken), and so does
 * any failure of a plan that is not finite or among the first PATIENCE successes after a restart, which a negative
 * failing counts. */
enum { FINE, ONCE, TWICE, FOR_GOOD };

static void reset_watch(solver_t *s)
{
    s->failing = FINE;
    s->unconverged = 0;
    s->unsettled = 0;
    memset(s->lam_before, 0, sizeof s->lam_before);
    s->fresh = PATIENCE;
    s->moved = R(0);
}

#if LAGRANGIAN && HAS_QP
/* Returns 1 if the step of the QP moves no state or control by more than 1 / 4096 of its largest value, beyond zeros:
 * the plan stands at a solution, and multipliers that change there are not unique (as many active rows as controls). */
static int stands_still(const solver_t *s)
{
    for (int i = 0; i < NZ; i++) {
        real_t moved = R(0), size = R(0);
        for (int k = 0; k <= N; k++) {
            if (i < NX) {
                enlarge(&moved, s->step.dx[k][i]);
                enlarge(&size, s->x[k][i]);
            } else if (k < N) {
                enlarge(&moved, s->step.du[k][i - NX]);
                enlarge(&size, s->u[k][i - NX]);
            }
        }
        if (moved > size / 4096 + TOL_ZERO * z_scale[i]) {
            return 0;
        }
    }
    return 1;
}

/* A Hessian that depends on multipliers which do not converge belongs to no problem, and every QP may be solved all the
 * same: counts the samples in which the lam have changed by more than half their size, node by node, although the plan
 * moves. Multipliers of relaxed rows are those of the penalty, not of a plan. */
static void watch_multipliers(solver_t *s, status_t status)
{
    real_t change = R(0), size = R(0);
    if (status == RELAXED) {
        forget_multipliers(s);
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&change, s->lam[k][i] - s->lam_before[k][i]);
            enlarge(&size, s->lam[k][i]);
            enlarge(&size, s->lam_before[k][i]);
        }
    }
    memcpy(s->lam_before, s->lam, sizeof s->lam_before);
    s->unsettled = (change > R(0.5) * size && !stands_still(s)) ? s->unsettled + 1 : 0;
}

#endif
/* Gives up as much of the plan as failing says[if !NODES:; past steps alone unless the simulation failed]. */
static void give_up(solver_t *s, status_t status)
{
    if (s->failing == FOR_GOOD) {
#if NODES
        forget_plan(s);
#else
        if (status == NUMERICAL_FAILURE) {
            forget_plan(s);
        } else {
            forget_past(s);
        }
#endif
        s->unconverged = 0;
        s->unsettled = 0;
        s->fresh = PATIENCE;
    }
#if NODES
    if (s->failing >= TWICE) {
        start_at_measured(s);
#if !HAS_QP
        reset_search(s);
#endif
    }
#endif
}

/* After a sample with this status: counts it, and gives up what follows from a failure. */
static void watch(solver_t *s, status_t status, int broken)
{
    if (status == NOT_FINITE || status == NOT_PREPARED) { /* they say nothing of the plan */
        return;
    }
    s->unconverged = (status == NOT_CONVERGED) ? s->unconverged + 1 : 0;
    if (status == OK || status == RELAXED || status == NOT_CONVERGED) {
        s->failing = (s->failing >= TWICE) ? -PATIENCE : (s->failing < FINE) ? s->failing + 1 : FINE;
        if (LAGRANGIAN && HAS_QP) {
            watch_multipliers(s, status);
        }
        return;
    }
    s->failing = (s->failing < FINE) ? FOR_GOOD : s->failing + (s->failing < FOR_GOOD);
    if (NODES) {
        if ((s->failing == TWICE && broken) || !plan_is_finite(s)) {
            s->failing = FOR_GOOD;
        }
    }
    if (HAS_QP && (status == ITERATION_LIMIT || status == STALLED)) {
        condense_init(s);
    }
    give_up(s, status);
}

/* Before a sample: gives up what follows from samples that did not fail. */
static void doubt_plan(solver_t *s)
{
    int given_up = 0;
    if (REPAIR > 0 || !HAS_QP) {
        given_up |= s->unconverged >= PATIENCE;
    }
    if (LAGRANGIAN && HAS_QP) {
        given_up |= s->unsettled >= PATIENCE;
        if (s->unsettled == PATIENCE / 2) {
            forget_multipliers(s);
        }
    }
    if (given_up) {
        s->failing = FOR_GOOD;
        give_up(s, OK);
    }
}
