typedef struct golden_solver golden_solver_t;

/* init: initialise all members to their declared values. reset: keep the settings and restore the initial iterate. */
golden_status_t golden_init(golden_solver_t *s);
golden_status_t golden_reset(golden_solver_t *s);

/* Preparation phase: move the plan to the next sample, linearise, condense, factorise. A call that fails leaves the
 * plan unchanged; feedback restarts a plan that fails repeatedly. */
golden_status_t golden_prepare(golden_solver_t *s);

/* Feedback phase: compute u0 for the measured xhat; u0 is finite and inside its bounds on every return. */
golden_status_t golden_feedback(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU]);

/* Call prepare, then feedback. */
golden_status_t golden_step(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU]);

/* Move the plan by one interval. Every sample except the first does this itself, so that a call moves the plan once
 * more. */
golden_status_t golden_shift(golden_solver_t *s);

/* Iterate from the present plan, with globalisation, until the relative KKT residual, kkt.relative, is at most tol or
 * max_iterations is reached; kkt and stats describe the outcome. */
golden_status_t golden_solve(
    golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real tol, int max_iterations);

/* Data that can be changed.
 *   reference: k is 0 .. N - 1, or GOLDEN_ALL.
 *   weight: k must be GOLDEN_ALL, as all nodes share one value.
 *   parameter: k is 0 .. N, or GOLDEN_ALL.
 *   bounds: k is N if the row holds there, or GOLDEN_ALL for all of its nodes.
 * A function for a range of nodes, first .. first + count - 1, takes a row of numbers for each of them.
 * A call that is refused (BAD_INDEX, BAD_ARGUMENT, BAD_BOUNDS) changes nothing. References and bounds take effect in
 * the next feedback, other data in the next prepare. */
golden_status_t golden_set_reference(golden_solver_t *s, int k, const golden_real yref[GOLDEN_NY]);
golden_status_t golden_set_reference_range(golden_solver_t *s, int first, int count, const golden_real *yref);
golden_status_t golden_set_terminal_reference(golden_solver_t *s, const golden_real yref[GOLDEN_NY_N]);
/* W: the diagonal, finite and not negative. */
golden_status_t golden_set_weight(golden_solver_t *s, int k, const golden_real W[GOLDEN_NW]);
golden_status_t golden_set_terminal_weight(golden_solver_t *s, const golden_real W[GOLDEN_NW_N]);
golden_status_t golden_set_parameter(golden_solver_t *s, int param, int k, const golden_real *values);
golden_status_t golden_set_parameter_range(golden_solver_t *s, int param, int first, int count, const golden_real *values);
golden_status_t golden_set_bounds(golden_solver_t *s, int row, int k, golden_real lower, golden_real upper);

/* integrate: simulate the plant model over a time dt >= 0 in s; x_next may be x.
 * cost: return the cost of the present plan. kkt: compute its KKT residuals.
 * Before init, the results are NaN and an infinite residual. */
void golden_integrate(const golden_solver_t *s, const golden_real x[GOLDEN_NX], const golden_real u[GOLDEN_NU],
    golden_real dt, golden_real x_next[GOLDEN_NX]);
golden_real golden_cost(const golden_solver_t *s);
void golden_kkt(const golden_solver_t *s, golden_kkt_t *out);
const char *golden_status_string(golden_status_t status);

