/* This part refines the minimiser on the working set to rounding accuracy. Corrections are computed with the present
 * factors from the residuals of the original optimality conditions, so that perturbations in the factors (weights of
 * members, additions to pivots) cost iterations, not accuracy. For members this is the method of multipliers, for
 * pivots the proximal point method. */

/* Returns 1 if the factors differ from those of the original problem on the working set. */
static int qp_is_approximate(const solver_t *s)
{
    int approximate = 0;
    for (int k = 0; k <= N; k++) {
        approximate |= s->riccati.raised[k];
    }
    for (int m = 0; m < NG; m++) {
        approximate |= qp_is_member(s->qp.side[NV + m]) && !s->schur.active;
    }
    return approximate;
}

/* Stores the gradient of the Lagrangian at stage k and the gap of the dynamics in the right-hand sides. */
static void qp_residual(solver_t *s, int k)
{
    const qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    real_t *y = r->work.vectors.rhs.g[k];
    qp_cost_gradient(s, k, y);
    if (k < N) {
        riccati_combine(y, r->work.vectors.lam[k + 1], stage_S(s, k)[0], NZ, NX, NZ);
        qp_gap(s, k, r->b[k]);
        for (int i = 0; i < NU; i++) {
            y[NX + i] += q->mult[k * NU + i];
            r->du[k * NU + i] = R(0);
        }
    }
    for (int i = 0; k > 0 && i < NX; i++) {
        y[i] -= r->work.vectors.lam[k][i];
    }
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (q->side[NV + m] != INACTIVE) {
            qp_add_row(s, m, q->mult[NV + m]);
        }
    }
}

/* Increases size[] to at least the terms of the gradient at stage k < N: for states the multipliers of the dynamics,
 * for controls their products with B. */
static void qp_take_sizes(solver_t *s, int k, real_t *size)
{
    const real_t *g = stage_g(s, k), *lam = s->riccati.work.vectors.lam[k + 1];
    real_t(*S)[NZ] = stage_S(s, k);
    for (int i = 0; i < NX; i++) {
        const real_t term = FABS(lam[i]) + FABS(g[i]);
        size[i] = term > size[i] ? term : size[i];
    }
    for (int j = 0; j < NU; j++) {
        real_t terms = FABS(s->qp.mult[k * NU + j]) + FABS(g[NX + j]);
        for (int i = 0; i < NX; i++) {
            terms += FABS(lam[i]) * FABS(S[i][NX + j]);
        }
        size[NX + j] = terms > size[NX + j] ? terms : size[NX + j];
    }
}

/* Returns the largest entry of the gradient relative to the magnitude of its terms, which is at least that of zeros. */
static real_t qp_gradient_size(solver_t *s)
{
    real_t *size = s->qp.size, worst = R(0);
    (void)memset(size, 0, sizeof s->qp.size);
    for (int i = 0; i < NX; i++) {
        size[i] = TOL_ZERO * force_size[i];
    }
    for (int j = 0; j < NU; j++) {
        size[NX + j] = TOL_ZERO * force_size[NX + j];
    }
    for (int k = 0; k < N; k++) {
        qp_take_sizes(s, k, size);
    }
    for (int k = 0; k <= N; k++) {
        const real_t *g = s->riccati.work.vectors.rhs.g[k];
        for (int i = k == 0 ? NX : 0; i < (k < N ? NZ : NX); i++) {
            const real_t y = FABS(g[i]);
            worst = y > worst * size[i] ? y / size[i] : worst;
        }
    }
    return worst;
}

/* Returns the distance of the value of member m from its bound. */
static inline real_t qp_offset(const qp_t *q, int m)
{
    return q->value[m] - q->target[m];
}

/* Returns the step length for the correction (dx, du) that minimises (d + times change)'W(d + times change), where d
 * are the distances of the members from their bounds. If members are nearly dependent, the method of multipliers takes
 * short steps in one direction. */
static real_t qp_stretch(const solver_t *s)
{
    const qp_t *q = &s->qp;
    real_t gain = R(0), size = R(0);
    for (int m = 0; m < NG; m++) {
        if (qp_is_member(q->side[NV + m])) {
            const real_t change = qp_row_change(s, m);
            gain -= s->riccati.weight[m] * change * qp_offset(q, m);
            size += s->riccati.weight[m] * change * change;
        }
    }
    if (!(gain > size)) {
        return R(1);
    }
    return gain < FACTOR_RICCATI_LONGEST_STEP * size ? gain / size : FACTOR_RICCATI_LONGEST_STEP;
}

/* Adds the correction to the multipliers of the rows. For members the small value of the correction is used, because
 * the weight would amplify the rounding error of a'z - t. */
static void qp_correct_rows(solver_t *s, real_t times)
{
    qp_t *q = &s->qp;
    for (int m = 0; m < NG; m++) {
        const int side = q->side[NV + m];
        const real_t change = qp_row_change(s, m), rest = qp_is_member(side) ? qp_offset(q, m) : R(0);
        if (side != INACTIVE) {
            q->mult[NV + m] += times * s->riccati.weight[m] * (change + rest);
        }
        q->value[m] = qp_row_value(s, m);
    }
}

#if END_EQUATIONS
/* Returns the magnitude of the terms of member m, and of the value of the row in the plan; the bound is a difference of
 * these. */
