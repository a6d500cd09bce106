/* This part makes one iteration of the trust-region method on the bound-constrained problem min L. The iteration finds
 * the Cauchy point by a projected search along the gradient, then minimises the model plus r/2 |d - d_c|^2 over the
 * free variables by conjugate gradients with projected searches, and accepts the step by the ratio of actual and
 * predicted reduction. All lengths are those of the scaled variables. */

/* Sets d to the point of the box that is nearest to from + t direction. Returns 1 if from + t direction is inside the
 * box. */
static int project_step(const auglag_t *a, real_t (*d)[LDZ], real_t (*from)[LDZ], real_t t, real_t (*direction)[LDZ])
{
    const real_t *start = from[0], *p = direction[0], *lower = a->lower[0], *upper = a->upper[0];
    real_t *end = d[0];
    int inside = 1;
    for (int i = 0; i < VARIABLES; i++) {
        const real_t moved = start[i] + t * p[i];
        inside &= moved >= lower[i] && moved <= upper[i];
        end[i] = clip(moved, lower[i], upper[i]);
    }
    return inside;
}

/* Sets p to the direction -scale^2 g of steepest descent, without components that leave the box. Returns its slope
 * -p'g. */
static real_t steepest_descent(auglag_t *a)
{
    (void)memset(a->p, 0, sizeof a->p);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t p = -variable_scale[i] * variable_scale[i] * a->g[k][i];
            const int leaves = (p > R(0)) ? !(a->upper[k][i] > R(0)) : !(a->lower[k][i] < R(0));
            a->p[k][i] = leaves ? R(0) : p;
        }
    }
    return -inner(a->p, a->g);
}

/* Computes the Cauchy point d and Hd = H d. Returns the value of the model there, 0 if there is no descent. */
static real_t cauchy_point(solver_t *s)
{
    auglag_t *a = &s->auglag;
    const real_t slope = steepest_descent(a);
    real_t t, curvature;
    (void)memset(a->w, 0, sizeof a->w);
    (void)memset(a->d, 0, sizeof a->d);
    (void)memset(a->Hd, 0, sizeof a->Hd);
    (void)memset(a->Hp, 0, sizeof a->Hp);
    if (!(slope > R(0)) || !(slope < INF)) {
        return R(0);
    }
    multiply(s, a->p, a->Hp);
    curvature = inner(a->p, a->Hp);
    t = (curvature > R(0)) ? slope / curvature : INF;
    t = (t * SQRT(slope) < R(2) * a->radius) ? t : R(2) * a->radius * SQRT(R(VARIABLES) / slope);
    for (int trial = 0; trial < MAX_BACKTRACKS; trial++) {
        real_t linear, value;
        (void)memset(a->Hd, 0, sizeof a->Hd);
        if (project_step(a, a->d, a->w, t, a->p)) {
            add_multiple(a->Hd, t, a->Hp);
        } else {
            multiply(s, a->d, a->Hd);
        }
        linear = inner(a->g, a->d);
        value = linear + R(0.5) * inner(a->d, a->Hd);
        if (value <= FACTOR_AUGMENTED_SUFFICIENT * linear) {
            return value;
        }
        t *= FACTOR_AUGMENTED_SHRINK;
    }
    (void)memset(a->d, 0, sizeof a->d);
    (void)memset(a->Hd, 0, sizeof a->Hd);
    return R(0);
}

/* Fixes the variables that are at a bound of the box; fixed ones remain fixed. Returns the last node with a newly fixed
 * one, -1 if there is none. */
static int find_face(auglag_t *a)
{
    int last = -1;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < LDZ; i++) {
            const real_t rounding = TOL_FACE * (a->upper[k][i] - a->lower[k][i]);
            const int inside = a->d[k][i] > a->lower[k][i] + rounding && a->d[k][i] < a->upper[k][i] - rounding;
            last = (!inside && a->open[k][i] > R(0)) ? k : last;
            a->open[k][i] = inside ? a->open[k][i] : R(0);
        }
    }
    return last;
}

