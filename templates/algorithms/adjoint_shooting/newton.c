/* Contract of this part: improve() takes the step d of the controls that minimises the model inside the bounds, by
 * conjugate gradients on a face of the box. Controls at a bound are held, a bound that the iterates reach is added, and
 * bounds with multipliers of the wrong sign are released where the gradient on the face has become small. */

/* Most products of a step, and the square of the relative residual at which conjugate gradients end. */
static int most_products(const solver_t *s)
{
    if (SOLVE) {
        return s->shooting.solving ? PRODUCTS_OF_SOLVE : MAX_PRODUCTS;
    }
    return MAX_PRODUCTS;
}

static real_t least_part(const solver_t *s)
{
    if (SOLVE) {
        const real_t precision = model_precision[s->shooting.solving];
        return precision * precision;
    }
    return model_precision[0] * model_precision[0];
}

/* Distance of d from a bound of control j at node k, in its scale. */
static real_t to_lower(const solver_t *s, int k, int j)
{
    return s->shooting.d[k][j] - (control_lower(s, k, j) - s->u[k][j]) / control_scale[j];
}

static real_t to_upper(const solver_t *s, int k, int j)
{
    return (control_upper(s, k, j) - s->u[k][j]) / control_scale[j] - s->shooting.d[k][j];
}

/* d = 0; held = -1 for controls at the lower bound, 1 for controls at the upper bound, 0 for the others. */
static void hold_bounds(solver_t *s)
{
    shooting_t *a = &s->shooting;
    (void)memset(a->d, 0, sizeof a->d);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = s->u[k][j];
            a->held[k][j] = !(u > control_lower(s, k, j)) ? -1 : !(u < control_upper(s, k, j));
        }
    }
}

/* Returns the longest step along p inside the box, at most ``most``. */
static real_t longest_step(const solver_t *s, real_t most)
{
    real_t longest = most;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t p = s->shooting.p[k][j];
            const real_t distance = (p > R(0)) ? to_upper(s, k, j) : (p < R(0)) ? to_lower(s, k, j) : INF;
            if (distance < longest * FABS(p)) {
                longest = distance / FABS(p);
            }
        }
    }
    return (longest > R(0)) ? longest : R(0);
}

/* Holds the controls that the step along p has moved to a bound. */
static void hold_reached(solver_t *s)
{
    shooting_t *a = &s->shooting;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t p = a->p[k][j], d = FABS(a->d[k][j]);
            if (p > R(0) && to_upper(s, k, j) <= TOL_MERIT_ROUNDING * (d + FABS(s->u[k][j]) / control_scale[j])) {
                a->held[k][j] = 1;
            } else if (p < R(0) &&
                to_lower(s, k, j) <= TOL_MERIT_ROUNDING * (d + FABS(s->u[k][j]) / control_scale[j])) {
                a->held[k][j] = -1;
            }
        }
    }
}

/* Releases held controls whose gradient points inward by more than sqrt(least); returns their number. */
static int release(solver_t *s, real_t least)
{
    shooting_t *a = &s->shooting;
    int released = 0;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t inward = (real_t)a->held[k][j] * a->r[k][j];
            if (inward > R(0) && inward * inward > least && control_lower(s, k, j) < control_upper(s, k, j)) {
                a->held[k][j] = 0;
                released++;
            }
        }
    }
    return released;
}

/* Bends a step that ended at a bound. If the remaining step would reach several more bounds, its projection on the box
 * becomes the direction p, and d moves to the minimum of the model along it. */
static void bend_step(solver_t *s, real_t rest)
{
    shooting_t *a = &s->shooting;
    int reached = 0;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t p = if_free(a, k, j) * rest * a->p[k][j];
            a->p[k][j] = clip(p, -to_lower(s, k, j), to_upper(s, k, j));
            reached += FABS(a->p[k][j]) < FABS(p);
        }
    }
    const real_t slope = inner(a->r[0], a->p[0]);
    if (reached < 2 || a->left < 1 || !(slope < R(0))) {
        return;
    }
    multiply(s);
    a->left--;
    s->stats.cg_iterations++;
    const real_t bend = inner(a->p[0], a->w[0]), length = (bend > -slope) ? -slope / bend : R(1);
    add_multiple(a->d[0], length, a->p[0]);
    add_multiple(a->r[0], length, a->w[0]);
    a->model += length * (slope + R(0.5) * length * bend);
    hold_reached(s);
}

