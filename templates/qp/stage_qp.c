/* The solvers of the stage QP share these functions: sides of bounds, rows, validation of bounds, and clearing of
 * results. A row has its gradient in the variables of one stage; a bound on a state is stored as the index of its
 * component. */

/* Side of a row. A member of the working set is an equation at its bound; a row BELOW or ABOVE is violated. */
enum { BELOW = -2, AT_LOWER = -1, INACTIVE = 0, AT_UPPER = 1, ABOVE = 2 };

static inline int qp_is_violated(int side)
{
    return side == BELOW || side == ABOVE;
}

static inline int qp_is_soft(const qp_t *q, int m)
{
    return q->penalty[m] < INF;
}

/* Returns a'z of the general row m, z = (x, u) at its stage; the last stage has no controls. */
static real_t qp_product(const solver_t *s, int m, const real_t *x, const real_t *u)
{
    const real_t *a = row_gradient(s, m);
    real_t sum = riccati_dot(a, x, NX);
    for (int j = 0; row_node(m) < N && j < NU; j++) {
        sum += a[NX + j] * u[j];
    }
    return sum;
}

/* Returns u of stage k. */
static inline const real_t *qp_stage_controls(const qp_t *q, int k)
{
    return q->z + k * NU;
}

/* Returns the value of row m at the present point (x, z). */
static inline real_t qp_row_value(const solver_t *s, int m)
{
    const int k = row_node(m);
    if (row_is_state(m)) {
        return s->qp.x[k][row_index(m)];
    }
    return qp_product(s, m, s->qp.x[k], qp_stage_controls(&s->qp, k));
}

/* Returns the change of the value of row m along the direction. */
static inline real_t qp_row_change(const solver_t *s, int m)
{
    const direction_t *d = &s->riccati.work.vectors.rhs.direction;
    const int k = row_node(m);
    if (row_is_state(m)) {
        return d->dx[k][row_index(m)];
    }
    return qp_product(s, m, d->dx[k], d->du + k * NU);
}

/* y += f a for row m, in the variables of its stage. */
static inline void qp_add_gradient(const solver_t *s, int m, real_t f, real_t *y)
{
    if (row_is_state(m)) {
        y[row_index(m)] += f;
        return;
    }
    const real_t factor[1] = {f};
    riccati_combine(y, factor, row_gradient(s, m), NZ, 1, row_node(m) < N ? NZ : NX);
}

/* g += f a for row m, where g is the gradient of its stage. */
static inline void qp_add_row(solver_t *s, int m, real_t f)
{
    qp_add_gradient(s, m, f, s->riccati.work.vectors.rhs.g[row_node(m)]);
}

/* Enlarges size[] to the largest magnitude of every component of x and z over the stages. */
static void qp_enlarge(const qp_t *q, real_t *size)
{
    for (int k = 0; k < N; k++) {
        enlarge_all(size, q->x[k], NX);
        enlarge_all(size + NX, qp_stage_controls(q, k), NU);
    }
    enlarge_all(size, q->x[N], NX);
}

/* Copies z = (x, u) of stage k. */
static inline void qp_stage_point(const qp_t *q, int k, real_t *z)
{
    (void)memcpy(z, q->x[k], sizeof q->x[0]);
    (void)memcpy(z + NX, qp_stage_controls(q, k), sizeof z[0] * NU);
}

/* y = g_k + Q_k z_k at the present point, for the components that stage k has, with dense products. */
static void qp_dense_gradient(solver_t *s, int k, real_t *y)
{
    real_t z[NZ];
    if (k < N) {
        qp_stage_point(&s->qp, k, z);
        (void)memcpy(y, stage_g(s, k), sizeof z);
        riccati_add_symmetric(y, stage_Q(s, k)[0], NZ, z, NZ);
    } else {
        (void)memcpy(y, stage_g(s, N), sizeof y[0] * NX);
        riccati_add_symmetric(y, stage_Q_N(s)[0], NX, s->qp.x[N], NX);
    }
}