static real_t qp_member_size(const solver_t *s, int m)
{
    return qp_row_size(s, m) + FABS(s->qp.target[m]) + FABS(row_constant(s, m));
}

/* Returns the largest distance of a member from its bound, relative to qp_member_size(). Terminal equations are members
 * at every sample. Near a steady state their terms are rounding errors, so that a distance is also negligible if its
 * cost is negligible beside that of the largest member. */
static real_t qp_distance(const solver_t *s)
{
    const qp_t *q = &s->qp;
    real_t largest = R(0), most = R(0);
    for (int m = 0; m < NG; m++) {
        const real_t force = qp_is_member(q->side[NV + m]) ? q->root[m] * qp_member_size(s, m) : R(0);
        most = force > most ? force : most;
    }
    for (int m = 0; m < NG; m++) {
        if (qp_is_member(q->side[NV + m])) {
            const real_t distance = FABS(qp_offset(q, m));
            const real_t size = qp_member_size(s, m) + SQRT(TOL_UNIT) * most / q->root[m];
            largest = distance > largest * size ? distance / size : largest;
        }
    }
    return largest;
}
#else
/* Returns the largest relative distance of a member from its bound. */
static real_t qp_distance(const solver_t *s)
{
    const qp_t *q = &s->qp;
    real_t largest = R(0);
    for (int m = 0; m < NG; m++) {
        if (qp_is_member(q->side[NV + m])) {
            const real_t distance = FABS(qp_offset(q, m));
            const real_t size = qp_row_size(s, m) + FABS(q->target[m]);
            largest = distance > largest * size ? distance / size : largest;
        }
    }
    return largest;
}
#endif

/* Adds `times` the correction (dx, du) and the corresponding change of the multipliers. */
static void qp_add_correction(solver_t *s, real_t times)
{
    qp_t *q = &s->qp;
    const riccati_t *r = &s->riccati;
    vectors_t *v = &s->riccati.work.vectors;
    const direction_t *d = &v->rhs.direction;
    for (int k = 0; k <= N; k++) {
        real_t lam[NX];
        riccati_adjoint(r, k, d->dx[k], lam);
        for (int i = 0; i < NX; i++) {
            v->lam[k][i] += times * lam[i];
            q->x[k][i] += times * d->dx[k][i];
        }
    }
    for (int k = 0; k < N; k++) {
        const int first = k * NU;
        for (int j = 0; j < NU; j++) {
            if (q->side[first + j] != INACTIVE) {
                q->mult[first + j] -= times * riccati_control_gradient(r, k, j, d->dx[k], d->du + first);
            }
            q->z[first + j] += times * d->du[first + j];
        }
    }
    qp_correct_rows(s, times);
}

/* Computes the correction of (x, z, lam, mult) for the residuals in the right-hand sides, to which weight (a'z - t) a
 * of the members is added. */
static void qp_direction(solver_t *s)
{
    direction_t *d = &s->riccati.work.vectors.rhs.direction;
    for (int m = 0; m < NG; m++) {
        if (qp_is_member(s->qp.side[NV + m])) {
            qp_add_row(s, m, s->riccati.weight[m] * qp_offset(&s->qp, m));
        }
    }
    riccati_backward(s, N);
    (void)memset(d->dx[0], 0, sizeof d->dx[0]);
    riccati_forward(s, d->dx, d->du);
}

/* Stores the residuals in the right-hand sides and the largest relative residual in q->residual; at_members is set if
 * the latter is a distance of a member from its bound. Returns 0 if it is not finite. */
static int qp_take_residuals(solver_t *s, int *at_members)
{
    qp_t *q = &s->qp;
    for (int k = 0; k <= N; k++) {
        qp_residual(s, k);
    }
    q->residual = qp_gradient_size(s);
    *at_members = 0;
    if (NG) {
        const real_t distance = qp_distance(s);
        *at_members = distance >= q->residual;
        q->residual = distance > q->residual ? distance : q->residual;
    }
    return isfinite(q->residual) && qp_measure(q);
}

/* Corrects until the residuals are at rounding level. If convergence is slow near that level, every other correction is
 * stretched. Returns OK; STALLED if the residuals stop decreasing, as they do when members contradict one another;
 * NUMERICAL_FAILURE. */
static status_t qp_refine(solver_t *s)
{
    qp_t *q = &s->qp;
    real_t slow = INF;
    int stretched = 0;
    for (int k = 0; k <= N; k++) {
        riccati_adjoint(&s->riccati, k, q->x[k], s->riccati.work.vectors.lam[k]);
    }
    q->stale_vectors = N;
    q->refined = 1;
    q->residual = INF;
    for (int i = 0; i <= QP_MAX_REFINEMENTS; i++) {
        const real_t before = q->residual;
        int at_members;
        if (!qp_take_residuals(s, &at_members)) {
            return NUMERICAL_FAILURE;
        }
        if (q->residual <= TOL_RICCATI_REFINED) {
            return OK;
        }
        stretched = !stretched && q->residual > R(0.5) * before;
        if (stretched && (!at_members || q->residual > TOL_RICCATI_ROUNDING || q->residual > R(0.5) * slow)) {
            return STALLED;
        }
        slow = stretched ? q->residual : slow;
        qp_direction(s);
        if (NG) {
            qp_add_correction(s, stretched ? qp_stretch(s) : R(1));
        } else {
            qp_add_correction(s, R(1));
        }
        q->refinements++;
    }
    return STALLED;
}
