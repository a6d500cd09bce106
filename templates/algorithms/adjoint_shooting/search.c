/* Contract of this part: move() takes a fraction of the step d that decreases the sum of cost and row terms. */

/* Returns 1 if the control is free, 0 if it is held. It is a factor and not a condition, because GCC 12 with AVX loads
 * two registers of x with the mask of the first one in loops of the form y[i] = flag[i] ? 0 : x[i]. */
static inline real_t if_free(const shooting_t *a, int k, int j)
{
    return R(a->held[k][j] == 0);
}

/* Returns the cost of the plan plus the terms of its rows. */
static real_t merit(solver_t *s)
{
    if (NG) {
        return nodal_cost(s) + row_terms_of_plan(s, &s->stats.violation);
    } else {
        return nodal_cost(s);
    }
}

/* u = base + length scale d, clipped to the bounds; after a full step, held controls are exactly at their bounds.
 * Returns the change of the linear model of the merit function. */
static real_t place_controls(solver_t *s, real_t length, real_t slope)
{
    shooting_t *a = &s->shooting;
    if (QUASI_NEWTON) {
        slope = R(0);
    } else {
        slope *= length;
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t lower = control_lower(s, k, j), upper = control_upper(s, k, j);
            s->u[k][j] = clip(or_zero(a->p[k][j] + length * control_scale[j] * a->d[k][j], NX + j), lower, upper);
            if (QUASI_NEWTON) {
                slope += a->r[k][j] * (s->u[k][j] - a->p[k][j]) / control_scale[j];
            } else {
                if (length >= R(1) && a->held[k][j]) {
                    s->u[k][j] = (a->held[k][j] < 0) ? lower : upper;
                }
            }
        }
    }
    return slope;
}

/* Outcome of a step: rejected, shortened, taken in full. */
enum { STAYED, SHORTENED, MOVED };

/* Takes a quarter of the step, a quarter of that, and so on, until the merit function decreases by a fraction of what
 * its slope predicts. If it does not within ``trials`` simulations, the plan before the step is simulated again. The
 * next step begins with four times the accepted length, at most 1, so that a sample continues where the last one
 * ended. */
static int move(solver_t *s, real_t slope, int trials)
{
    const real_t before = merit(s);
    real_t length = s->shooting.length;
    (void)memcpy(s->shooting.p, s->u, sizeof s->shooting.p);
    for (int n = 0; n < MOST_TRIALS && n < trials; n++) {
        const real_t change = place_controls(s, length, slope);
        if (simulate_plan(s)) {
            const real_t after = merit(s);
            if (after <= before + armijo_part[0] * change + TOL_MERIT_ROUNDING * (R(1) + FABS(before))) {
                s->stats.accepted++;
                s->shooting.length = clip(FACTOR_SHOOTING_LONGER * length, shortest_length[0], R(1));
                return (length < R(1)) ? SHORTENED : MOVED;
            }
        }
        length /= FACTOR_SHOOTING_LONGER;
    }
    (void)memcpy(s->u, s->shooting.p, sizeof s->u);
    s->shooting.length = clip(length, shortest_length[0], R(1));
    (void)simulate_plan(s);
    (void)merit(s);
    return STAYED;
}

/* Returns 1 if the last step exceeds the tolerance, in the scale of a control, at one of the first ``nodes`` nodes. */
static int step_is_long(const solver_t *s, int nodes)
{
    int is_long = 0;
    for (int k = 0; k < nodes; k++) {
        for (int j = 0; j < NU; j++) {
            is_long |= is_far(FABS(s->shooting.d[k][j]));
        }
    }
    return is_long;
}
