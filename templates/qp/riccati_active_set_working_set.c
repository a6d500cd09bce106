/* This part keeps the working set side[], applies it to the recursion, and computes the multipliers at its minimiser.
 *
 * A member is an equation at its bound: a control is fixed, a row has the augmented Lagrangian
 *     center (a'z - t) + weight/2 (a'z - t)^2,   mult = center + weight (a'z - t)
 * A row that is violated at a price has the cost +-l1 (a'z - t) + l2/2 (a'z - t)^2. */

/* Values of scaled: scales of the rows unknown; those of an earlier QP, whose units may be others; of this QP. */
enum { SCALES_NONE = 0, SCALES_EARLIER = 1, SCALES_OWN = 2 };

static inline real_t qp_target(const qp_t *q, int c)
{
    return q->side[c] > 0 ? q->upper[c] : q->lower[c];
}

static inline int qp_is_member(int side)
{
    return side == AT_LOWER || side == AT_UPPER;
}

/* Returns the bound |a|'|z| of the terms of row m, with the largest magnitude of every component of z over all stages,
 * at least that of zeros. */
static real_t qp_row_size(const solver_t *s, int m)
{
    const real_t *scale = s->qp.scale;
    if (!row_is_state(m)) {
        const int n = row_node(m) < N ? NZ : NX;
        const real_t *a = row_gradient(s, m);
        real_t sum = TOL_ZERO * row_magnitude[row_id(m)];
        for (int i = 0; i < n; i++) {
            sum += FABS(a[i]) * scale[i];
        }
        return sum;
    }
    return scale[row_index(m)] + TOL_ZERO * row_magnitude[row_id(m)];
}

/* Marks the factors and vectors of the stages 0 .. k as stale after a change of the working set. */
static inline void qp_outdate(qp_t *q, int k)
{
    q->stale = k > q->stale ? k : q->stale;
    q->stale_vectors = k > q->stale_vectors ? k : q->stale_vectors;
}

/* Marks the vectors of the stages 0 .. k as stale if the bound of a member has changed. */
static inline void qp_outdate_vectors(qp_t *q, int c, int k, real_t target)
{
    /* Exact comparison: an unchanged bound is the same number. */
    if (q->side[c] != INACTIVE && qp_target(q, c) != target) {
        q->stale_vectors = k > q->stale_vectors ? k : q->stale_vectors;
    }
}

static void qp_set_control(solver_t *s, int k, int j, int side)
{
    qp_t *q = &s->qp;
    const int c = k * NU + j;
    if (side != q->side[c]) {
        q->side[c] = side;
        q->changes++;
        s->riccati.fixed[c] = side != INACTIVE;
        qp_outdate(q, k);
    }
}

/* Returns the weight of a a' in the Hessian that row m adds. */
static inline real_t qp_weight(const solver_t *s, int m, int side)
{
    if (side == INACTIVE || (s->schur.active && qp_is_member(side))) {
        return R(0);
    }
    return qp_is_member(side) ? s->qp.weight[m] : s->qp.curvature[m];
}

/* Sets the side of row m; a new member starts with multiplier 0. */
static void qp_set_row(solver_t *s, int m, int side)
{
    qp_t *q = &s->qp;
    const int c = NV + m;
    if (side != q->side[c]) {
        const real_t weight = qp_weight(s, m, side);
        q->side[c] = side;
        q->changes++;
        q->mult[c] = R(0);
        if (!s->schur.active || weight > s->riccati.weight[m] || weight < s->riccati.weight[m]) {
            qp_outdate(q, row_node(m));
        }
        s->riccati.weight[m] = weight;
        s->schur.swept = 0;
    }
}

/* Returns `side`, corrected to a side that the bounds of c allow: an equation is always a member, and an infinite bound
 * has no side. */
static inline int qp_admissible_side(const qp_t *q, int c, int side)
{
    const int no_upper = side > 0 && !(q->upper[c] < INF);
    const int no_lower = side < 0 && !(q->lower[c] > -INF);
    const int allowed = no_upper || no_lower ? INACTIVE : side;
    if (allowed == INACTIVE && q->lower[c] >= q->upper[c]) {
        return q->upper[c] < INF ? AT_UPPER : AT_LOWER;
    }
    return allowed;
}

