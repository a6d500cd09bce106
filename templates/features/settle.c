/* A watch on multipliers: a Hessian that depends on multipliers which do not converge belongs to no problem, and every
 * QP may be solved all the same. */

static void settle_on_reset(solver_t *s)
{
    s->unsettled = 0;
    memset(s->lam_before, 0, sizeof s->lam_before);
}

static void settle_before_solve(solver_t *s)
{
    s->unsettled = 0;
}

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

/* Counts in unsettled the samples on end in which the lam have changed by more than half their size since the sample
 * before, node by node, although the plan moves: where the state stands still they do not change. */
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
    memcpy(s->lam_before, s->lam, sizeof s->lam_before);
    s->unsettled = (change > R(0.5) * size && !stands_still(s)) ? s->unsettled + 1 : 0;
}

/* After PATIENCE / 2 such samples the multipliers are estimated anew at the plan; if that does not help, the plan is
 * given up after as many more. */
static void settle_before_prepare(solver_t *s)
{
    if (s->unsettled == PATIENCE / 2) {
        forget_multipliers(s);
    } else if (s->unsettled >= PATIENCE) {
        start_anew(s);
        s->unsettled = 0;
    }
}

static void settle_on_success(solver_t *s, status_t status)
{
    if (status == RELAXED) { /* its multipliers are those of the penalty, not of a plan */
        forget_multipliers(s);
    }
    watch_multipliers(s);
}
