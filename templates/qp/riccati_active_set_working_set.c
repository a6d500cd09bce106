/* Contract of this part: the working set side[], what it does to the recursion, and what its minimiser says about it.
 *
 * A member (+-1) is an equation at its bound: a control is given, a row has the augmented Lagrangian
 *     center (a'z - t) + weight/2 (a'z - t)^2,   mult = center + weight (a'z - t)
 * A soft row that is violated (+-2) has the cost +-l1 (a'z - t) + l2/2 (a'z - t)^2. */

static inline real_t qp_target(const qp_t *q, int c)
{
    return q->side[c] > 0 ? q->upper[c] : q->lower[c];
}

#if NG
/* a'z of row m. */
static inline real_t qp_row_value(const solver_t *s, int m, real_t (*x)[NXS], const real_t *u)
{
    const int k = stage_of_row[m];
#if GENERAL_ROWS || NE || BLOCK_ROWS
    if (stage_state[m] < 0) {
        const real_t *a = stage_row(s, m);
        real_t sum = riccati_dot(a, x[k], NXS);
        for (int j = 0; k < NS && j < NUS; ++j) {
            sum += a[NXS + j] * u[k * NUS + j];
        }
        return sum;
    }
#else
    (void)s;
    (void)u;
#endif
    return x[k][stage_state[m]];
}

#endif
#if NG
/* y += f a of row m; y has the entries of z at its stage. */
static inline void qp_add_row(solver_t *s, int m, real_t f, real_t *y)
{
#if GENERAL_ROWS || NE || BLOCK_ROWS
    if (stage_state[m] < 0) {
        riccati_combine(y, &f, stage_row(s, m), NZS, 1, stage_of_row[m] < NS ? NZS : NXS);
        return;
    }
#else
    (void)s;
#endif
    y[stage_state[m]] += f;
}

#endif
#if NG
/* |a|'|z| of row m with the largest entry of every component. */
static real_t qp_row_size(const solver_t *s, int m)
{
    const real_t *scale = s->qp.scale;
#if GENERAL_ROWS || NE || BLOCK_ROWS
    if (stage_state[m] < 0) {
        const int n = stage_of_row[m] < NS ? NZS : NXS;
        const real_t *a = stage_row(s, m);
        real_t sum = R(0.0);
        for (int i = 0; i < n; ++i) {
            sum += FABS(a[i]) * scale[i];
        }
        return sum;
    }
#endif
    return scale[stage_state[m]];
}

#endif
/* The factors of the stages up to k do not fit the working set any more. */
static inline void qp_outdate(qp_t *q, int k)
{
    q->stale = k > q->stale ? k : q->stale;
    q->stale_vectors = k > q->stale_vectors ? k : q->stale_vectors;
}

#if NG
/* What row m adds to the Hessian along a a'. */
static inline real_t qp_weight(const qp_t *q, int m, int side)
{
    if (side == 0) {
        return R(0);
    }
    return (side == 1 || side == -1) ? q->weight[m] : q->curvature[m];
}

#endif
static void qp_set_control(solver_t *s, int c, int side)
{
    qp_t *q = &s->qp;
    if (side != q->side[c]) {
        q->side[c] = side;
        q->changes++;
        s->riccati.fixed[c] = side != 0;
        qp_outdate(q, c / NUS);
    }
}

#if NG
/* What enters has no multiplier yet. */
static void qp_set_row(solver_t *s, int m, int side)
{
    qp_t *q = &s->qp;
    const int c = NV + m;
    if (side != q->side[c]) {
        q->side[c] = side;
        q->changes++;
        q->mult[c] = R(0);
        s->riccati.weight[m] = qp_weight(q, m, side);
        qp_outdate(q, stage_of_row[m]);
    }
}

#endif
/* A side that the bounds of c allow: equations stay members, infinite bounds and hard rows have no violated side. */
static inline int qp_allowed(const qp_t *q, int c, int side, real_t penalty)
{
    int allowed = side;
    if ((side > 0 && !(q->upper[c] < (real_t)INFINITY)) || (side < 0 && !(q->lower[c] > -(real_t)INFINITY))) {
        allowed = 0;
    }
    if (allowed == 0 && q->lower[c] >= q->upper[c]) {
        allowed = q->upper[c] < (real_t)INFINITY ? 1 : -1;
    }
    return penalty < (real_t)INFINITY ? allowed : allowed > 0 ? 1 : allowed < 0 ? -1 : 0;
}

