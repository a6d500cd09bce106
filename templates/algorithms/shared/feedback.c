status_t API(feedback)(solver_t *s, const real_t xhat[NXHAT], real_t u0[NU])
{
    status_t status;
    int measured, broken;
    if (s->magic != MAGIC) {
        for (int j = 0; j < NU; j++) { /* not by memcpy: GCC 12 with AVX-512 */
            u0[j] = default_control[j];
        }
        return NOT_INITIALIZED;
    }
    s->newton = NEWTON;
    measured = take_state(s, xhat);
    broken = s->prepared && s->status != OK;
    if (HAS_QP) {
        forget_violation(s);
    }
    if (!s->prepared) {
        status = NOT_PREPARED;
    } else if (!measured) {
        status = NOT_FINITE;
    } else if (broken) {
        status = (status_t)s->status;
    } else {
        status = feedback_here(s);
    }
    if (!HAS_QP && s->prepared && status != OK) {
        restore_multipliers(s);
        if (!all_finite(s->lam[0], (N + 1) * NX)) {
            forget_multipliers(s);
        }
    }
    status = judge(s, status);
    s->prepared = 0;
    s->samples += (s->samples < MANY);
    safe_control(s, u0);
    if (PULLED_ROWS) {
        pull_control_back(s, u0);
    }
    if (AUGMENTED) {
        keep_sample(s, u0);
    }
    watch(s, status, broken);
    return finish(s, status);
}

#if SOLVE && SHIFT
#include "algorithms/shared/solved.c"
#endif

/* Prepares and feeds back. If prepare fails, feedback returns its status. */
status_t API(step)(solver_t *s, const real_t xhat[NXHAT], real_t u0[NU])
{
    if (SOLVE && SHIFT) {
        if (s->magic == MAGIC) {
            compare_solved(s, xhat);
        }
    }
    before_sample(s, xhat);
    (void)API(prepare)(s);
    return API(feedback)(s, xhat, u0);
}
