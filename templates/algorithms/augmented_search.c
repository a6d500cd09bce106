/* Contract of this part: one iteration of the trust-region method on the bound-constrained problem min L. It finds the
 * Cauchy point by a projected search along the gradient, then minimises the model plus r/2 |d - d_c|^2 over the free
 * variables by conjugate gradients with projected searches, and accepts the step by the ratio of actual and predicted
 * reduction. All lengths are those of the scaled variables. */

/* d = the point of the box next to from + t direction. */
static void project_step(auglag_t *a, real_t (*d)[NZ], real_t (*from)[NZ], real_t t, real_t (*direction)[NZ])
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            d[k][i] = clip(from[k][i] + t * direction[k][i], a->lower[k][i], a->upper[k][i]);
        }
    }
}

/* Direction -scale^2 g of steepest descent in p, without components that leave the box. Returns its slope -p'g. */
static real_t steepest_descent(auglag_t *a)
{
    real_t slope = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t p = -variable_scale[i] * variable_scale[i] * a->g[k][i];
            const int leaves = (p > R(0)) ? !(a->upper[k][i] > R(0)) : !(a->lower[k][i] < R(0));
            a->p[k][i] = leaves ? R(0) : p;
            slope -= a->p[k][i] * a->g[k][i];
        }
    }
    return slope;
}

/* d: the Cauchy point, Hd: H d. Returns the value of the model there, 0 if there is no descent. */
static real_t cauchy_point(solver_t *s)
{
    auglag_t *a = &s->auglag;
    const real_t slope = steepest_descent(a);
    real_t t, curvature;
    memset(a->d, 0, sizeof a->d);
    memset(a->Hd, 0, sizeof a->Hd);
    if (!(slope > R(0)) || !(slope < INF)) {
        return R(0);
    }
    multiply(s, a->p, a->Hp);
    curvature = inner(a->p, a->Hp);
    t = (curvature > R(0)) ? slope / curvature : INF;
    t = (t * SQRT(slope) < R(2) * a->radius) ? t : R(2) * a->radius * SQRT(R(VARIABLES) / slope);
    for (int trial = 0; trial < MAX_BACKTRACKS; trial++) {
        real_t linear, value;
        memset(a->w, 0, sizeof a->w);
        project_step(a, a->d, a->w, t, a->p);
        multiply(s, a->d, a->Hd);
        linear = inner(a->g, a->d);
        value = linear + R(0.5) * inner(a->d, a->Hd);
        if (value <= R(0.01) * linear) {
            return value;
        }
        t *= R(0.25);
    }
    memset(a->d, 0, sizeof a->d);
    memset(a->Hd, 0, sizeof a->Hd);
    return R(0);
}

/* Fixes the variables that are at a bound of the box; fixed ones remain fixed. Returns the number of newly fixed ones. */
static int find_face(auglag_t *a)
{
    int changes = 0;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t rounding = R(64) * TOL_UNIT * (a->upper[k][i] - a->lower[k][i]);
            const int inside = a->d[k][i] > a->lower[k][i] + rounding && a->d[k][i] < a->upper[k][i] - rounding;
            changes += !inside && a->open[k][i] > R(0);
            a->open[k][i] = inside ? a->open[k][i] : R(0);
        }
    }
    return changes;
}

/* y = (H + r scale^-2) v over the free variables, v'y. */
static real_t multiply_free(solver_t *s, real_t (*v)[NZ], real_t (*y)[NZ])
{
    const auglag_t *a = &s->auglag;
    multiply(s, v, y);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            y[k][i] += a->proximal / (variable_scale[i] * variable_scale[i]) * v[k][i];
            y[k][i] *= a->open[k][i];
        }
    }
    return inner(v, y);
}

/* Largest t <= most for which d + w + t p is in the box; 0 if d + w is not. */
static real_t longest_move(const auglag_t *a, real_t (*w)[NZ], real_t (*p)[NZ], real_t most)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t room = ((p[k][i] > R(0)) ? a->upper[k][i] : a->lower[k][i]) - a->d[k][i] - w[k][i];
            if (FABS(p[k][i]) * most > FABS(room) || room * p[k][i] < R(0)) {
                most = (room * p[k][i] > R(0)) ? room / p[k][i] : R(0);
            }
        }
    }
    return most;
}

/* w: approximate minimiser of the model plus proximal term along the free variables, from d; stops at directions of
 * negative curvature, which it follows. `residual` holds minus the gradient there. */
