/* Computes the control to return if there is no new one: that of the plan or, if it is not finite, its reference,
 * clipped to the bounds. */
static void safe_control(const solver_t *s, real_t *u0)
{
    for (int j = 0; j < NU; j++) {
        u0[j] = safe_value(s, 0, j);
    }
}

#if PULLED_ROWS
#include "algorithms/shared/pull_back.c"
#endif

/* Ends a call. */
static status_t finish(solver_t *s, status_t status)
{
    if (IMPLICIT) {
        name_failed_stage(s, status);
    }
    s->newton = NEWTON_LIMIT; /* outside samples, stages are solved to rounding errors */
    s->status = (int32_t)status;
    return status;
}
