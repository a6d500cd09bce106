/* Repair: before a sample, a plan that is far from the model, or whose last sample failed, is improved by further steps
 * at its own x_0. Each is shortened until it reduces the residual; without one that does, the plan stays. */

/* The residual at the present point, without derivatives, after `length` of the step of the QP. */
static real_t trial_residual(solver_t *s, const real_t *size)
{
    real_t most = largest_gap(s, size);
    if (NONLINEAR_ROWS) {
        s->row_residual = row_residual(s, s->trial.length);
        enlarge(&most, s->row_residual);
    }
    return most;
}

/* The QP at x_0 of the plan in place of a measured state. */
static status_t run_qp_at_plan(solver_t *s)
{
    real_t measured[NX];
    status_t status;
    measure_plan(s, measured);
    status = run_sample_qp(s);
    s->trial.elastic = status == RELAXED;
    memcpy(s->xhat, measured, sizeof s->xhat);
    return status;
}

/* Returns 1 if a residual may be left behind: it has fallen or is small, or nothing is known of the plan, as the
 * residual of an initial guess tells nothing of the plan to which it leads. */
static int may_stay(const solver_t *s, real_t residual, int unknown)
{
    return residual < s->stats.residual || !is_far(residual) || (unknown && residual < INF);
}

/* One step of the repair. Returns 1 if the plan has changed. */
static int improve_plan(solver_t *s, const real_t *size, int unknown)
{
    trial_t *q = &s->trial;
    const status_t status = run_qp_at_plan(s);
    int improved = 0;
    if ((status != OK && status != RELAXED) || !step_is_finite(s)) {
        return 0;
    }
    real_t kept = R(0);
    if (NONLINEAR_ROWS) {
        kept = s->row_residual;
    }
    memcpy(q->x, s->x, sizeof s->x);
    memcpy(q->u, s->u, sizeof s->u);
    put_step_aside(s);
    q->length = R(1);
    for (int trial = 0; trial < REPAIR_TRIALS && !improved; trial++) {
        move_to_trial(s);
        improved = may_stay(s, trial_residual(s, size), unknown);
        q->length *= improved ? R(1) : R(0.5);
    }
    if (improved) {
        take_multipliers(s);
    } else {
        move_back(s);
        s->row_residual = kept;
    }
    q->elastic = 0;
    return improved;
}

/* Returns 1 if a step moves a state by more than the tolerance in its scale. */
static int step_is_long(const step_t *step, const real_t *size)
{
    int is_long = 0;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            is_long |= !(FABS(step->dx[k][i]) <= residual_tolerance[0] * size[i]);
        }
    }
    return is_long;
}

/* Returns 1 if the last step shows that the first control has converged. Then the control is at its bounds, or the step
 * moves no state by more than the tolerance in its scale and the first control by less than a part of the tolerance. A
 * longer step up to the tolerance counts as well if it is less than half the step before: otherwise a plan that moves
 * slowly may still be far from its solution. */
static int control_settles(solver_t *s, const step_t *step, const real_t *size)
{
    real_t range[NU], moved = R(0);
    int rests = 1;
    control_sizes(s, range);
    for (int j = 0; j < NU; j++) {
        enlarge(&moved, step->du[0][j] / range[j]);
        rests &= s->u[0][j] <= control_lower(s, 0, j) || s->u[0][j] >= control_upper(s, 0, j);
    }
    const int creeps = moved <= FACTOR_REPAIR_CONTROL_CHANGE * residual_tolerance[0];
    const int contracts = moved <= residual_tolerance[0] && moved <= R(0.5) * s->moved;
    s->moved = moved;
    return (rests && creeps) || ((creeps || contracts) && !step_is_long(step, size));
}

/* Repairs the plan that has just been linearised, with this status: while its residual is above the tolerance, after a
 * sample that failed or had to relax rows, and a first plan while steps are long. */
static status_t repair_after_prepare(solver_t *s, status_t status)
{
    if (LEVELS && s->levels.last != LEVEL_A) {
        return status;
    }
    const int first = s->samples == 0;
    int wanted = s->fresh > 0 || s->failing > NO_FAILURE || s->stats.violated_row >= 0;
    s->stats.repairs = 0;
    for (int n = 0; n < REPAIRS && status == OK && (wanted || is_far(s->stats.residual)); n++) {
        real_t size[NX];
        state_scales(s, size);
        if (!improve_plan(s, size, first && n == 0)) {
            break;
        }
        if (s->fresh > 0) {
            s->fresh = control_settles(s, &s->trial.step, size) ? 0 : s->fresh;
        }
        wanted = s->fresh > 0 || (first && step_is_long(&s->trial.step, size));
        s->stats.repairs++;
        status = prepare_here(s);
        measure_residual(s);
    }
    return status;
}

/* A first plan whose control does not settle has not converged, although its QP has a solution. */
static status_t repair_after_feedback(solver_t *s, status_t status)
{
    real_t size[NX];
    if (s->fresh == 0 || status != OK) {
        return status;
    }
    state_scales(s, size);
    s->fresh = control_settles(s, &s->step, size) ? 0 : s->fresh - 1;
    return (s->fresh > 0) ? NOT_CONVERGED : OK;
}
