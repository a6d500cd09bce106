/* Steps of a QP at several trial lengths from a base, and the multipliers after them. */

/* Returns the address of component i of (dx, du) at node k. */
static inline real_t *step_at(step_t *d, int k, int i)
{
    return (i < NX) ? &d->dx[k][i] : &d->du[k][i - NX];
}

/* Saves the plan: its states, controls and multipliers. */
static void keep_plan(solver_t *s)
{
    trial_t *kept = &s->trial;
    (void)memcpy(kept->x, s->x, sizeof s->x);
    (void)memcpy(kept->u, s->u, sizeof s->u);
    if (KEEPS_MULTIPLIERS) {
        (void)memcpy(kept->lam, s->lam, sizeof s->lam);
        (void)memcpy(kept->step.mult_u, s->mu_u, sizeof s->mu_u);
        (void)memcpy(kept->step.mult, s->mult, sizeof s->mult);
    }
}

/* Restores the saved multipliers, if the Hessian may depend on them. */
static void return_multipliers(solver_t *s)
{
    const trial_t *kept = &s->trial;
    if (KEEPS_MULTIPLIERS) {
        (void)memcpy(s->lam, kept->lam, sizeof s->lam);
        (void)memcpy(s->mu_u, kept->step.mult_u, sizeof s->mu_u);
        (void)memcpy(s->mult, kept->step.mult, sizeof s->mult);
    }
}

/* Returns to the base, from which the steps of this iteration start. */
static void move_back(solver_t *s)
{
    (void)memcpy(s->x, s->trial.x, sizeof s->x);
    (void)memcpy(s->u, s->trial.u, sizeof s->u);
}

/* (x, u) = base + length (dx, du); step becomes the difference from the base. */
static void move_to_trial(solver_t *s)
{
    trial_t *q = &s->trial;
    move_back(s);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            *step_at(&s->step, k, i) = q->length * *step_at(&q->step, k, i);
        }
    }
    take_step(s);
}

/* Saves the result of a QP, whose step is then tried at several lengths. */
static void put_step_aside(solver_t *s)
{
    s->trial.step = s->step;
    if (KEEPS_MULTIPLIERS) {
        (void)multipliers_of_qp(s, s->trial.lam, 0);
    }
}

/* Moves a multiplier by the fraction `length` towards that of the QP, completely if it is not finite. */
static inline void approach(real_t *a, real_t b, real_t length)
{
    *a = (length < R(1) && isfinite(*a)) ? *a + length * (b - *a) : b;
}

/* Updates the multipliers after a step. */
static void take_multipliers(solver_t *s)
{
    if (HARD_ROWS) {
        if (s->trial.elastic) { /* multipliers of an elastic QP are those of its penalty */
            forget_multipliers(s);
            return;
        }
    }
    if (CURVED || LAGRANGIAN || STAGE_MULTIPLIERS) {
        /* Multipliers move towards those of the QP by the fraction that the step took, because after a short step the
         * multipliers of the QP may be wrong. */
        const trial_t *q = &s->trial;
        for (int k = 0; k < N; k++) {
            for (int j = 0; j < NU; j++) {
                approach(&s->mu_u[k][j], q->step.mult_u[k][j], q->length);
            }
        }
        for (int m = 0; m < NG; m++) {
            approach(&s->mult[m], q->step.mult[m], q->length);
        }
    } else {
        s->step = s->trial.step;
        copy_multipliers(s);
    }
    if (HAS_ADJOINT_STEP && !CURVED) {
        (void)recover_multipliers(s); /* convergence is judged by the residuals of the problem itself */
    } else {
        for (int k = 0; k <= N; k++) {
            for (int i = 0; i < NX; i++) {
                approach(&s->lam[k][i], s->trial.lam[k][i], s->trial.length);
            }
        }
    }
}
