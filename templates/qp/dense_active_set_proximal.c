/* Proximal point iterations call the dual iterations if the Hessian is only semidefinite. */

/* u = C's, C' = D^{1/2} L'. */
static void qp_to_working_coordinates(const qp_t *q, const real_t *s, real_t *u)
{
    for (int k = 0; k < LDH; ++k) {
        u[k] = s[k];
        for (int i = k + 1; i < LDH; ++i) {
            u[k] += q->H[k][i] * s[i];
        }
        u[k] *= q->H[k][k] * q->inverse[k];
    }
    for (int k = LDH; k < LDV; ++k) {
        u[k] = s[k] / q->inverse[k];
    }
}

/* s'E s. */
static real_t qp_weighted_square(const qp_t *q, const real_t *s)
{
    real_t sum = R(0);
    for (int i = 0; i < NV; ++i) {
        sum += q->proximal[i] * s[i] * s[i];
    }
    return sum;
}

/* Returns the largest t for which z + t p crosses no bound of a row that is not a member. */
static real_t qp_distance(const qp_t *q, const real_t *z, const real_t *p)
{
    real_t over, under, most = INF;
    for (int c = 0; c < NV + NG; ++c) {
        const real_t slope = qp_value(q, c, p);
        const real_t speed = FABS(slope);
        if (!qp_is_member(q, c) && isfinite(qp_violations(q, c, z, &over, &under))) {
            const real_t room = slope > R(0) ? -over : -under;
            if (speed > R(0) && room < most * speed) {
                most = room > R(0) ? room / speed : R(0);
            }
        }
    }
    return most;
}

/* center += t p, up to the minimum along p = s + beta p or to the next bound. On one face this is the conjugate
 * gradient method with the proximal step as the preconditioned residual. It terminates after rank(E) steps:
 *     beta = s'(H + E)s / (its previous value),   t = s'(H + E)s / p'Hp,   p'Hp = |C'p|^2 - p'Ep
 * Returns t, which is infinite if the cost is unbounded below. total: s'(H + E)s. */
static real_t qp_conjugate_step(qp_t *q, const real_t *s, real_t total)
{
    const real_t beta = q->total > R(0) && q->face == q->changes ? total / q->total : R(0);
    real_t u[LDV];
    for (int i = 0; i < LDV; ++i) {
        q->direction[i] = s[i] + beta * q->direction[i];
    }
    qp_to_working_coordinates(q, q->direction, u);
    const real_t square = dot(u, u, LDV), curvature = square - qp_weighted_square(q, q->direction);
    real_t t = qp_distance(q, q->center, q->direction);
    q->total = R(0);
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

/* Moves the centre after the proximal step s = x - center. Returns OK if s is at rounding level, so that x is the
 * minimiser; ITERATION_LIMIT if the centre has moved; NUMERICAL_FAILURE if the cost is unbounded below. x replaces the
 * centre after a shorter step if the row that ends the step is violated only by a rounding error. */
static status_t qp_move_center(qp_t *q)
{
    real_t s[LDV], u[LDV], e[LDV];
    const real_t size = q->scale + norm(q->work.basis.y), before = q->step;
    for (int i = 0; i < LDV; ++i) {
        s[i] = q->x[i] - q->center[i];
    }
    q->step = SQRT(qp_weighted_square(q, s));
    if (q->step <= TOL_QP_PROXIMAL * size ||
        (q->step <= TOL_QP_PROXIMAL_STAGNATION * size && q->step > R(0.5) * before)) {
        return OK;
    }
    qp_to_working_coordinates(q, s, u);
    qp_coefficients(q, u, e);
    const real_t total = dot(u, u, LDV), left = dot(e, e, qp_panel_count(q)), rounding = TOL_QP_PROXIMAL * size;
    const int on_face = left <= TOL_QP_DEPENDENT_PREDICTION * total || left <= rounding * rounding;
    const real_t t = on_face ? qp_conjugate_step(q, s, total) : R(0);
    if (t < R(1)) {
        copy(q->center, q->x);
        q->total = R(0);
    }
    return t < INF ? ITERATION_LIMIT : NUMERICAL_FAILURE;
}

/* Computes the minimiser for a Hessian that is only semidefinite, by the proximal point method: z_{j+1} minimises the
 * cost plus 1/2 (z - z_j)'E(z - z_j), starting from the working set of z_j. */
static status_t qp_iterate_proximal(qp_t *q)
{
    status_t status = ITERATION_LIMIT;
    clear(q->center);
    clear(q->direction);
    q->total = R(0);
    q->step = INF;
    while (status == ITERATION_LIMIT) { /* at most QP_MAX_PROXIMAL_STEPS passes in qp_solve */
        if (q->proximal_steps++ >= QP_MAX_PROXIMAL_STEPS) {
            return ITERATION_LIMIT;
        }
        status = qp_iterate(q);
        if (status != OK) {
            return status;
        }
        status = qp_move_center(q);
    }
    return status;
}
