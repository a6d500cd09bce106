/* Primal-dual interior point method of Mehrotra (1992) on the stages of the QP, with the Riccati recursion as its linear algebra.
 *
 *     min  sum_k 1/2 z_k'Q_k z_k + g_k'z_k + sum_soft (l1_c e_c + l2_c/2 e_c^2)   s.t.   x_{k+1} = S_k z_k + b_k,
 *          bound_i - sign_i v_i + e_i = t_i >= 0  for every finite side i of a row,   v_c = B_c  for an equation
 *
 * A step solves for the directions of t, lam (and of e, kappa of a soft side) row by row, so that only the weights of the rows
 * enter the recursion; equations have the weight of a small compliance and are met by corrections of their multipliers.
 */

#include "qp/riccati_interior_point_rows.c"

#include "qp/riccati_interior_point_start.c"

#include "qp/riccati_interior_point_certificate.c"

#include "qp/riccati_interior_point_iterate.c"

/* Results that say nothing. */
static void ipm_clear(solver_t *s)
{
    memset(s->qp.x, 0, sizeof s->qp.x);
    memset(s->qp.z, 0, sizeof s->qp.z);
    memset(s->qp.mult, 0, sizeof s->qp.mult);
    memset(s->qp.side, 0, sizeof s->qp.side);
    memset(s->qp.certificate, 0, sizeof s->qp.certificate);
    s->qp.relaxed = 0;
}

/* side: rows whose multiplier is larger than what their distance to the bound would cost; +-2: soft ones that are violated.
 * Multipliers of the others that are only rounding become 0. */
static void ipm_write_sides(solver_t *s)
{
    ipm_t *q = &s->ipm;
    const real_t least = TOL_UNIT * SQRT(q->unit);
    int i, c;
    s->qp.relaxed = 0;
    for (c = 0; c < NV + NG; c++) {
        s->qp.side[c] = (q->kind[c] == 0) ? 0 : (s->qp.mult[c] < R(0)) ? -1 : 1;
    }
    for (i = 0; i < q->sides; i++) {
        const real_t square = s->units.reach[q->row[i]] * s->units.reach[q->row[i]];
        if (q->lam[i] * square > q->t[i]) {
            const int violated = i >= q->hard && q->e[i - q->hard] > q->kappa[i - q->hard] * square;
            s->qp.side[q->row[i]] = (q->sign[i] > R(0) ? 1 : -1) * (violated ? 2 : 1);
            s->qp.relaxed += violated;
        }
    }
    for (c = 0; c < NV + NG; c++) {
#if NG
        if (c >= NV && !(s->units.reach[c] > R(0))) {
            const real_t mult = ipm_constant_multiplier(s, c);
            s->qp.side[c] = (mult > R(0)) ? 2 : (mult < R(0)) ? -2 : s->qp.side[c];
            s->qp.relaxed += s->qp.side[c] == 2 || s->qp.side[c] == -2;
            continue;
        }
#endif
        if (s->qp.side[c] == 0 && FABS(s->qp.mult[c]) * s->units.reach[c] <= least) {
            s->qp.mult[c] = R(0);
        }
    }
}

/* Everything that does not depend on dx_0. plain: the factors at hand are those without given controls and without rows. */
static status_t ipm_prepare(solver_t *s, int plain)
{
    s->ipm.ready = 0;
    (void)ipm_take_kinds(s);
    if (!ipm_first_factorization(s, plain)) {
        return NUMERICAL_FAILURE;
    }
    (void)ipm_first_forces(s);
    ipm_first_backward(s);
    s->ipm.ready = 1;
    return OK;
}

/* The first point is the solution if it meets all rows, once equations are exact and fixed controls have their multipliers.
 * Returns 1 if it is, or if something is wrong with the equations. */
static int ipm_run_without_sides(solver_t *s, status_t *status)
{
    ipm_t *q = &s->ipm;
    q->sides = q->hard = 0;
    q->unit = R(0);
    if (q->damping > R(0) || (ipm_any_violation(s) && !ipm_any(q, 1))) {
        return 0;
    }
    if (!ipm_any(q, 1) && !ipm_any(q, 2)) {
        ipm_net_multipliers(s);
        return 1;
    }
    q->probing = 1;
    *status = ipm_iterate(s);
    q->probing = 0;
    memcpy(q->origin, q->v, sizeof q->v);
    return *status != OK || !ipm_any_violation(s);
}

/* The first point is known. Products t lam start at twice the mean cost of the violations, with the multipliers of the QP before
 * at a tenth of it. */
static status_t ipm_run(solver_t *s)
{
    ipm_t *q = &s->ipm;
    status_t status = OK;
    real_t cost, mu;
    int count;
    if (ipm_run_without_sides(s, &status)) {
        return status;
    }
    cost = ipm_violation_cost(s, &count);
    mu = R(2) * cost / (real_t)((count > 0) ? count : 1);
    mu = (q->damping > mu) ? q->damping : mu;
    ipm_list_sides(s);
    ipm_start_sides(s, q->warm ? R(0.1) * mu : mu, cost);
    return ipm_iterate(s);
}

/* From the first factorisation and its backward substitution to the solution. */
static status_t ipm_attempt(solver_t *s)
{
    s->ipm.ready = 0;
    if (!ipm_first_point(s)) {
        return NUMERICAL_FAILURE;
    }
#if NG
    if (ipm_constant_rows(s)) {
        return INFEASIBLE;
    }
#endif
    return ipm_run(s);
}

/* The solution for dx_0 and the present bounds. A warm start that does not get there by half the cap is given up for a cold one. */
static status_t ipm_solve(solver_t *s)
{
    ipm_t *q = &s->ipm;
    status_t status = ipm_check_bounds(s);
    q->warm = IPM_WARM_START && q->solved;
    memcpy(q->before, s->qp.mult, sizeof q->before);
    s->qp.iterations = q->solved = 0;
    if (status == OK) {
        if (ipm_take_kinds(s) || !q->ready) {
            status = ipm_prepare(s, 0);
        } else if (ipm_first_forces(s)) {
            ipm_first_backward(s);
        }
    }
    if (status == OK) {
        status = ipm_attempt(s);
        if (q->warm && (status == ITERATION_LIMIT || status == NUMERICAL_FAILURE)) {
            q->warm = 0;
            status = ipm_prepare(s, 0);
            status = (status == OK) ? ipm_attempt(s) : status;
        }
        q->solved = status == OK;
        ipm_write_sides(s);
    } else {
        q->ready = 0;
        ipm_clear(s);
    }
    if (status == NUMERICAL_FAILURE) {
        ipm_clear(s);
    }
    return status;
}
