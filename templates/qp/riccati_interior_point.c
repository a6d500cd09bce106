/* ---------------------------------------------------------------------------------------------------------------------
 * qp: Riccati interior point method
 *
 * Contract
 *   qp_init       once: no bounds, no prediction.
 *   qp_factorize  preparation: matrices are known, lower and upper hold a prediction. Returns OK or NUMERICAL_FAILURE.
 *   qp_gradient   called if gradients or gaps have changed, but no matrix.
 *   qp_solve      feedback: dx_0 in step.dx[0], present bounds and penalties.
 *                 Writes x, z, mult, side, iterations, relaxed. Returns OK; ITERATION_LIMIT; INFEASIBLE;
 *                 NUMERICAL_FAILURE.
 *   qp_shift_controls  shifts the warm start by n controls
 *   qp_shift_rows      the same of its rows, as given by source[]
 * ------------------------------------------------------------------------------------------------------------------ */

#include "riccati/recursion.c"

#include "qp/stage_qp.c"

#include "qp/stage_check.c"

#include "riccati/units.c"

#include "qp/riccati_interior_point_core.c"

static void qp_init(solver_t *s)
{
    qp_clear(&s->qp);
    riccati_init(s);
    (void)memset(&s->ipm, 0, sizeof s->ipm);
    (void)memset(&s->units, 0, sizeof s->units);
}

#if REGULARIZE_REDUCED
static status_t qp_factorize(solver_t *s)
{
    return ipm_prepare(s, riccati_convexify(s));
}
#else
static status_t qp_factorize(solver_t *s)
{
    return ipm_prepare(s, 0);
}
#endif

static void qp_gradient(solver_t *s)
{
    if (s->ipm.ready) {
        ipm_first_backward(s);
    }
}

static status_t qp_solve(solver_t *s)
{
    return ipm_solve(s);
}

#include "qp/shift_on_stages.c"