/* residual += factor (H + r scale^-2) p over the free variables, where Hp = H p. Returns its squared scaled norm. */
static real_t update_residual(auglag_t *a, real_t factor)
{
    real_t sum[4] = {R(0)};
    for (int k = 0; k <= N; k++) {
        for (int j = 0; j < LDZ; j += 4) {
            real_t rest[4];
            for (int i = 0; i < 4; i++) {
                const real_t change = a->Hp[k][j + i] + a->proximal * variable_weight[j + i] * a->p[k][j + i];
                rest[i] = a->open[k][j + i] * (a->residual[k][j + i] + factor * change);
                sum[i] += rest[i] * rest[i] * (variable_scale[j + i] * variable_scale[j + i]);
            }
            for (int i = 0; i < 4; i++) {
                a->residual[k][j + i] = rest[i];
            }
        }
    }
    return (sum[0] + sum[2]) + (sum[1] + sum[3]);
}

/* Returns p'(H + r scale^-2) p, where Hp = H p. */
static real_t curvature_along(const auglag_t *a)
{
    real_t sum[4] = {R(0)};
    for (int k = 0; k <= N; k++) {
        for (int j = 0; j < LDZ; j += 4) {
            for (int i = 0; i < 4; i++) {
                const real_t p = a->p[k][j + i];
                sum[i] += p * (a->Hp[k][j + i] + a->proximal * variable_weight[j + i] * p);
            }
        }
    }
    return (sum[0] + sum[2]) + (sum[1] + sum[3]);
}

/* Returns the largest t <= most for which from + t p is in the box; 0 if `from` is not. */
static real_t longest_move(const auglag_t *a, real_t (*from)[LDZ], real_t (*p)[LDZ], real_t most)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t room = ((p[k][i] > R(0)) ? a->upper[k][i] : a->lower[k][i]) - from[k][i];
            if (FABS(p[k][i]) * most > FABS(room) || room * p[k][i] < R(0)) {
                most = (room * p[k][i] > R(0)) ? room / p[k][i] : R(0);
            }
        }
    }
    return most;
}

/* Moves w along the direction p of negative curvature to the boundary of the box. */
static void follow(auglag_t *a)
{
    real_t move;
    (void)memcpy(a->residual, a->d, sizeof a->residual);
    add_multiple(a->residual, R(1), a->w);
    move = longest_move(a, a->residual, a->p, FACTOR_AUGMENTED_LONGEST);
    add_multiple(a->w, move, a->p);
    add_multiple(a->Hw, move, a->Hp);
}

/* Approximates the minimiser w of the model plus proximal term along the free variables, from d, and computes Hw = H w.
 * The iterations stop at directions of negative curvature, which they follow. `residual` holds minus the gradient.
 * Where the factors are those of the matrix itself, one iteration reduces the residual to rounding errors, which is
 * detected without another substitution. */
static void conjugate_gradients(solver_t *s)
{
    auglag_t *a = &s->auglag;
    const real_t start = update_residual(a, R(0));
    real_t size, first;
    (void)memset(a->w, 0, sizeof a->w);
    (void)memset(a->Hw, 0, sizeof a->Hw);
    (void)memcpy(a->p, a->residual, sizeof a->p);
    precondition(a, a->p);
    first = inner(a->residual, a->p);
    size = first;
    for (int n = 0; n < MAX_CG && size > a->precision * first && size < INF; n++) {
        multiply(s, a->p, a->Hp);
        const real_t curvature = curvature_along(a);
        s->stats.cg_iterations++;
        if (!(curvature > R(0))) {
            s->stats.negative_curvature++;
            follow(a);
            return;
        }
        add_multiple(a->w, size / curvature, a->p);
        add_multiple(a->Hw, size / curvature, a->Hp);
        if (update_residual(a, -size / curvature) <= a->precision * a->precision * start) {
            return;
        }
        (void)memcpy(a->Hp, a->residual, sizeof a->Hp);
        precondition(a, a->Hp);
        const real_t next = inner(a->residual, a->Hp);
        add_multiple(a->Hp, next / size, a->p);
        (void)memcpy(a->p, a->Hp, sizeof a->p);
        size = next;
    }
}

