/* Contract of this part: a Hessian that depends on multipliers which do not converge belongs to no problem, and every QP
 * may be solved all the same. settle() is called before a preparation, watch_multipliers() after a success. */

/* Counts in unsettled the samples on end in which the lam have changed by more than half their size since the sample
 * before, node by node: a plan that is moved while the state stands still has multipliers that do not change. */
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
    s->unsettled = (change > R(0.5) * size) ? s->unsettled + 1 : 0;
}

/* After PATIENCE / 2 such samples the multipliers are estimated anew at the plan; if that does not help, the plan is
 * given up after as many more. */
static void settle(solver_t *s)
{
    if (s->unsettled == PATIENCE / 2) {
        forget_multipliers(s);
    } else if (s->unsettled >= PATIENCE) {
        forget_plan(s);
        start_at_measured(s);
        s->unsettled = 0;
    }
}