/* Takes one step along p. Returns 1 if it ends at a bound or along a direction without curvature. */
static int step_along(solver_t *s, real_t descent)
{
    shooting_t *a = &s->shooting;
    multiply(s);
    multiply_rows(a);
    s->stats.cg_iterations++;
    const real_t bend = inner(a->p[0], a->w[0]), size = inner(a->p[0], a->p[0]);
    const int curved = bend > TOL_UNIT * size;
    const real_t wanted = curved ? descent / bend : R(1) / SQRT(size);
    const real_t length = longest_step(s, wanted);
    s->stats.negative_curvature += !curved;
    add_multiple(a->d[0], length, a->p[0]);
    add_multiple(a->r[0], length, a->w[0]);
    a->model += length * (R(0.5) * length * bend - descent);
    if (length < wanted) {
        hold_reached(s);
        if (!NT) {
            bend_step(s, wanted - length);
        }
        return 1;
    }
    return !curved;
}

/* Runs conjugate gradients on a face until r' M r is at most precision^2 times its largest value since the first step,
 * which goes to the terminal rows. Returns 1 if a bound was reached. */
static int solve_face(solver_t *s, real_t *largest)
{
    shooting_t *a = &s->shooting;
    real_t beta = R(0);
    factorize_rows(a);
    real_t size = precondition(a);
    s->stats.faces++;
    (void)memset(a->p, 0, sizeof a->p);
    while (a->left > 0) { /* at most most_products(s) passes in solve_model */
        if (!(size > least_part(s) * *largest)) {
            return 0;
        }
        for (int k = 0; k < N; k++) {
            for (int j = 0; j < NU; j++) {
                a->p[k][j] = beta * a->p[k][j] - a->w[k][j];
            }
        }
        a->left--;
        if (step_along(s, size)) {
            return 1;
        }
        const real_t next = precondition(a);
        *largest = (next > *largest) ? next : *largest;
        beta = next / size;
        size = next;
    }
    return 0;
}

/* Returns the residual of terminal row t after the step, c_t + (Xi d)_t. */
static real_t left_of(const shooting_t *a, int t)
{
    return a->gap[t] + ((a->omega[t] > R(0)) ? inner(a->Xi[t][0], a->d[0]) : R(0));
}

static int is_met(const shooting_t *a, int t, real_t left)
{
    const real_t unit = SQRT(row_weight[terminal_row[t]]);
    return unit * FABS(left) <= TOL_TERMINAL_GAP * (R(1) + unit * FABS(a->gap[t]));
}

/* Takes a step of the method of multipliers, mu += Omega (c + Xi d), if a row is not met and the residuals of all rows
 * may be due to their compliance rather than to the bounds. Returns 1 if it takes the step. */
static int tighten_rows(solver_t *s)
{
    shooting_t *a = &s->shooting;
    int met = 1;
    for (int t = 0; t < NT; t++) {
        const real_t left = left_of(a, t), unit = SQRT(row_weight[terminal_row[t]]);
        if (unit * FABS(left) > SQRT(TOL_TERMINAL_COMPLIANCE) * (R(1) + unit * FABS(a->gap[t]))) {
            return 0;
        }
        met &= is_met(a, t, left);
    }
    for (int t = 0; !met && t < NT; t++) {
        const real_t left = left_of(a, t), change = a->omega[t] * left;
        s->row[terminal_row[t]] += change;
        a->model += change * (left - a->gap[t]);
        add_multiple(a->r[0], change, a->Xi[t][0]);
    }
    return !met;
}