/* Moves d along w, projected to the box, until the model decreases sufficiently. Returns 0 if it does not. */
static int projected_search(solver_t *s, real_t *value)
{
    auglag_t *a = &s->auglag;
    real_t t = R(1);
    for (int trial = 0; trial < MAX_BACKTRACKS; trial++) {
        real_t linear, found;
        if (project_step(a, a->p, a->d, t, a->w)) {
            (void)memcpy(a->Hp, a->Hd, sizeof a->Hp);
            add_multiple(a->Hp, t, a->Hw);
        } else {
            multiply(s, a->p, a->Hp);
        }
        found = inner(a->g, a->p) + R(0.5) * inner(a->p, a->Hp);
        (void)memcpy(a->residual, a->p, sizeof a->residual);
        add_multiple(a->residual, -R(1), a->d);
        linear = inner(a->g, a->residual) + inner(a->Hd, a->residual);
        if (linear < R(0) && found <= *value + FACTOR_AUGMENTED_SUFFICIENT * linear) {
            (void)memcpy(a->d, a->p, sizeof a->d);
            (void)memcpy(a->Hd, a->Hp, sizeof a->Hd);
            *value = found;
            return 1;
        }
        t = (trial == 1) ? longest_move(a, a->d, a->w, t) : FACTOR_AUGMENTED_SHRINK * t;
    }
    return 0;
}

/* residual = minus the gradient of the model at d, over the free variables. */
static void set_residual(auglag_t *a)
{
    (void)memset(a->residual, 0, sizeof a->residual);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            a->residual[k][i] = -a->open[k][i] * (a->g[k][i] + a->Hd[k][i]);
        }
    }
}

/* Returns the value of the model at d, where rows that have left their parabola count with their term. */
static real_t value_at_step(solver_t *s)
{
    auglag_t *a = &s->auglag;
    return inner(a->g, a->d) + R(0.5) * inner(a->d, a->Hd) + a->offset + beyond_parabolas(s);
}

/* Shortens the step d towards the previous point `kept` until the model, with the rows that have left their parabola,
 * is at most `most`; d becomes `kept` if no trial reaches that. Returns the value of the model at d. */
static real_t shorten(solver_t *s, real_t most)
{
    auglag_t *a = &s->auglag;
    real_t value = value_at_step(s);
    for (int trial = 0; trial < MAX_BACKTRACKS && value > most; trial++) {
        for (int k = 0; k <= N; k++) {
            for (int i = 0; i < LDZ; i++) {
                a->d[k][i] = a->kept_d[k][i] + FACTOR_AUGMENTED_SHRINK * (a->d[k][i] - a->kept_d[k][i]);
                a->Hd[k][i] = a->kept_Hd[k][i] + FACTOR_AUGMENTED_SHRINK * (a->Hd[k][i] - a->kept_Hd[k][i]);
            }
        }
        value = value_at_step(s);
    }
    if (value > most) {
        (void)memcpy(a->d, a->kept_d, sizeof a->d);
        (void)memcpy(a->Hd, a->kept_Hd, sizeof a->Hd);
        value = value_at_step(s);
    }
    return value;
}

/* Moves to the next face. Returns the last node where the face is smaller or a row has left its parabola; -1 if there
 * is none. */
static int next_face(solver_t *s, real_t *value)
{
    auglag_t *a = &s->auglag;
    int face, row;
    a->best = shorten(s, a->best);
    face = find_face(a);
    row = take_parabolas(s);
    *value = a->best - a->offset;
    return (row > face) ? row : face;
}

/* Improves the Cauchy point on its face and on other ones, at most `faces`. Returns the value of the model. */
static real_t refine(solver_t *s, int faces)
{
    auglag_t *a = &s->auglag;
    real_t value = cauchy_point(s);
    int last = N;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < LDZ; i++) {
            a->open[k][i] = R(1);
        }
    }
    if (NG) {
        (void)memset(a->kept_d, 0, sizeof a->kept_d);
        (void)memset(a->kept_Hd, 0, sizeof a->kept_Hd);
        a->best = (value < R(0)) ? shorten(s, R(0)) : R(0);
        (void)take_parabolas(s);
        value = a->best - a->offset;
    }
    (void)find_face(a);
    a->largest = largest_curvature(a);
    a->shift = R(0);
    a->shifts = 0;
    for (int face = 0; face < faces && last >= 0; face++) {
        (void)memcpy(a->kept_d, a->d, sizeof a->kept_d);
        (void)memcpy(a->kept_Hd, a->Hd, sizeof a->kept_Hd);
        a->factorized = factorize(s, last);
        set_residual(a);
        conjugate_gradients(s);
        s->stats.faces++;
        if (!projected_search(s, &value)) {
            break;
        }
        if (NG) {
            last = next_face(s, &value);
        } else {
            last = find_face(a);
        }
    }
    if (NG) {
        return a->best;
    } else {
        return value;
    }
}

