/* What a step leaves of the model. Gaps grow with the square of a step: one that is about as long as those of late
 * leaves about what they did, and their linearisations have told that. After any other step the intervals are
 * integrated. */

static void gaps_on_reset(solver_t *s)
{
    memset(&s->gaps, 0, sizeof s->gaps);
}

/* The residual of the plan that has been linearised is what the last step has left. */
static status_t gaps_after_prepare(solver_t *s, status_t status)
{
    gaps_t *gaps = &s->gaps;
    if (LEVELS && s->levels.last == LEVEL_D) { /* which follows what the QP believes */
        memset(gaps, 0, sizeof *gaps);
        return status;
    }
    gaps->left *= R(0.5);
    gaps->longest *= R(0.5);
    enlarge(&gaps->left, is_far(s->stats.residual) ? residual_tolerance[0] : s->stats.residual);
    enlarge(&gaps->longest, gaps->length);
    return status;
}

/* Length of the step of the QP, which is finite: the largest component of dx_0 and the du_k in the scale of its
 * variable, which cause all others. */
static real_t length_of_step(const solver_t *s)
{
    real_t size[NZ] = {R(0)}, length = R(0);
    enlarge_all(size, s->step.dx[0], NX);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t a = FABS(s->step.du[k][j]);
            size[NX + j] = (a > size[NX + j]) ? a : size[NX + j];
        }
    }
    for (int i = 0; i < NZ; i++) {
        const real_t a = size[i] / z_scale[i];
        length = (a > length) ? a : length;
    }
    return length;
}

/* Returns 1 if a step of this length leaves little by all that is known. */
static int leaves_little(const gaps_t *gaps, real_t length)
{
    if (length <= FACTOR_GAP_SHORT_STEP) {
        return 1;
    }
    if (!(length <= R(2) * gaps->longest)) {
        return 0;
    }
    const real_t ratio = (length > gaps->longest) ? length / gaps->longest : R(1);
    return gaps->left * ratio * ratio <= FACTOR_GAP_TRUSTED * residual_tolerance[0];
}

static status_t gaps_after_feedback(solver_t *s, status_t status)
{
    s->gaps.length = R(0);
    if (status == OK) {
        s->gaps.length = length_of_step(s);
        if (!leaves_little(&s->gaps, s->gaps.length)) {
            real_t size[NX];
            state_scales(s, size);
            enlarge(&s->stats.residual, largest_gap(s, size));
        }
    }
    return status;
}
