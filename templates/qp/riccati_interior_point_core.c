/* Primal-dual interior point method of Mehrotra (1992) on the stages of the QP; the Riccati recursion solves the linear
 * systems.
 *
 *     min  sum_k 1/2 z_k'Q_k z_k + g_k'z_k + sum_c (l1_c e_c + l2_c/2 e_c^2)
 *     s.t. x_{k+1} = S_k z_k + b_k,   v_c = B_c  for an equation,
 *          bound_i - sign_i v_i + e_i = t_i >= 0  for every finite side i of a row; e_c is 0 unless it has a price
 *
 * The directions of t and lam, of e and its multiplier kappa, are eliminated row by row, so that only the weights of
 * the rows enter the recursion. An equation is a row with a small compliance; corrections of its multiplier make it
 * exact. */

#include "qp/riccati_interior_point_rows.c"

#include "qp/riccati_interior_point_start.c"

#include "qp/riccati_interior_point_certificate.c"

#include "qp/riccati_interior_point_iterate.c"

/* Sets the side of every row that is active: its multiplier exceeds the one that corresponds to its distance from the
 * bound, lam reach^2 > t. */
static void ipm_write_active(solver_t *s)
{
    const ipm_t *q = &s->ipm;
    for (int i = 0; i < q->sides; i++) {
        const int c = ipm_row(q, i);
        const real_t square = s->units.reach[c] * s->units.reach[c];
        int side = ipm_is_upper(q, i) ? AT_UPPER : AT_LOWER;
        if (NG) {
            if (i >= q->hard && q->e[i - q->hard] > q->kappa[i - q->hard] * square) {
                side = ipm_is_upper(q, i) ? ABOVE : BELOW;
            }
        }
        if (q->lam[i] * square > q->t[i]) {
            s->qp.side[c] = side;
            if (c < NV && q->t[i] <= TOL_UNIT * SQRT(q->unit) * s->units.reach[c]) {
                s->qp.z[c] = ipm_bound(s, i); /* exact, as it may be 0 */
            }
        }
    }
}

/* Marks soft rows that are not among the sides as violated: those that depend on no control, and those whose violation
 * has no cost. */
static void ipm_write_others(solver_t *s)
{
    const qp_t *q = &s->qp;
    for (int m = 0; m < NG; m++) {
        const int c = NV + m, listed = s->units.reach[c] > R(0) && q->penalty[m] + q->curvature[m] > R(0);
        if (qp_is_soft(q, m) && !listed && ipm_violation(s, c) > R(0)) {
            s->qp.side[c] = (s->ipm.v[c] > q->upper[c]) ? ABOVE : BELOW;
        }
    }
}

/* Sets side[]: the active rows and the violated ones. Multipliers of the other rows that are only rounding errors
 * become 0. */
static void ipm_write_sides(solver_t *s)
{
    qp_t *qp = &s->qp;
    const real_t least = TOL_UNIT * SQRT(s->ipm.unit);
    for (int c = 0; c < NV + NG; c++) {
        const int member = qp->mult[c] < R(0) ? AT_LOWER : AT_UPPER;
        qp->side[c] = s->ipm.kind[c] == INEQUALITY ? INACTIVE : member;
    }
    ipm_write_active(s);
    ipm_write_others(s);
    for (int c = 0; c < NV + NG; c++) {
        const real_t reach = s->units.reach[c];
        if (qp->side[c] == INACTIVE && FABS(qp->mult[c]) * reach <= least && (c < NV || reach > R(0))) {
            qp->mult[c] = R(0);
        }
    }
    qp->relaxed = 0;
    for (int m = 0; m < NG; m++) {
        qp->relaxed += qp_is_violated(qp->side[NV + m]);
    }
}

/* Performs all computations that do not depend on dx_0. plain: the present factors are those without fixed controls and
 * without rows. */
static status_t ipm_prepare(solver_t *s, int plain)
{
    s->ipm.ready = 0;
    ipm_take_kinds(s);
    if (!ipm_first_factorization(s, plain)) {
        return NUMERICAL_FAILURE;
    }
    ipm_first_forces(s);
    ipm_first_backward(s);
    s->ipm.ready = 1;
    return OK;
}

/* Tests whether the first point is the solution: it satisfies all rows, once equations are exact and fixed controls
 * have their multipliers. Returns 1 if it does, or if the iterations for the equations fail. */
