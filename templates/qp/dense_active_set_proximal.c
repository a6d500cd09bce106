/* Contract of this part: proximal-point iterations around them where H is only semidefinite. */

/* u = D^{1/2} L's */
static void qp_to_working_coordinates(const qp_t *q, const real_t *s, real_t *u)
{
    for (int i = 0; i < LDV; ++i) {
        u[i] = s[i];
        for (int j = i + 1; j < LDV; ++j) {
            u[i] += q->H[i][j] * s[j];
        }
        u[i] = u[i] / q->inverse[i];
    }
}

/* The largest t for which z + t p crosses no bound of a row that is not a member. */
static real_t qp_distance(const qp_t *q, const real_t *z, const real_t *p)
{
    real_t most = (real_t)INFINITY;
    for (int c = 0; c < NV + NG; ++c) {
        if (q->side[c] != 0 && !qp_saturated(q, c)) {
            continue;
        }
        const real_t value = c < NV ? z[c] : qp_dot(q->A[c - NV], z, LDV);
        const real_t slope = c < NV ? p[c] : qp_dot(q->A[c - NV], p, LDV);
        real_t over = value - q->upper[c], under = q->lower[c] - value;
        if (q->side[c] != 0) {
            qp_inside(q, c, &over, &under);
        }
        const real_t room = slope > R(0.0) ? -over : -under, speed = FABS(slope);
        if (speed > R(0.0) && room < most * speed) {
            most = room > R(0.0) ? room / speed : R(0.0);
        }
    }
    return most;
}

/* center += t p to the minimum along p = s + beta p, or to the next bound. On one face this is the conjugate gradient method
 * with the proximal step as the preconditioned residual, so it ends after as many steps as E has directions:
 *     beta = s'(H + E)s / (the one before),   t = s'(H + E)s / p'Hp,   p'Hp = |D^{1/2} L'p|^2 - p'Ep
 * Returns t; infinite: the cost decreases without end. total: s'(H + E)s. */
static real_t qp_conjugate_step(qp_t *q, const real_t *s, real_t total)
{
    const real_t beta = q->total > R(0.0) && q->face == q->changes ? total / q->total : R(0.0);
    real_t u[LDV], weighted = R(0.0);
    for (int i = 0; i < LDV; ++i) {
        q->direction[i] = s[i] + beta * q->direction[i];
        weighted += q->proximal[i] * q->direction[i] * q->direction[i];
    }
    qp_to_working_coordinates(q, q->direction, u);
    const real_t square = qp_dot(u, u, LDV), curvature = square - weighted;
    real_t t = qp_distance(q, q->center, q->direction);
    q->total = R(0.0);
    q->face = q->changes;
    if (curvature * qp_proximal_share() > TOL_QP_PIVOT * square && total < t * curvature) {
        t = total / curvature;
        q->total = total;
    }
    for (int i = 0; i < LDV; ++i) {
        q->center[i] += t * q->direction[i];
    }
    return t;
}

/* A proximal step s = x - center is known. OK: it is rounding, and x the minimiser. ITERATION_LIMIT: the centre has moved.
 * NUMERICAL_FAILURE: the cost is unbounded below. */
static status_t qp_move_center(qp_t *q)
{
    real_t s[LDV], u[LDV], e[LDV], weighted = R(0.0);
    const real_t size = q->scale + q->shift + SQRT(qp_dot(q->y, q->y, LDV));
    for (int i = 0; i < LDV; ++i) {
        s[i] = q->x[i] - q->center[i];
        weighted += q->proximal[i] * s[i] * s[i];
    }
    const real_t step = SQRT(weighted), before = q->step;
    q->step = step;
    if (step <= TOL_QP_PROXIMAL * size ||
        (step <= TOL_QP_PROXIMAL_STAGNATION * size && step > R(0.5) * before)) {
        return OK;
    }
    qp_to_working_coordinates(q, s, u);
    qp_coefficients(q, u, e);
    const real_t total = qp_dot(u, u, LDV), off = qp_dot(e, e, (q->nw + 3) / 4 * 4);
    if (off <= TOL_QP_DEPENDENT_PREDICTION * total) {
        return qp_conjugate_step(q, s, total) < (real_t)INFINITY ? ITERATION_LIMIT : NUMERICAL_FAILURE;
    }
    for (int i = 0; i < LDV; ++i) {
        q->center[i] = q->x[i];
    }
    q->total = R(0.0);
    return ITERATION_LIMIT;
}

/* The minimiser for a Hessian that is only semidefinite, by the proximal point method: z_{j+1} minimises the cost plus
 * 1/2 (z - z_j)'E(z - z_j), started at the working set of z_j. */
static status_t qp_iterate_proximal(qp_t *q)
{
    for (int i = 0; i < LDV; ++i) {
        q->center[i] = q->direction[i] = R(0.0);
    }
    q->total = R(0.0);
    q->step = (real_t)INFINITY;
    for (int step = 0; step < QP_MAX_PROXIMAL_STEPS; ++step) {
        qp_set_origin(q);
        status_t status = isfinite(q->scale) ? qp_iterate(q) : NUMERICAL_FAILURE;
        if (status == OK) {
            status = qp_move_center(q);
            if (status == ITERATION_LIMIT) {
                continue;
            }
        }
        return status;
    }
    return ITERATION_LIMIT;
}
