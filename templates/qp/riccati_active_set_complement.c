/* This part treats the rows of a small working set as equations, without weights.
 *
 * With H the factorised Hessian on the null space of the dynamics and the fixed controls, and A the gradients of the
 * members, multipliers that grow by d move the values of the members by -C d, where C = A H^{-1} A' is the Schur
 * complement. One sweep through the stages gives
 *     push   gradient of the controls for a unit multiplier of a member: w_u of a backward substitution
 *     pull   gradient of x_0 for a unit multiplier, which is also the change of the value of the member with x_0
 *     C      sum over the stages of push' M_uu^{-1} push, and the part of what is free at the start
 * As H does not depend on the members, a change of the members requires no recursion.
 *   schur_begin       decides whether the QP is solved in this way; clears `applies` if not.
 *   schur_update      push, pull, C and its factors for the present members and factors. `applies` becomes 0 if
 *                     there are too many members, or if a pivot of H was raised.
 *   schur_set_origin  values of the members for dx_0 = 0.
 *   schur_impose      called before the forward substitution from dx_0.
 *   schur_holds       called after it. `applies` becomes 0 if members are off their bounds, as when they contradict one
 *                     another: members that depend on others keep their multipliers. */

/* Number of QPs for which members have weights after the method has failed. */
enum { WEIGHTED_QPS = 8 };

/* Returns 1 if a pivot of the recursion was raised. */
static int qp_is_raised(const solver_t *s)
{
    int raised = 0;
    for (int k = 0; k <= N; k++) {
        raised |= s->riccati.raised[k];
    }
    return raised;
}

/* Decides whether this QP is solved with the Schur complement. */
static void schur_begin(solver_t *s)
{
    schur_t *c = &s->schur;
    int members = 0;
    for (int m = 0; m < NG; m++) {
        members += qp_is_member(s->qp.side[NV + m]);
    }
    c->active = c->applies = c->weighted == 0 && members <= QP_MAX_JOINT;
    c->weighted -= c->weighted > 0;
}

/* Lists the members in the order of their stages; returns 0 if there are too many. */
static int schur_list(solver_t *s)
{
    schur_t *c = &s->schur;
    c->joint = 0;
    for (int m = 0; m < NG; m++) {
        if (qp_is_member(s->qp.side[NV + m])) {
            if (c->joint == QP_MAX_JOINT) {
                return 0;
            }
            c->member[c->joint] = m;
            c->joint++;
        }
    }
    return 1;
}

/* Loads the gradient w of member i in the variables of its stage. */
static inline void schur_load(const solver_t *s, int i, real_t *w)
{
    const int m = s->schur.member[i];
    if (!row_is_state(m)) {
        (void)memcpy(w, row_gradient(s, m), sizeof w[0] * (row_node(m) < N ? NZ : NX));
        return;
    }
    w[row_index(m)] = R(1);
}

/* Moves push and pull of member i from stage k + 1 to stage k. */
static inline void schur_sweep_stage(solver_t *s, int k, int i)
{
    const riccati_t *r = &s->riccati;
    schur_t *c = &s->schur;
    const int m = c->member[i];
    real_t w[NZ] = {0};
    if (row_node(m) == k) {
        schur_load(s, i, w);
    } else {
        riccati_combine(w, c->pull[i], stage_S(s, k)[0], NZ, NX, NZ);
    }
    (void)memcpy(c->push[k][i], w + NX, sizeof c->push[0][0]);
    (void)memcpy(c->pull[i], w, sizeof w[0] * NX);
    riccati_combine(c->pull[i], w + NX, r->K[k][0], LDX, NU, LDX);
}

/* y = M_uu^{-1} y for the free controls of stage k; fixed controls get 0. */
static inline void schur_solve_controls(const riccati_t *r, int k, real_t *y)
{
    for (int j = 0; j < NU; j++) {
        y[j] = r->fixed[k * NU + j] ? R(0) : y[j];
    }
    riccati_solve_controls(r, k, y);
}

