/* Line search with the filter. A full step that is rejected gets one second-order correction. */

/* Second-order correction: the constraints of the QP take their values at base + step, the present point of s. As the
 * step satisfies A dx + B du + b = dx_{k+1}, the b are the sums of both gaps; rows are h(x + dx, u + du) - J (dx,
 * du). */
static void correct_constraints(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        node_t *node = &s->node[k];
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            node->b[i] += x_next[i] - s->x[k + 1][i];
        }
        real_t J[NH][NZ];
        PATH_ROWS(s, k, node->h, J);
        for (int i = 0; i < NH; i++) {
            for (int j = 0; j < NZ; j++) {
                node->h[i] -= node->J[i][j] * *step_at(&s->trial.step, k, j);
            }
        }
    }
    real_t J[NH_N][NX];
    TERMINAL_ROWS(s, s->terminal.h, J);
    for (int i = 0; i < NH_N; i++) {
        for (int j = 0; j < NX; j++) {
            s->terminal.h[i] -= s->terminal.J[i][j] * s->trial.step.dx[N][j];
        }
    }
    real_t J_0[NE][NX], J_N[NE][NX];
    COUPLED_ROWS(s, s->coupled.r, J_0, J_N);
    for (int i = 0; i < NE; i++) {
        for (int j = 0; j < NX; j++) {
            s->coupled.r[i] -=
                s->coupled.J_0[i][j] * s->trial.step.dx[0][j] + s->coupled.J_N[i][j] * s->trial.step.dx[N][j];
        }
    }
}

/* Returns 1 if the step of the same QP with corrected constraints is accepted. */
static int accepts_corrected(solver_t *s)
{
    int accepted = 0;
    correct_constraints(s);
    move_back(s);
    push_to_bounds(s);
    condense_rows(s);
    if (solve_again(s) == OK && step_is_finite(s)) {
        take_step(s);
        accepted = accepts(s);
    }
    if (accepted) {
        put_step_aside(s);
    }
    restore_gradients(s);
    return accepted;
}

/* Backtracks. If the full step is rejected, one second-order correction is tried. */
static status_t line_search(solver_t *s)
{
    trial_t *q = &s->trial;
    for (int trial = 0; trial < MAX_TRIALS; trial++) {
        move_to_trial(s);
        if (accepts(s)) {
            return OK;
        }
        if (q->length == R(1) && accepts_corrected(s)) { /* exact comparison, as lengths are powers of 2 */
            return OK;
        }
        q->length *= R(0.5);
    }
    move_back(s);
    return STALLED;
}

/* Returns the directional derivative g' (dx, du) of the cost along the step. */
static real_t slope_of(solver_t *s)
{
    real_t slope = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            slope += gradient_of(s, k)[i] * *step_at(&s->step, k, i);
        }
    }
    if (SOFT_ROWS) {
        /* the penalties change as in the QP */
        real_t value[NG];
        evaluate_rows(s, value);
        for (int m = 0; m < NG; m++) {
            if (row_is_soft(s, m)) {
                slope += soft_penalty(s, m, FABS(row_excess(s, m, R(0))));
                slope -= soft_penalty(s, m, outside(s, m, value[m]));
            }
        }
    }
    return slope;
}

/* Runs the line search. If no step passes the filter, feasibility is restored: until the filter accepts a point again,
 * steps have to reduce the violation only. */
static status_t search(solver_t *s)
{
    sqp_t *q = &s->sqp;
    q->slope = slope_of(s);
    q->gain = gain_of(s);
    enlarge(&q->cost_scale, q->slope);
    q->restoring = s->trial.elastic || (q->restoring && !passes_filter(q, &q->base));
    if (!q->restoring) {
        s->trial.length = R(1);
        const status_t status = line_search(s);
        if (status == OK || !(q->base.violation > FACTOR_SQP_RESTORATION * TOL_MERIT_ROUNDING)) {
            return status;
        }
        extend_filter(q);
        q->restoring = 1;
    }
    s->trial.length = R(1);
    return (q->gain > FACTOR_SQP_LEAST_REDUCTION * q->base.violation) ? line_search(s) : STALLED;
}