/* Returns `side`, corrected for row m: a hard row has no violated side. */
static inline int qp_allowed_row(const qp_t *q, int m, int side)
{
    const int allowed = qp_admissible_side(q, NV + m, side);
    if (qp_is_violated(allowed) && !qp_is_soft(q, m)) {
        return allowed > 0 ? AT_UPPER : AT_LOWER;
    }
    return allowed;
}

/* Applies the present bounds: corrects sides that they do not allow, and marks vectors with changed bounds as stale. */
static void qp_take_bounds(solver_t *s)
{
    qp_t *q = &s->qp;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const int c = k * NU + j;
            qp_set_control(s, k, j, qp_admissible_side(q, c, q->side[c]));
            qp_outdate_vectors(q, c, k, s->riccati.du[c]);
        }
    }
    for (int m = 0; m < NG; m++) {
        qp_set_row(s, m, qp_allowed_row(q, m, q->side[NV + m]));
        if (s->schur.active && qp_is_member(q->side[NV + m])) { /* the gradient does not contain the bound */
            q->target[m] = qp_target(q, NV + m);
        }
        qp_outdate_vectors(q, NV + m, row_node(m), q->target[m]);
    }
}

/* Adds the members and the violated rows of stage k to the gradient of the stage. */
static void qp_load_rows(solver_t *s, int k)
{
    qp_t *q = &s->qp;
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        const int side = q->side[NV + m];
        if (side != INACTIVE) {
            const real_t l1 = side > 0 ? q->penalty[m] : -q->penalty[m];
            q->target[m] = qp_target(q, NV + m);
            q->center[m] = qp_is_member(side) ? q->mult[NV + m] : l1;
            qp_add_row(s, m, q->center[m] - s->riccati.weight[m] * q->target[m]);
        }
    }
}

/* Computes the right-hand sides of the stages with stale vectors. */
static void qp_load(solver_t *s)
{
    const qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    for (int k = 0; k <= q->stale_vectors; k++) {
        (void)memcpy(r->work.vectors.rhs.g[k], stage_g(s, k), sizeof r->work.vectors.rhs.g[0][0] * (k < N ? NZ : NX));
        if (k < N) {
            (void)memcpy(r->b[k], stage_b(s, k), sizeof r->b[0]);
        }
        for (int c = k * NU; k < N && c < (k + 1) * NU; c++) {
            r->du[c] = q->side[c] != INACTIVE ? qp_target(q, c) : R(0);
        }
        qp_load_rows(s, k);
    }
}

/* Computes the largest magnitude of every component of x and z over the stages. Returns 0 if a number is not finite. */
static int qp_measure(qp_t *q)
{
    (void)memset(q->scale, 0, sizeof q->scale);
    qp_enlarge(q, q->scale);
    return all_finite(q->x[0], (N + 1) * NX) && all_finite(q->z, NV);
}

/* Computes the multipliers at the minimiser on the working set. Returns 0 if a multiplier or the value of a row is not
 * finite. */
static int qp_take_multipliers(solver_t *s)
{
    qp_t *q = &s->qp;
    const riccati_t *r = &s->riccati;
    real_t sum = R(0);
    for (int k = 0; k < N; k++) {
        const int first = k * NU;
        for (int j = 0; j < NU; j++) {
            const int c = first + j;
            q->mult[c] = R(0);
            if (q->side[c] != INACTIVE) {
                q->z[c] = r->du[c];
                q->mult[c] = -riccati_control_gradient(r, k, j, q->x[k], q->z + first);
                sum += FABS(q->mult[c]);
            }
        }
    }
    for (int m = 0; m < NG; m++) {
        q->value[m] = qp_row_value(s, m);
        q->mult[NV + m] =
            q->side[NV + m] != INACTIVE ? q->center[m] + r->weight[m] * (q->value[m] - q->target[m]) : R(0);
        sum += FABS(q->value[m]);
    }
    return isfinite(sum);
}