/* Adds push' M_uu^{-1} push of stage k to C, lower triangle; members of earlier stages have push = 0. */
static inline void schur_add_stage(solver_t *s, int k, int first)
{
    schur_t *c = &s->schur;
    for (int i = first; i < c->joint; i++) {
        real_t y[NU];
        (void)memcpy(y, c->push[k][i], sizeof y);
        schur_solve_controls(&s->riccati, k, y);
        for (int j = first; j <= i; j++) {
            for (int l = 0; l < NU; l++) {
                c->complement[i][j] += c->push[k][j][l] * y[l];
            }
        }
    }
}

static void schur_sweep(solver_t *s)
{
    schur_t *c = &s->schur;
    int first = c->joint; /* 0 <= first <= QP_MAX_JOINT */
    (void)memset(c->push, 0, sizeof c->push);
    (void)memset(c->pull, 0, sizeof c->pull);
    (void)memset(c->complement, 0, sizeof c->complement);
    for (int i = 0; i < c->joint; i++) {
        if (row_node(c->member[i]) == N) {
            schur_load(s, i, c->pull[i]);
        }
    }
    for (int k = N - 1; k >= 0; k--) {
        for (int i = c->joint - 1; i >= 0; i--) {
            if (row_node(c->member[i]) >= k) {
                schur_sweep_stage(s, k, i);
                first = i < first ? i : first;
            }
        }
        schur_add_stage(s, k, first);
    }
}

/* Adds the part of the free components f of x_0 to C, pull_f' P_ff^{-1} pull_f, and to pull their change with the other
 * components. p_0 is used as memory. */
static void schur_add_free(solver_t *s)
{
    riccati_t *r = &s->riccati;
    schur_t *c = &s->schur;
    for (int i = 0; i < c->joint; i++) {
        real_t v[NX] = {0};
        for (int l = 0; l < NX; l++) {
            r->p[0][l] = -c->pull[i][l];
        }
        riccati_solve_free(r, v);
        for (int j = 0; j <= i; j++) {
            for (int f = 0; f < NF; f++) {
                c->complement[i][j] += c->pull[j][free_state[f]] * v[free_state[f]];
            }
        }
        for (int l = 0; l < NX; l++) {
            c->pull[i][l] -= riccati_dot(r->P[0][l], v, NX);
        }
        for (int f = 0; f < NF; f++) {
            c->pull[i][free_state[f]] = -r->p[0][free_state[f]];
        }
    }
}

/* C = L D L', with 1 / D on the diagonal; it is 0 for a member whose gradient is a combination of those before. */
static void schur_decompose(schur_t *c)
{
    real_t least[QP_MAX_JOINT] = {R(0)};
    for (int l = 0; l < c->joint; l++) {
        least[l] = TOL_RICCATI_DEPENDENT * c->complement[l][l];
    }
    for (int l = 0; l < c->joint; l++) {
        const real_t pivot = c->complement[l][l], inverse = pivot > least[l] ? R(1) / pivot : R(0);
        c->complement[l][l] = inverse;
        for (int i = l + 1; i < c->joint; i++) {
            const real_t y = c->complement[i][l];
            c->complement[i][l] = y * inverse;
            for (int j = l + 1; j <= i; j++) {
                c->complement[i][j] -= y * c->complement[j][l];
            }
        }
    }
}

/* Computes push, pull, C and its factors. Returns 0 if the method does not apply. */
static int schur_renew(solver_t *s)
{
    schur_t *c = &s->schur;
    if (!schur_list(s)) {
        return 0;
    }
    if (c->joint > 0) {
        if (qp_is_raised(s)) {
            return 0;
        }
        schur_sweep(s);
        if (NF) {
            schur_add_free(s);
        }
        schur_decompose(c);
    }
    return 1;
}

/* Updates the Schur complement if it is in use. Vectors that contain corrections are stale. */
static void schur_update(solver_t *s)
{
    qp_t *q = &s->qp;
    schur_t *c = &s->schur;
    c->swept &= q->stale < 0;
    if (c->active && (!c->swept || c->shifted)) {
        q->stale_vectors = N;
    }
    if (c->active && !c->swept) {
        c->applies = schur_renew(s);
        c->swept = c->applies;
    }
}

