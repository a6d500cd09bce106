/* ---------------------------------------------------------------------------------------------------------------------
 * qp: active-set method on the Riccati recursion
 *
 *     min  sum_{k<N} 1/2 z_k'Q_k z_k + g_k'z_k  +  1/2 x_N'Q_N x_N + g_N'x_N,   z = (x, u)
 *     s.t. x_{k+1} = S_k z_k + b_k,   dx_0 given,   lower <= (u, rows) <= upper
 *
 * Contract
 *   qp_init       once: all data zero, all bounds and penalties infinite, empty working set.
 *   qp_factorize  preparation: all data but x_0 are known; lower and upper hold a prediction. Runs the recursion
 *                 for the predicted working set.
 *   qp_gradient   called if gradients of the stages have changed, but no matrix.
 *   qp_solve      feedback: dx_0 in step.dx[0], bounds and penalties are known.
 *                 Writes x, z, mult, iterations, changes, relaxed. Returns OK; ITERATION_LIMIT;
 *                 STALLED if a working set repeats itself; INFEASIBLE; NUMERICAL_FAILURE with x = z = mult = 0.
 *   qp_shift_controls  called before qp_factorize: shifts the predicted working set by n controls
 *   qp_shift_rows      the same of its rows, as given by source[]
 * Bounds may be infinite; equal bounds are an equation. side[] is the working set and is kept for the warm start; the
 * caller may change it before qp_factorize.
 *
 * Method: one Riccati recursion gives the minimiser on the working set. Controls in the working set are eliminated. A
 * small number of rows is treated by their Schur complement; where this does not lead to a solution, rows in the
 * working set are treated by the method of multipliers, which requires no decision on their rank. Then
 * every side is updated from the values and the signs of the multipliers (primal-dual active set; Hintermueller, Ito,
 * Kunisch 2003). The recursion is repeated from the last stage with a change down to stage 0.
 * ------------------------------------------------------------------------------------------------------------------ */

#include "riccati/kernel.c"

#include "qp/stage_qp.c"

#include "qp/stage_check.c"

#include "qp/riccati_active_set_working_set.c"

#include "qp/riccati_active_set_refine.c"

#include "qp/riccati_active_set_complement.c"

#include "qp/riccati_active_set_iterate.c"

#include "riccati/units.c"

#include "qp/riccati_active_set_start.c"

/* State of the factors: none; up to date; valid matrices, but factors of another working set. */
enum { FACTORS_NONE = 0, FACTORS_READY = 1, FACTORS_OTHER = 2 };

#if INTERIOR_POINT
#include "qp/riccati_interior_point_core.c"

#include "qp/riccati_active_set_fall_back.c"
#else
#include "qp/riccati_active_set_start_again.c"
#endif

static status_t qp_fail(qp_t *q, status_t status)
{
    qp_clear_results(q);
    q->factorized = q->factorized ? FACTORS_OTHER : FACTORS_NONE;
    return status;
}

static void qp_init(solver_t *s)
{
    qp_clear(&s->qp);
    riccati_init(s);
    s->riccati.regularize = 1;
    (void)memset(&s->schur, 0, sizeof s->schur);
    for (int m = 0; m < NG; m++) {
        s->qp.root[m] = R(1);
    }
}

/* Returns the last stage with a member of the working set, or -1. The factors of later stages are those without
 * members. */
static int qp_last_member(const qp_t *q)
{
    int last = -1;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            last = (q->side[k * NU + j] != INACTIVE) ? k : last;
        }
    }
    return last;
}

/* Returns the last stage with a row that has a weight, or `last` if that is later. */
static int qp_last_weight(const solver_t *s, int last)
{
    int found = last; /* -1 <= found <= N */
    for (int m = 0; m < NG; m++) {
        const int k = row_node(m);
        found = (s->riccati.weight[m] > R(0) && k > found) ? k : found;
    }
    return found;
}