/* Prepares the merit function for the step d. The terminal rows leave the slope of the model along d, their multipliers
 * are updated, and the rows enter as they are in the merit function. The multipliers are those of the last step of the
 * method of multipliers if all rows are met, and otherwise those before the step of the controls, because rows that
 * counteract one another then spoil the new ones. The weights of the rows are so large that the step decreases the
 * merit function although multipliers are inaccurate where the products ran out. */
static int update_terminal(solver_t *s, const real_t *before, real_t *slope)
{
    const shooting_t *a = &s->shooting;
    real_t other = *slope, own = R(0), bend = R(2) * (a->model - *slope);
    int met = 1;
    for (int t = 0; t < NT; t++) {
        met &= is_met(a, t, left_of(a, t));
    }
    for (int t = 0; t < NT; t++) {
        const real_t step = inner(a->Xi[t][0], a->d[0]);
        real_t *mu = &s->row[terminal_row[t]];
        other -= (*mu + a->omega[t] * a->gap[t]) * step;
        *mu = met ? *mu + a->omega[t] * left_of(a, t) : before[t];
        other += *mu * step;
        bend -= a->omega[t] * step * step;
        own -= penalty_of_rows(s) * row_weight[terminal_row[t]] * a->gap[t] * step;
    }
    const real_t rest = other + R(0.5) * bend;
    const real_t factor = (FACTOR_SHOOTING_TERMINAL_SHARE * rest > own && own > R(0))
        ? FACTOR_SHOOTING_TERMINAL_SHARE * rest / own
        : R(1);
    weigh_terminal(s, factor);
    *slope = other - factor * own;
    return met;
}

static int direction_is_finite(const solver_t *s)
{
    return all_finite(s->shooting.d[0], N * NU);
}

/* Returns |r|^2 over the free controls. */
static real_t free_size(const shooting_t *a)
{
    real_t sum = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            sum += if_free(a, k, j) * a->r[k][j] * a->r[k][j];
        }
    }
    return sum;
}

/* Minimises the model. Returns 0 if products or faces run out. */
static int solve_model(solver_t *s, real_t *largest)
{
    int rounds = MAX_ROUNDS;
    for (int face = 0; face < MAX_FACES && s->shooting.left > 0; face++) {
        const int reached = solve_face(s, largest);
        if (reached || release(s, least_part(s) * *largest)) {
            continue;
        }
        if (NT) {
            if (rounds-- > 0 && tighten_rows(s)) {
                continue;
            }
        }
        return s->shooting.left > 0;
    }
    return 0;
}

/* Takes one step: forms the model at the plan, minimises it, and searches along the step. Returns ITERATION_LIMIT if
 * the step does not meet the terminal rows because its products ran out, INFEASIBLE if the bounds do not allow it. */
static status_t improve(solver_t *s, int trials, int *moved)
{
    shooting_t *a = &s->shooting;
    real_t largest, slope;
    int met = 1, done, rough;
    *moved = STAYED;
    s->stats.newton_iterations++;
    differentiate(s);
    hold_bounds(s);
    largest = free_size(a);
    a->left = most_products(s);
    a->model = R(0);
    real_t before[NT];
    if (NT) {
        impulse_rows(s);
        for (int t = 0; t < NT; t++) {
            before[t] = s->row[terminal_row[t]];
        }
    }
    if (!all_finite(a->r[0], N * NU)) {
        return NUMERICAL_FAILURE;
    }
    done = solve_model(s, &largest);
    rough = !done && is_far(SQRT(precondition(a) / largest));
    if (!direction_is_finite(s)) {
        return NUMERICAL_FAILURE;
    }
    slope = R(2) * a->model - inner(a->r[0], a->d[0]);
    if (NT) {
        met = update_terminal(s, before, &slope);
    }
    *moved = move(s, (slope < R(0)) ? slope : R(0), trials);
    *moved = (*moved == MOVED && rough) ? SHORTENED : *moved;
    for (int t = 0; t < NT && *moved == STAYED; t++) {
        s->row[terminal_row[t]] = before[t];
    }
    return met ? OK : done ? INFEASIBLE : ITERATION_LIMIT;
}