/* Saves the plan with its gaps, rows and cost. */
static void keep_plan(solver_t *s)
{
    auglag_t *a = &s->auglag;
    (void)memcpy(a->kept_x, s->x, sizeof a->kept_x);
    (void)memcpy(a->kept_u, s->u, sizeof a->kept_u);
    (void)memcpy(a->kept_gap, a->gap, sizeof a->kept_gap);
    (void)memcpy(a->kept_value, a->value, sizeof a->kept_value);
    a->kept_cost = a->cost;
}

/* Moves the plan by d; bounds hold exactly afterwards. */
static void move_plan(solver_t *s)
{
    const auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] = or_zero(s->x[k][i] + a->d[k][i], i);
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->u[k][j] = or_zero(s->u[k][j] + a->d[k][NX + j], NX + j);
        }
    }
    (void)project_plan(s);
}

/* Restores the saved plan. */
static void return_plan(solver_t *s)
{
    auglag_t *a = &s->auglag;
    (void)memcpy(s->x, a->kept_x, sizeof s->x);
    (void)memcpy(s->u, a->kept_u, sizeof s->u);
    (void)memcpy(a->gap, a->kept_gap, sizeof a->gap);
    (void)memcpy(a->value, a->kept_value, sizeof a->value);
    a->cost = a->kept_cost;
}

/* Returns the largest |d_i| / scale_i. */
static real_t step_length_of(const auglag_t *a)
{
    real_t most = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t move = FABS(a->d[k][i]) / variable_scale[i];
            most = (move > most) ? move : most;
        }
    }
    return most;
}

/* Returns a bound of the rounding error of L: the error of summing its terms, and the error of gaps and cost that the
 * rounding of the variables causes. */
static real_t rounding_of_merit(const solver_t *s, real_t value)
{
    const auglag_t *a = &s->auglag;
    real_t forces = R(0), bends = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            forces += FABS(s->lam[k][i] * s->x[k][i]);
            bends += FABS(a->H[k][i][i]) * s->x[k][i] * s->x[k][i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            bends += FABS(a->H[k][NX + j][NX + j]) * s->u[k][j] * s->u[k][j];
        }
    }
    return TOL_MERIT_ROUNDING * (FABS(value) + TOL_MERIT_ROUNDING * bends) + TOL_UNIT * forces + least_cost();
}

/* Makes one iteration from the assembled model of the plan. Returns 1 if the plan has moved; gaps, rows, cost and the
 * estimates of the multipliers then belong to the new plan. Otherwise only the radius is smaller. */
static int descend(solver_t *s, int faces)
{
    auglag_t *a = &s->auglag;
    const real_t before = merit(s), noise = rounding_of_merit(s, before);
    real_t ratio, length;
    set_box(s);
    a->predicted = -refine(s, faces);
    length = step_length_of(a);
    keep_plan(s);
    move_plan(s);
    evaluate_path(s);
    evaluate_ends(s);
    ratio = (before - merit(s) + noise) / (a->predicted + noise);
    a->settled = (FABS(ratio - R(1)) < R(0.5) && length < FACTOR_AUGMENTED_SETTLED_LENGTH * a->radius) ||
        (ratio > FACTOR_AUGMENTED_SUFFICIENT && length < FACTOR_AUGMENTED_TINY_STEP && length < a->radius);
    if (ratio > FACTOR_AUGMENTED_GOOD && length > R(0.5) * a->radius) {
        a->radius *= FACTOR_AUGMENTED_GROW;
    } else if (!(ratio > FACTOR_AUGMENTED_POOR)) {
        a->radius = FACTOR_AUGMENTED_SHRINK * ((length < a->radius) ? length : a->radius);
    }
    if (!(ratio > FACTOR_AUGMENTED_SUFFICIENT) || !(ratio < INF)) {
        return_plan(s);
        (void)memset(a->Hd, 0, sizeof a->Hd);
        if (NG) {
            estimate_multipliers(s);
            assemble(s);
        }
        return 0;
    }
    s->stats.accepted++;
    estimate_multipliers(s);
    return 1;
}
