/* The watch on plans decides from consecutive samples how much of a plan is discarded. failures: consecutive failures;
 * the third one is lasting, and so is one on probation. probation: successes still required of a plan that has failed
 * twice in a row. */
enum { NO_FAILURE = 0, SECOND_FAILURE = 2, LASTING_FAILURE = 3 };

static void reset_watch(solver_t *s)
{
    s->failures = NO_FAILURE;
    s->probation = 0;
    s->unconverged = 0;
    s->unsettled = 0;
    (void)memset(s->lam_before, 0, sizeof s->lam_before);
}

#if LAGRANGIAN && HAS_QP
/* Returns 1 if the step of the QP moves no state or control by more than 1 / 4096 of its largest value, beyond zeros.
 * The plan is then at a solution, and multipliers that change there are not unique (as many active rows as
 * controls). */
static int is_stationary(const solver_t *s)
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

/* Counts in unsettled the samples in which lam has changed by more than half its size, node by node, although the plan
 * moves. A Hessian that depends on multipliers which do not converge belongs to no problem, although every QP may be
 * solved. */
static void watch_multipliers(solver_t *s)
{
    real_t change = R(0), size = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&change, s->lam[k][i] - s->lam_before[k][i]);
            enlarge(&size, s->lam[k][i]);
            enlarge(&size, s->lam_before[k][i]);
        }
    }
    (void)memcpy(s->lam_before, s->lam, sizeof s->lam_before);
    s->unsettled = (change > R(0.5) * size && !is_stationary(s)) ? s->unsettled + 1 : 0;
}
#endif

#if NODES
/* Discards as much of the plan as the consecutive failures require: after the second one all states restart at the
 * measured one, after a lasting one nothing is kept. */
static void give_up(solver_t *s, status_t status)
{
    if (s->failures == LASTING_FAILURE) {
        forget_plan(s);
        if (ITERATES && s->samples % 2 == 0) { /* no failure may recur for ever with its plan */
            center_controls(s);
        }
    }
    if (s->failures >= SECOND_FAILURE) {
        start_at_measured(s);
        if (!HAS_QP) {
            reset_search(s);
        }
    } else if (HAS_QP && (status == ITERATION_LIMIT || status == STALLED)) {
        condense_init(s); /* only the sample may have caused the failure: the working set is discarded */
    }
}
#else
/* Discards, after lasting failures, the plan if its simulation has failed, else the multipliers and the history of
 * steps. */
static void give_up(solver_t *s, status_t status)
{
    if (s->failures == LASTING_FAILURE) {
        if (status == NUMERICAL_FAILURE) {
            forget_plan(s);
        } else {
            forget_past(s);
        }
    }
}
#endif

/* Counts a sample that has not failed. */
static void note_success(solver_t *s)
{
    if (s->failures >= SECOND_FAILURE) {
        s->probation = RESTART_SAMPLES;
    } else if (s->probation > 0) {
        s->probation--;
    }
    s->failures = NO_FAILURE;
}

/* Counts a sample that has failed. It is lasting at once if the linearisation (broken) or the plan is not finite. */
static void note_failure(solver_t *s, int broken)
{
    if (s->probation > 0) {
        s->probation = 0;
        s->failures = LASTING_FAILURE;
    } else if (s->failures < LASTING_FAILURE) {
        s->failures++;
    }
    if (NODES) {
        if ((s->failures == SECOND_FAILURE && broken) || !plan_is_finite(s)) {
            s->failures = LASTING_FAILURE;
        }
    }
}

/* Counts a sample with this status, and discards what its failure requires. */
static void watch(solver_t *s, status_t status, int broken)
{
    if (status == NOT_FINITE || status == NOT_PREPARED) { /* these failures do not depend on the plan */
        return;
    }
    s->unconverged = (status == NOT_CONVERGED) ? s->unconverged + 1 : 0;
    if (status == OK || status == RELAXED || status == NOT_CONVERGED) {
        note_success(s);
        if (LAGRANGIAN && HAS_QP) {
            watch_multipliers(s);
        }
        return;
    }
    note_failure(s, broken);
    give_up(s, status);
}

/* Discards, before a sample, what samples that did not fail require. */
static void restart_doubtful_plan(solver_t *s)
{
    int given_up = 0;
    if (REPAIR > 0 || ITERATES || !HAS_QP) {
        /* unconverged: consecutive samples that were NOT_CONVERGED */
        given_up |= s->unconverged >= RESTART_SAMPLES;
    }
    if (LAGRANGIAN && HAS_QP) {
        /* Multipliers are forgotten first, then the plan. */
        given_up |= s->unsettled >= RESTART_SAMPLES;
        if (s->unsettled == RESTART_SAMPLES / 2) {
            forget_multipliers(s);
        }
    }
    if (given_up) {
        start_anew(s);
        if (NODES && !HAS_QP) {
            reset_search(s);
        }
        s->unconverged = 0;
        s->unsettled = 0;
    }
}