static int ipm_run_without_sides(solver_t *s, status_t *status)
{
    ipm_t *q = &s->ipm;
    const int equations = ipm_any(q, EQUATION);
    q->sides = 0;
    q->hard = 0;
    q->unit = R(0);
    if (q->damping > R(0) || (ipm_any_violation(s) && !equations)) {
        return 0;
    }
    if (!equations && !ipm_any(q, GIVEN_CONTROL)) {
        ipm_net_multipliers(s);
        return 1;
    }
    q->probing = 1;
    *status = ipm_iterate(s);
    q->probing = 0;
    (void)memcpy(q->origin, q->v, sizeof q->v);
    return *status != OK || !ipm_any_violation(s);
}

/* Solves from the first point. The products t lam start at twice the mean cost of the violations, or at a tenth of it
 * with the multipliers of the previous QP. */
static status_t ipm_run(solver_t *s)
{
    const ipm_t *q = &s->ipm;
    status_t status = OK;
    real_t mu;
    int count;
    if (ipm_run_without_sides(s, &status)) {
        return status;
    }
    mu = R(2) * ipm_violation_cost(s, &count);
    mu /= (real_t)((count > 0) ? count : 1);
    mu = (q->damping > mu) ? q->damping : mu;
    if (!IPM_CROSSOVER) {
        mu = q->warm ? FACTOR_IPM_WARM * mu : mu;
    }
    ipm_list_sides(s);
    ipm_start_sides(s, mu);
    return ipm_iterate(s);
}

/* Solves from the first factorisation and its backward substitution. */
static status_t ipm_attempt(solver_t *s)
{
    s->ipm.ready = 0;
    if (!ipm_near_point(s)) {
        return NUMERICAL_FAILURE;
    }
    if (ipm_constant_rows(s)) {
        return INFEASIBLE;
    }
    return ipm_run(s);
}

#if !IPM_CROSSOVER
/* Attempts to solve from the multipliers of the previous QP. If that has not converged after a quarter of the
 * iterations, a cold start replaces it. */
static status_t ipm_attempts(solver_t *s)
{
    ipm_t *q = &s->ipm;
    status_t status = ipm_attempt(s);
    if (q->warm && (status == ITERATION_LIMIT || status == NUMERICAL_FAILURE)) {
        q->warm = 0;
        status = ipm_prepare(s, 0);
        status = (status == OK) ? ipm_attempt(s) : status;
    }
    q->solved = status == OK;
    return status;
}

#else
static status_t ipm_attempts(solver_t *s)
{
    return ipm_attempt(s);
}

#endif
/* Adapts the first factorisation and its backward substitution to the present bounds. */
static status_t ipm_update(solver_t *s)
{
    if (ipm_take_kinds(s) || !s->ipm.ready) {
        return ipm_prepare(s, 0);
    }
    if (ipm_first_forces(s)) {
        ipm_first_backward(s);
    }
    return OK;
}

/* Sets the sides and checks the result, unless it only indicates a working set. Returns the final status. */
static status_t ipm_finish(solver_t *s, status_t status)
{
    ipm_write_sides(s);
    if (IPM_CROSSOVER) {
        if (s->ipm.crossing == HANDED_OVER) {
            return status;
        }
    }
    if (status == OK && !ipm_is_solution(s)) {
        status = ITERATION_LIMIT;
    }
    if (status == NUMERICAL_FAILURE) {
        qp_clear_results(&s->qp);
    }
    return status;
}

/* Solves the QP for dx_0 and the present bounds. */
static status_t ipm_solve(solver_t *s)
{
    ipm_t *q = &s->ipm;
    status_t status = qp_check_bounds(&s->qp);
    if (!IPM_CROSSOVER) {
        q->warm = q->solved;
        q->solved = 0;
        (void)memcpy(q->before, s->qp.mult, sizeof q->before);
    }
    s->qp.iterations = 0;
    status = (status == OK) ? ipm_update(s) : status;
    if (status != OK) {
        q->ready = 0;
        qp_clear_results(&s->qp);
        return status;
    }
    return ipm_finish(s, ipm_attempts(s));
}

/* Continues after an iterate that indicates a working set, with x and z of that iterate. */
static status_t ipm_resume(solver_t *s)
{
    ipm_take_kinds(s);
    (void)memset(s->riccati.du, 0, sizeof s->riccati.du);
    ipm_gaps(s);
    return ipm_finish(s, ipm_iterate(s));
}