static void conjugate_gradients(solver_t *s)
{
    auglag_t *a = &s->auglag;
    real_t size, first;
    memset(a->w, 0, sizeof a->w);
    memcpy(a->p, a->residual, sizeof a->p);
    precondition(a, a->p);
    size = first = inner(a->residual, a->p);
    for (int n = 0; n < MAX_CG && size > a->precision * first && size < INF; n++) {
        const real_t curvature = multiply_free(s, a->p, a->Hp);
        s->stats.cg_iterations++;
        if (!(curvature > R(0))) {
            s->stats.negative_curvature++;
            add_multiple(a->w, longest_move(a, a->w, a->p, R(1e30)), a->p);
            return;
        }
        add_multiple(a->w, size / curvature, a->p);
        add_multiple(a->residual, -size / curvature, a->Hp);
        memcpy(a->Hp, a->residual, sizeof a->Hp);
        precondition(a, a->Hp);
        const real_t next = inner(a->residual, a->Hp), ratio = next / size;
        for (int k = 0; k <= N; k++) {
            for (int i = 0; i < NZ; i++) {
                a->p[k][i] = a->Hp[k][i] + ratio * a->p[k][i];
            }
        }
        size = next;
    }
}

/* Moves d along w, projected to the box, so far that the model decreases sufficiently. Returns 0 if it does not. */
static int projected_search(solver_t *s, real_t *value)
{
    auglag_t *a = &s->auglag;
    real_t t = R(1);
    memset(a->residual, 0, sizeof a->residual);
    for (int trial = 0; trial < MAX_BACKTRACKS; trial++) {
        real_t linear = R(0), found;
        project_step(a, a->p, a->d, t, a->w);
        multiply(s, a->p, a->Hp);
        found = inner(a->g, a->p) + R(0.5) * inner(a->p, a->Hp);
        for (int k = 0; k <= N; k++) {
            for (int i = 0; i < NZ; i++) {
                linear += (a->g[k][i] + a->Hd[k][i]) * (a->p[k][i] - a->d[k][i]);
            }
        }
        if (linear < R(0) && found <= *value + R(0.01) * linear) {
            memcpy(a->d, a->p, sizeof a->d);
            memcpy(a->Hd, a->Hp, sizeof a->Hd);
            *value = found;
            return 1;
        }
        t = (trial == 1) ? longest_move(a, a->residual, a->w, t) : R(0.25) * t;
    }
    return 0;
}

/* Improves the Cauchy point on its face and on smaller ones. Returns the value of the model. */
static real_t refine(solver_t *s, real_t value)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            a->open[k][i] = R(1);
        }
    }
    (void)find_face(a);
    a->largest = largest_curvature(s);
    for (int face = 0; face < a->faces; face++) { /* at most FACES_OF_SOLVE passes */
        a->factorized = factorize(s);
        for (int k = 0; k <= N; k++) {
            for (int i = 0; i < NZ; i++) {
                a->residual[k][i] = -a->open[k][i] * (a->g[k][i] + a->Hd[k][i]);
            }
        }
        conjugate_gradients(s);
        s->stats.faces++;
        if (!projected_search(s, &value) || find_face(a) == 0) {
            break;
        }
    }
    return value;
}

/* Moves the plan by d, into its bounds exactly; the old plan is kept aside. */
static void move_plan(solver_t *s)
{
    auglag_t *a = &s->auglag;
    memcpy(a->x, s->x, sizeof a->x);
    memcpy(a->u, s->u, sizeof a->u);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] += a->d[k][i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->u[k][j] += a->d[k][NX + j];
        }
    }
    project_plan(s);
}

/* Largest |d_i| / scale_i */
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

/* One iteration from the linearised plan. Returns 1 if the plan has moved, and then gaps, rows, cost and the estimates
 * of the multipliers belong to the new one. */
static int descend(solver_t *s)
{
    auglag_t *a = &s->auglag;
    const real_t before = merit(s), noise = TOL_MERIT_ROUNDING * (R(1) + FABS(before));
    real_t predicted, ratio, length;
    assemble(s);
    set_box(s);
    predicted = -refine(s, cauchy_point(s));
    a->predicted = predicted;
    length = step_length_of(a);
    move_plan(s);
    evaluate_path(s);
    evaluate_ends(s);
    ratio = (before - merit(s) + noise) / (predicted + noise);
    if (ratio > R(0.75) && length > R(0.5) * a->radius) {
        a->radius *= R(4);
    } else if (!(ratio > R(0.25))) {
        a->radius = R(0.25) * ((length < a->radius) ? length : a->radius);
    }
    if (!(ratio > R(0.01)) || !(ratio < INF)) {
        memcpy(s->x, a->x, sizeof a->x);
        memcpy(s->u, a->u, sizeof a->u);
        evaluate_path(s);
        evaluate_ends(s);
        return 0;
    }
    s->stats.accepted++;
    estimate_multipliers(s);
    return 1;
}
