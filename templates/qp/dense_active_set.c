/* ---------------------------------------------------------------------------------------------------------------------
 * qp: dense dual active-set method
 *
 *     min  1/2 z'H z + g'z   s.t.   lower[i] <= z_i <= upper[i],  i < NV;
 *                                   lower[NV+j] <= A[j] z <= upper[NV+j],  j < NG
 *
 *     H z + g + mult[0..NV) + A' mult[NV..NV+NG) = 0,   mult > 0 at an upper bound, < 0 at a lower one, 0 in between
 *
 * Contract
 *   qp_init       once: all data zero, all bounds and penalties infinite, empty working set.
 *   qp_factorize  preparation: H (lower triangle) and A are known, lower and upper hold a prediction. Overwrites H.
 *                 Returns OK, or NUMERICAL_FAILURE if H is not positive semidefinite or data are not finite.
 *   qp_solve      feedback: g, bounds and penalties are known.
 *                 Writes z, mult, iterations, changes, dropped, relaxed.
 *                 Returns OK; ITERATION_LIMIT, STALLED (a working set repeats itself, or rounding decides whether rows
 *                 contradict one another) or INFEASIBLE with z the last iterate, or 0 if bounds cross;
 *                 NUMERICAL_FAILURE (data not finite, cost unbounded below) with z = mult = 0.
 *   qp_shift_controls  called before qp_factorize: shifts the predicted working set by n controls
 *   qp_shift_rows      the same of its rows, as given by source[]
 *
 * Bounds may be infinite; equal bounds are an equality. Redundant consistent equalities get the multiplier 0; `dropped`
 * is their number. Crossed bounds are INFEASIBLE. side[] is the working set (+-1: member at its upper or lower bound)
 * and is kept for the warm start; the caller may change it before qp_factorize. Between qp_solve and qp_factorize the
 * caller may use all of `work`. A has zeros in columns up to LDH. The upper triangle of H is not read.
 *
 * Method (Goldfarb and Idnani 1983) in the coordinates y = C'z, where H = C C' and C is lower triangular. In them the
 * cost is 1/2 |y - y0|^2 with y0 = -C^{-1} g, and row a is m'y with m = C^{-1} a. The nw rows of the working set W are
 * stored as M_W' = Q'R: R is upper triangular, the rows of Q are orthonormal (Daniel, Gragg, Kaufman and Stewart 1976).
 * With t the active bounds, the minimiser on W is
 *
 *     R'w = t,   c = Q y0 - w,   y = y0 - Q'c,   lam = R^{-1} c,   z = C^{-T} y
 *
 * If a pivot of H may be zero, H + E is factorised, where E is diagonal with E_ii > 0 at such pivots only, and the
 * proximal point method iterates to the minimiser for H itself.
 *
 * Storage: H holds D on its diagonal, L below and L' above it, C = L D^{1/2}, L unit lower triangular. R is stored
 * transposed (row j: coefficients of member j). Loops run over panels of four, for which every vector and matrix is
 * padded with zeros.
 * ------------------------------------------------------------------------------------------------------------------ */

#include "qp/dense_linear_algebra.c"

#include "qp/dense_active_set_factors.c"

#include "qp/dense_active_set_working_set.c"

#include "qp/dense_active_set_iterate.c"

#include "qp/dense_active_set_proximal.c"

#include "qp/dense_active_set_check.c"

static void qp_init(qp_t *q)
{
    (void)memset(q, 0, sizeof *q);
    for (int c = 0; c < NV + NG; ++c) {
        q->lower[c] = -INF;
        q->upper[c] = INF;
        q->penalty[c] = INF;
    }
}

/* Adds the predicted members to the working set, either the equalities or the inequalities; again: only equalities that
 * are not in it yet. Returns the number of rows that it leaves out, or -1 if one is not finite. */
static int qp_predict(qp_t *q, int equality, int again, real_t fraction)
{
    int waiting = 0;
    for (int c = 0; c < NV + NG; ++c) {
        if (NSL) {
            if (qp_is_slack(c)) {
                continue;
            }
        }
        if (qp_is_equality(q, c) == equality && (qp_is_member(q, c) ? !again : equality && q->side[c] == INACTIVE)) {
            if (!qp_predict_active(q, c, fraction)) {
                return -1;
            }
            waiting += q->side[c] == INACTIVE;
        }
    }
    return waiting;
}

/* Factorises H and the predicted working set: equalities first, then the inequalities that are members. Equalities that
 * nearly depend on others are added last. If they still do, they are left out until they are violated. This keeps the
 * condition number of R small. */
static status_t qp_factorize(qp_t *q)
{
    const real_t least = FACTOR_DENSE_INDEPENDENT * SQRT(TOL_UNIT);
    status_t status = qp_factorize_hessian(q);
    clear(q->R_inverse);
    q->nw = 0;
    if (NSL) {
        qp_fix_slacks(q);
    }
    if (status == OK) {
        real_t fraction = R(0.5);
        int waiting = qp_predict(q, 1, 0, fraction);
        while (waiting > 0 && fraction > least) { /* at most 5 passes */
            fraction = fraction * fraction > least ? fraction * fraction : least;
            waiting = qp_predict(q, 1, 1, fraction);
        }
        if (waiting < 0 || qp_predict(q, 0, 0, TOL_QP_DEPENDENT_PREDICTION) < 0) {
            status = NUMERICAL_FAILURE;
        }
    }
    q->factorized = status == OK;
    return q->factorized ? OK : qp_fail(q, status);
}

/* Solves the QP. An answer that is not accepted is computed again with a smaller tolerance for rounding errors. The
 * rows contradict one another if both attempts with a smaller tolerance prove it; if only one of them does, rounding
 * decides, and the QP is given up. */
static status_t qp_solve(qp_t *q)
{
    int proofs = 0;
    status_t status = q->factorized ? qp_take_bounds(q) : NUMERICAL_FAILURE;
    q->iterations = 0;
    q->searches = 0;
    q->proximal_steps = 0;
    q->changes = 0;
    if (status != OK) {
        return qp_fail(q, status);
    }
    for (q->strict = 0; q->strict < 3; ++q->strict) { /* at most 3 passes */
        status = q->semidefinite ? qp_iterate_proximal(q) : qp_iterate(q);
        if (status == OK && qp_accept(q)) {
            return OK;
        }
        proofs += status == INFEASIBLE;
        if (status != OK && (!q->strict || proofs == 2)) {
            return status != NUMERICAL_FAILURE && qp_write_result(q) ? status : qp_fail(q, NUMERICAL_FAILURE);
        }
    }
    return (proofs > 0 && qp_write_result(q)) ? STALLED : qp_fail(q, NUMERICAL_FAILURE);
}

#include "qp/dense_active_set_shift.c"
