/* Distance of the plan of a sample from a solution. A step leaves gaps, and a gradient of the Lagrangian, that grow
 * with its square, so that a step about as long as recent ones leaves about what they left. After any longer step the
 * plan is linearised again, which measures both. */

static void nearness_on_reset(solver_t *s)
{
    (void)memset(&s->near, 0, sizeof s->near);
}

/* Requires a linearisation at regular intervals, which also measures optimality, however short the steps are. */
static void doubt_plan(solver_t *s)
{
    s->near.doubted = 0;
    if (s->samples % CHECKED == 0) {
        real_t measured[NX];
        measure_plan(s, measured);
        s->near.doubted = !kkt_is_within(s, residual_tolerance[0]);
        (void)memcpy(s->xhat, measured, sizeof s->xhat);
    }
}

/* Records the gaps of the linearised plan as those that the last step has left. */
static status_t nearness_after_prepare(solver_t *s, status_t status)
{
    near_t *near = &s->near;
    near->left *= R(0.5);
    near->longest *= R(0.5);
    enlarge(&near->left, is_far(s->stats.residual) ? residual_tolerance[0] : s->stats.residual);
    enlarge(&near->longest, near->length);
    if (HARD_ROWS) {
        enlarge(&near->left, rows_left(s) / FACTOR_NEAR_ROWS);
    }
    if (status == OK) {
        doubt_plan(s);
    }
    return status;
}

/* Returns the length of the step of the QP, which is finite: the largest component of dx_0 and the du_k in the scale of
 * its variable, which cause all others. */
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

/* Returns 1 if a step of this length is predicted to leave small residuals. The first steps also close gaps. */
static int leaves_little(const near_t *near, real_t length)
{
    if (length <= FACTOR_NEAR_SHORT_STEP) {
        return near->longest > R(0) || near->left <= FACTOR_NEAR_TRUSTED * residual_tolerance[0];
    }
    if (!(length <= R(2) * near->longest)) {
        return 0;
    }
    const real_t ratio = (length > near->longest) ? length / near->longest : R(1);
    return near->left * ratio * ratio <= FACTOR_NEAR_TRUSTED * residual_tolerance[0];
}

/* Saves the plan before a step with an unknown outcome, which may have to be undone. */
static void nearness_before_step(solver_t *s, status_t status)
{
    s->near.length = length_of_step(s);
    s->near.trusted =
        status == OK && !is_far(s->stats.residual) && leaves_little(&s->near, s->near.length) && !s->near.doubted;
    if (ITERATES) {
        if (!s->near.trusted) {
            keep_plan(s);
            s->near.slope = slope_of(s);
            (void)memset(&s->sqp, 0, sizeof s->sqp);
            update_scales(s);
        }
    }
}

/* Returns the largest gap of the linearised plan relative to the range of its state along the horizon. What a step
 * leaves matters where that range is not far larger, whatever the operating point. */
static real_t gaps_in_motion(const solver_t *s)
{
    real_t most = R(0);
    for (int i = 0; i < NX; i++) {
        real_t moved = FACTOR_SCALE_LITTLE_OF_STATE * z_scale[i], gap = R(0);
        for (int k = 0; k < N; k++) {
            enlarge(&moved, s->x[k + 1][i] - s->x[0][i]);
            enlarge(&gap, s->node[k].b[i]);
        }
        enlarge(&most, gap / moved);
    }
    return most;
}

/* Measures the plan after a step with an unknown outcome: the largest of its gaps, of its violations of hard rows, and
 * of its relative KKT residual. */
static status_t nearness_after_feedback(solver_t *s, status_t status)
{
    if ((status != OK && status != RELAXED) || s->near.trusted) {
        return status;
    }
    linearize(s);
    measure_residual(s);
    enlarge(&s->near.left, s->stats.residual);
    enlarge(&s->near.left, gaps_in_motion(s));
    if (HARD_ROWS) {
        enlarge(&s->near.left, rows_left(s) / FACTOR_NEAR_ROWS);
    }
    if (status == OK) { /* the multipliers of relaxed rows are those of their penalty */
        (void)kkt_is_within(s, residual_tolerance[0]);
        enlarge(&s->stats.residual, s->kkt.relative);
        enlarge(&s->near.left, s->kkt.relative);
    }
    return status;
}