/* y = g_k + Q_k z_k at the present point, over the nonzeros of the Hessian where they are few. */
static void qp_quadratic_gradient(solver_t *s, int k, real_t *y)
{
    if (CURVED) {
        if (s->curved.in_solve) {
            qp_dense_gradient(s, k, y);
            return;
        }
    }
    if (k < N) {
        if (HAS_COST_GRADIENT) {
            COST_GRADIENT(&s->node[k], stage_Q(s, k), s->qp.x[k], qp_stage_controls(&s->qp, k), y);
        } else {
            qp_dense_gradient(s, k, y);
        }
        return;
    }
    if (HAS_TERMINAL_ADJOINT) {
        TERMINAL_ADJOINT(&s->terminal, stage_Q_N(s), s->qp.x[N], y);
    } else {
        qp_dense_gradient(s, k, y);
    }
}

#if NG && REGULARIZE_REDUCED
/* y = g_k + Q_k z_k at the present point, with the rows that belong to the Hessian. */
static void qp_cost_gradient(solver_t *s, int k, real_t *y)
{
    qp_quadratic_gradient(s, k, y);
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (s->riccati.held[m] > R(0)) {
            qp_add_gradient(s, m, s->riccati.held[m] * qp_row_value(s, m), y);
        }
    }
}
#else
static void qp_cost_gradient(solver_t *s, int k, real_t *y)
{
    qp_quadratic_gradient(s, k, y);
}
#endif

/* Returns the multiplier of row m. For a row at its bound it lacks the part that the term of the row in the Hessian
 * adds; it is 0 if it then has the other sign, because the row would leave. */
static real_t qp_multiplier(const solver_t *s, int m)
{
    const real_t before = s->qp.mult[NV + m];
    if (REGULARIZE_REDUCED) {
        const int equation = s->qp.lower[NV + m] >= s->qp.upper[NV + m];
        if (s->riccati.held[m] > R(0) && (before < R(0) || before > R(0) || equation)) {
            const real_t after = before + s->riccati.held[m] * qp_row_value(s, m);
            return (!equation && before * after < R(0)) ? R(0) : after;
        }
    }
    return before;
}

/* b = S_k z_k + b_k - x_{k+1} at the present point. */
static void qp_gap(solver_t *s, int k, real_t *b)
{
    real_t(*S)[NZ] = stage_S(s, k);
    real_t z[NZ];
    qp_stage_point(&s->qp, k, z);
    for (int i = 0; i < NX; i++) {
        b[i] = stage_b(s, k)[i] - s->qp.x[k + 1][i] + riccati_dot(S[i], z, NZ);
    }
}

/* Resets the QP: no bounds, no prediction. */
static void qp_clear(qp_t *q)
{
    (void)memset(q, 0, sizeof *q);
    for (int c = 0; c < NV + NG; c++) {
        q->lower[c] = -INF;
        q->upper[c] = INF;
    }
    for (int m = 0; m < NG; m++) {
        q->penalty[m] = INF;
    }
}

/* Checks bounds and what violations cost. Returns NUMERICAL_FAILURE if a number is invalid, INFEASIBLE if bounds cross,
 * else OK. */
static status_t qp_check_bounds(const qp_t *q)
{
    int valid = 1, ordered = 1;
    for (int c = 0; c < NV + NG; c++) {
        valid &= q->lower[c] < INF && q->upper[c] > -INF;
        ordered &= q->lower[c] <= q->upper[c];
    }
    for (int m = 0; m < NG; m++) {
        valid &= q->penalty[m] >= R(0) && q->curvature[m] >= R(0) && isfinite(q->curvature[m]);
    }
    if (!valid) {
        return NUMERICAL_FAILURE;
    }
    return ordered ? OK : INFEASIBLE;
}

/* Clears the results after a failure. */
static void qp_clear_results(qp_t *q)
{
    (void)memset(q->x, 0, sizeof q->x);
    (void)memset(q->z, 0, sizeof q->z);
    (void)memset(q->mult, 0, sizeof q->mult);
    (void)memset(q->side, 0, sizeof q->side);
    (void)memset(q->certificate, 0, sizeof q->certificate);
    q->relaxed = 0;
}