/* Computes the values of the members of the working set for dx_0 = 0; called after a backward substitution. */
static void schur_set_origin(solver_t *s)
{
    schur_t *c = &s->schur;
    direction_t *d = &s->riccati.work.vectors.rhs.direction;
    c->shifted = 0;
    if (c->active && c->applies && c->joint > 0) {
        (void)memset(d->dx[0], 0, sizeof d->dx[0]);
        riccati_forward(s, d->dx, d->du);
        for (int i = 0; i < c->joint; i++) {
            c->origin[i] = qp_row_change(s, c->member[i]);
        }
    }
}

/* d = C^{-1} d, 0 for members that depend on others. */
static void schur_substitute(const schur_t *c, real_t *d)
{
    for (int i = 1; i < c->joint; i++) {
        for (int j = 0; j < i; j++) {
            d[i] -= c->complement[i][j] * d[j];
        }
    }
    for (int i = c->joint - 1; i >= 0; i--) {
        d[i] *= c->complement[i][i];
        for (int j = i + 1; j < c->joint; j++) {
            d[i] -= c->complement[j][i] * d[j];
        }
    }
}

/* Changes the multipliers of the members, and the vectors of the substitution, so that the distances vanish. */
static void schur_correct(solver_t *s, real_t *distance)
{
    riccati_t *r = &s->riccati;
    schur_t *c = &s->schur;
    schur_substitute(c, distance);
    for (int i = 0; i < c->joint; i++) {
        s->qp.center[c->member[i]] += distance[i];
        if (NF) {
            riccati_add(r->p[0], distance[i], c->pull[i], LDX);
        }
    }
    for (int k = 0; k < N; k++) {
        real_t y[NU] = {0};
        riccati_combine(y, distance, c->push[k][0], NU, c->joint, NU);
        for (int j = 0; j < NU; j++) {
            r->h[k][j] += y[j];
        }
        schur_solve_controls(r, k, y);
        for (int j = 0; j < NU; j++) {
            r->feed[k][j] -= y[j];
        }
    }
    c->shifted = 1;
}

/* Computes the distances of the members of the working set from their bounds for dx_0 = step.dx[0]. */
static void schur_distances(const solver_t *s, real_t *distance)
{
    const schur_t *c = &s->schur;
    real_t x[LDX] = {0};
    (void)memcpy(x, s->step.dx[0], sizeof x[0] * NX);
    for (int f = 0; f < NF; f++) {
        x[free_state[f]] = R(0);
    }
    for (int i = 0; i < c->joint; i++) {
        distance[i] = c->origin[i] + riccati_dot(c->pull[i], x, LDX) - s->qp.target[c->member[i]];
    }
}

/* Corrects the vectors of the substitution for the members and dx_0, if the Schur complement is in use. */
static void schur_impose(solver_t *s)
{
    if (s->schur.active && s->schur.applies && s->schur.joint > 0) {
        real_t distance[QP_MAX_JOINT] = {0};
        schur_distances(s, distance);
        schur_correct(s, distance);
    }
}

/* Returns 1 if the minimiser satisfies the members, if need be after a second correction, which removes the rounding
 * errors of the first one. */
static int schur_holds(solver_t *s)
{
    schur_t *c = &s->schur;
    if (c->applies && qp_distance(s) > TOL_RICCATI_FEASIBILITY) {
        real_t distance[QP_MAX_JOINT] = {0};
        for (int i = 0; i < c->joint; i++) {
            distance[i] = qp_offset(&s->qp, c->member[i]);
        }
        schur_correct(s, distance);
        riccati_forward(s, s->qp.x, s->qp.z);
        c->applies = qp_measure(&s->qp) && qp_take_multipliers(s) && qp_distance(s) <= TOL_RICCATI_FEASIBILITY;
    }
    return c->applies;
}
