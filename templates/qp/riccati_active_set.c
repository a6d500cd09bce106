/* ---------------------------------------------------------------------------------------------------------------------
 * qp: active set on the Riccati recursion
 *
 *     min  sum_{k<NS} 1/2 z_k'Q_k z_k + g_k'z_k  +  1/2 x_NS'Q_NS x_NS + g_NS'x_NS,   x_{k+1} = S_k z_k + b_k,   dx_0 given
 *     s.t. lower <= (u, rows) <= upper
 *
 * Contract of the seam
 *   qp_init       once: everything zero, all bounds and penalties infinite, empty working set.
 *   qp_factorize  preparation: all but x_0 is known, lower and upper hold a prediction. Recursion at the predicted working set.
 *   qp_gradient   gradients of the stages changed, matrices did not.
 *   qp_solve      feedback: dx_0 in step.dx[0], lower, upper, penalty are known. Writes x, z, mult, iterations, changes, relaxed.
 *                 OK; ITERATION_LIMIT, STALLED (a working set came back), INFEASIBLE; NUMERICAL_FAILURE: x = z = mult = 0.
 *   qp_shift_controls, qp_shift_rows  before qp_factorize: the prediction moves n controls towards the front, and rows as told.
 * Bounds may be infinite; equality = equal bounds. Soft rows (penalty finite) cost penalty v + curvature / 2 v^2 for a
 * violation v; how many are violated is counted in relaxed.
 * side[] is the working set and stays for the warm start; a caller may edit it before qp_factorize.
 *
 * Method: the minimiser on the working set by one Riccati recursion: given controls are eliminated, members that are rows enter
 * by the method of multipliers, which needs no decision about their rank. Then every side anew from values and signs of
 * multipliers (primal-dual active set; Hintermueller, Ito, Kunisch 2003); the recursion is repeated from the last stage that
 * changed down to 0.
 * ------------------------------------------------------------------------------------------------------------------ */

#include "riccati/kernel.c"

#include "qp/stage_qp.c"

#include "qp/riccati_active_set_working_set.c"

#include "qp/riccati_active_set_refine.c"

#include "qp/riccati_active_set_iterate.c"

#include "riccati/units.c"

#include "qp/riccati_active_set_start.c"

/* What stands of the recursion: nothing; all of it; the matrices that it is made of. */
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
#if NG
    for (int m = 0; m < NG; m++) {
        s->qp.root[m] = R(1);
    }
#endif
}

#if REGULARIZE_REDUCED
/* The last stage with a member, or -1: later factors are those without members. */
static int qp_last_member(const qp_t *q)
{
    int last = -1;
    for (int k = 0; k < NS; k++) {
        for (int j = 0; j < NUS; j++) {
            last = (q->side[k * NUS + j] != INACTIVE) ? k : last;
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        const int k = stage_of_row[m];
        last = (q->side[NV + m] != INACTIVE && k > last) ? k : last;
    }
#endif
    return last;
}

#endif
static status_t qp_factorize(solver_t *s)
{
    qp_t *q = &s->qp;
#if REGULARIZE_REDUCED
    const int plain = riccati_convexify(s);
#endif
#if NG
    if (!q->scaled) {
        qp_scale_rows(s);
    }
#endif
    qp_enter(s);
#if REGULARIZE_REDUCED
    q->stale = plain ? qp_last_member(q) : NS;
#endif
    if (!qp_renew(s)) { /* weights and members may be those of a QP in other units */
        qp_start_empty(s);
        if (!qp_renew(s)) {
            q->factorized = FACTORS_NONE;
            return qp_fail(q, NUMERICAL_FAILURE);
        }
    }
    q->factorized = FACTORS_READY;
    return OK;
}

#if SET_REFERENCE || SOLVE
static void qp_gradient(solver_t *s)
{
    s->qp.stale_vectors = NS;
}

#endif
/* 1 if all multipliers are finite: data of a control that is given enter nothing else. */
static int qp_has_multipliers(const qp_t *q)
{
    real_t sum = R(0);
    for (int c = 0; c < NV + NG; c++) {
        sum += FABS(q->mult[c]);
    }
    return isfinite(sum);
}

/* Working sets from the predicted one, then what else there is to try. */
static status_t qp_search(solver_t *s)
{
    qp_t *q = &s->qp;
    q->exact = 1;
    status_t status = qp_iterate(s, QP_MAX_ITERATIONS);
    if (status != OK) { /* a breakdown that another attempt does not cure: no minimum, or bad numbers */
        const status_t next = qp_fall_back(s);
        status = (status == NUMERICAL_FAILURE && next == ITERATION_LIMIT) ? status : next;
        status = qp_has_multipliers(q) ? status : NUMERICAL_FAILURE;
    }
    if (q->exact && status == OK) {
        qp_finish(q);
    }
    return status;
}

static status_t qp_solve(solver_t *s)
{
    qp_t *q = &s->qp;
    status_t status = q->factorized ? qp_check_bounds(q) : NUMERICAL_FAILURE;
    q->iterations = q->changes = q->refinements = q->dropped = q->relaxed = q->exact = 0;
#if INTERIOR_POINT && NG
    memset(q->certificate, 0, sizeof q->certificate);
#endif
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

#if !SHIFT_RESAMPLE
#include "qp/shift_on_stages.c"
#endif
