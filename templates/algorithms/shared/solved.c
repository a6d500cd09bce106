/* Decides whether the plan of solve() is shifted. A sample at the state of solve(), up to rounding, is at the same time
 * and takes the plan as it is. Otherwise time has passed, and the plan is shifted as after a sample. */
static void compare_solved(solver_t *s, const real_t *xhat)
{
#if NODES
    const real_t *at = s->xhat;
#else
    const real_t *at = s->x[0];
#endif
    for (int i = 0; i < NXHAT; i++) {
        if (!ALL_MEASURED) {
            if (is_accumulator[i]) {
                continue;
            }
        }
        if (NF > 0) {
            if (!is_measured[i]) {
                continue;
            }
        }
        if (!(FABS(xhat[i] - at[i]) <= TOL_ROUNDING * (z_scale[i] + FABS(at[i])))) {
            s->solved = 0;
        }
    }
}