static inline void qp_outdate_target(qp_t *q, int c, int k)
{
    if (q->side[c] != 0 && q->target[c] != qp_target(q, c)) {
        q->stale_vectors = k > q->stale_vectors ? k : q->stale_vectors;
    }
}

/* Bounds as they are now: sides that they do not allow, targets that moved. */
static void qp_take_bounds(solver_t *s)
{
    qp_t *q = &s->qp;
    int c;
    for (c = 0; c < NV; c++) {
        qp_set_control(s, c, qp_allowed(q, c, q->side[c], (real_t)INFINITY));
        qp_outdate_target(q, c, c / NUS);
    }
#if NG
    for (int m = 0; m < NG; m++) {
        c = NV + m;
        qp_set_row(s, m, qp_allowed(q, c, q->side[c], q->penalty[m]));
        qp_outdate_target(q, c, stage_of_row[m]);
    }
#endif
}

/* Right-hand sides of the stages whose vectors are stale. */
static void qp_load(solver_t *s)
{
    qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    int k, c;
    for (k = 0; k <= q->stale_vectors; k++) {
        memcpy(r->g[k], stage_g(s, k), sizeof r->g[0][0] * (k < NS ? NZS : NXS));
        if (k < NS) {
            memcpy(r->b[k], stage_b(s, k), sizeof r->b[0]);
        }
        for (c = k * NUS; k < NS && c < (k + 1) * NUS; c++) {
            r->du[c] = q->side[c] != 0 ? qp_target(q, c) : R(0);
            q->target[c] = r->du[c];
        }
#if NG
        for (int m = stage_first[k]; m < stage_first[k + 1]; m++) {
            const int side = q->side[NV + m];
            if (side != 0) {
                const real_t l1 = side > 0 ? q->penalty[m] : -q->penalty[m];
                q->target[NV + m] = qp_target(q, NV + m);
                q->center[m] = (side == 1 || side == -1) ? q->mult[NV + m] : l1;
                qp_add_row(s, m, q->center[m] - r->weight[m] * q->target[NV + m], r->g[k]);
            }
        }
#endif
    }
}

/* The largest entry of every component of x and z. 0 if a number is not finite. */
static int qp_measure(qp_t *q)
{
    real_t sum = R(0);
    int i, k;
    for (i = 0; i < NZS; i++) {
        q->scale[i] = R(0);
    }
    for (k = 0; k <= NS; k++) {
        for (i = 0; i < NXS; i++) {
            const real_t size = FABS(q->x[k][i]);
            q->scale[i] = size > q->scale[i] ? size : q->scale[i];
            sum += size;
        }
    }
    for (k = 0; k < NS; k++) {
        for (i = 0; i < NUS; i++) {
            const real_t size = FABS(q->z[k * NUS + i]);
            q->scale[NXS + i] = size > q->scale[NXS + i] ? size : q->scale[NXS + i];
            sum += size;
        }
    }
    return isfinite(sum);
}

/* Multipliers at the minimiser on the working set. 0 if one, or the value of a row, is not finite. */
static int qp_take_multipliers(solver_t *s)
{
    qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    real_t sum = R(0);
    int k, c;
    for (c = 0; c < NV; c++) {
        k = c / NUS;
        q->mult[c] = R(0);
        if (q->side[c] != 0) {
            q->z[c] = q->target[c];
            q->mult[c] = -riccati_control_gradient(r, k, c % NUS, q->x[k], &q->z[k * NUS]);
            sum += FABS(q->mult[c]);
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        c = NV + m;
        q->value[m] = qp_row_value(s, m, q->x, q->z);
        q->mult[c] = q->side[c] != 0 ? q->center[m] + r->weight[m] * (q->value[m] - q->target[c]) : R(0);
        sum += FABS(q->value[m]);
    }
#endif
    return isfinite(sum);
}