static status_t qp_factorize(solver_t *s)
{
    qp_t *q = &s->qp;
    int plain = 0;
    if (REGULARIZE_REDUCED) {
        plain = riccati_convexify(s);
    }
    if (NG) {
        if (q->scaled == SCALES_NONE) {
            qp_scale_rows(s);
        } else {
            q->scaled = SCALES_EARLIER;
        }
        schur_begin(s);
    }
    qp_enter(s);
    if (REGULARIZE_REDUCED) {
        q->stale = plain ? qp_last_member(q) : N;
        if (NG) {
            q->stale = qp_last_weight(s, q->stale);
        }
    }
    if (NG) {
        if (s->schur.active && !(qp_renew(s) && s->schur.applies)) {
            qp_dissolve(s);
        }
    }
    if (!qp_renew(s)) { /* weights and working set may belong to a QP with other scales */
        qp_start_empty(s);
        if (!qp_renew(s)) {
            if (INTERIOR_POINT) {
                q->factorized = FACTORS_OTHER; /* the interior point method can regularise more */
                return OK;
            } else {
                q->factorized = FACTORS_NONE;
                return qp_fail(q, NUMERICAL_FAILURE);
            }
        }
    }
    q->factorized = FACTORS_READY;
    return OK;
}

static void qp_gradient(solver_t *s)
{
    s->qp.stale_vectors = N;
}

/* Returns 1 if all multipliers are finite. Invalid data of a fixed control appear only in its multiplier. */
static int qp_has_multipliers(const qp_t *q)
{
    real_t sum = R(0);
    for (int c = 0; c < NV + NG; c++) {
        sum += FABS(q->mult[c]);
    }
    return isfinite(sum);
}

/* Returns 1 if the last minimiser was refined with the scales of an earlier QP, to a residual that may be rounding. */
static int qp_needs_scales(const qp_t *q)
{
    return q->scaled != SCALES_OWN && q->refined && q->residual <= TOL_RICCATI_ROUNDING;
}

/* Iterates with rows as equations. If that fails, members have weights from now on. */
static status_t qp_settle_with_complement(solver_t *s)
{
    const status_t status = qp_settle(s, QP_MAX_POLISH);
    if (status != OK) {
        qp_dissolve(s);
    }
    return status;
}

/* Iterates from the present working set with the scales of this QP. */
static status_t qp_settle_in_own_scales(solver_t *s)
{
    qp_scale_rows(s);
    qp_enter(s);
    return qp_settle(s, QP_MAX_POLISH);
}

/* Iterates from the predicted working set, and falls back if that fails. */
static status_t qp_search(solver_t *s)
{
    qp_t *q = &s->qp;
    status_t status;
    q->exact = 1;
    if (NG) {
        status = s->schur.active ? qp_settle_with_complement(s) : STALLED;
        if (status != OK) {
            status = qp_settle(s, QP_MAX_ITERATIONS);
        }
    } else {
        status = qp_settle(s, QP_MAX_ITERATIONS);
    }
    if (NG) {
        if (status == STALLED && qp_needs_scales(q)) {
            status = qp_settle_in_own_scales(s);
        }
    }
    if (status != OK) { /* a numerical failure that persists: unbounded QP or invalid data */
        const status_t next = qp_fall_back(s);
        status = (status == NUMERICAL_FAILURE && next == ITERATION_LIMIT) ? status : next;
        status = qp_has_multipliers(q) ? status : NUMERICAL_FAILURE;
    }
    return status;
}

static status_t qp_solve(solver_t *s)
{
    qp_t *q = &s->qp;
    status_t status = q->factorized ? qp_check_bounds(q) : NUMERICAL_FAILURE;
    q->iterations = 0;
    q->changes = 0;
    q->refinements = 0;
    q->dropped = 0;
    q->relaxed = 0;
    q->exact = 0;
    (void)memset(q->certificate, 0, sizeof q->certificate);
    if (status != OK) {
        return qp_fail(q, status);
    }
    if (q->factorized == FACTORS_OTHER) {
        qp_enter(s);
        q->factorized = FACTORS_READY;
    }
    qp_take_bounds(s);
    q->changes = 0;
    status = qp_search(s);
    return status == NUMERICAL_FAILURE ? qp_fail(q, status) : status;
}

#include "qp/shift_on_stages.c"
