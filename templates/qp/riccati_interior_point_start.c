/* Contract of this part: units of the rows and the first iterate, from the minimiser that knows equations only. */

/* Stage k under u = K x + G xi, unit covariance of xi: G' (columns of fixed controls 0, G G' = M_uu^{-1}) into `noise`,
 * (A + B K)' into `closed`, (B G)' into `push`. */
static void ipm_closed_loop(solver_t *s, int k)
{
    const riccati_t *r = &s->riccati;
    ipm_t *q = &s->ipm;
    real_t (*S)[NZS] = stage_S(s, k);
    real_t column[LDX] = {0};
    int i, j, l;
    for (l = 0; l < NUS; l++) {
        const int fixed = r->fixed[k * NUS + l];
        for (j = NUS - 1; j >= 0; j--) {
            q->noise[l][j] = (j == l && !fixed) ? SQRT(r->inverse[k][l]) : R(0);
            for (i = j + 1; i <= l; i++) {
                q->noise[l][j] -= r->L[k][i][j] * q->noise[l][i];
            }
        }
    }
    for (l = 0; l < NXS; l++) {
        for (i = 0; i < NXS; i++) {
            q->closed[l][i] = S[i][l];
        }
    }
    memset(q->push, 0, sizeof q->push);
    for (j = 0; j < NUS; j++) {
        for (i = 0; i < NXS; i++) {
            column[i] = S[i][NXS + j];
        }
        for (l = 0; l < NXS; l++) {
            riccati_add(q->closed[l], r->K[k][j][l], column, LDX);
        }
        for (l = 0; l < NUS; l++) {
            riccati_add(q->push[l], q->noise[l][j], column, LDX);
        }
    }
}

/* Covariance of x_{k+1}:  closed' C closed + push' push. */
static void ipm_propagate_covariance(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t *C = q->covariance[0], *U = q->product[0], *F = q->closed[0];
    int i, j;
    memset(q->product, 0, sizeof q->product);
    for (i = 0; i < LDX; i += 4) {
        riccati_rows(U + i * LDX, LDX, C + i, LDX, F, LDX, NXS, LDX);
    }
    memset(q->covariance, 0, sizeof q->covariance);
    for (i = 0; i < LDX; i += 4) {
        riccati_rows(C + i * LDX, LDX, F + i, LDX, U, LDX, NXS, i + 4);
        riccati_rows(C + i * LDX, LDX, q->push[0] + i, LDX, q->push[0], LDX, NUS, i + 4);
    }
    for (i = 0; i < LDX; i++) {
        for (j = i + 1; j < LDX; j++) {
            q->covariance[i][j] = q->covariance[j][i];
        }
    }
}

/* (a' Cov(x, u) a)^{1/2} at stage k:  c = a_x + K'a_u,  c' C c + |G'a_u|^2. */
static real_t ipm_reach(solver_t *s, int k, const real_t *a_x, const real_t *a_u)
{
    ipm_t *q = &s->ipm;
    real_t c[LDX] = {0}, w[LDX] = {0}, sum = R(0);
    int l;
    memcpy(c, a_x, sizeof c[0] * NXS);
    for (l = 0; k < NS && l < NUS; l++) {
        const real_t part = riccati_dot(q->noise[l], a_u, NUS);
        riccati_add(c, a_u[l], s->riccati.K[k][l], LDX);
        sum += part * part;
    }
    riccati_combine(w, c, q->covariance[0], LDX, NXS, LDX);
    sum += riccati_dot(w, c, LDX);
    return (sum > R(0)) ? SQRT(sum) : R(0);
}

/* Controls and rows of stage k. */
static void ipm_stage_reach(solver_t *s, int k)
{
    ipm_t *q = &s->ipm;
    real_t zero[NZS] = {0};
    int j, m;
    for (j = 0; k < NS && j < NUS; j++) {
        zero[NXS + j] = R(1);
        q->reach[k * NUS + j] = ipm_reach(s, k, zero, zero + NXS);
        zero[NXS + j] = R(0);
    }
    for (m = stage_first[k]; m < stage_first[k + 1]; m++) {
        const int i = stage_state[m];
        if (i >= 0) {
            const real_t variance = q->covariance[i][i];
            q->reach[NV + m] = (variance > R(0)) ? SQRT(variance) : R(0);
        } else {
            const real_t *a = stage_row(s, m);
            q->reach[NV + m] = ipm_reach(s, k, a, (k < NS) ? a + NXS : zero);
        }
    }
}

/* reach_c = (a_c'H^{-1}a_c)^{1/2}: how far one half unit of cost moves row c, H that of the factorisation on the null space of
 * the dynamics. Covariances of a linear system driven by unit noise: those of the variables have the inverse H^{-1}. 0: no control
 * moves the row. */
static void ipm_set_reach(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int k, f;
    memset(q->covariance, 0, sizeof q->covariance);
    for (f = 0; f < NF; f++) {
        memset(s->riccati.p[0], 0, sizeof s->riccati.p[0]);
        s->riccati.p[0][free_state[f]] = -R(1);
        riccati_solve_free(&s->riccati, q->covariance[free_state[f]]);
    }
    for (f = 0; f < NXS - NX; f++) {
        memcpy(q->covariance[NX + f], q->covariance[copied_state[f]], sizeof q->covariance[0]);
    }
    for (k = 0; k < NS; k++) {
        ipm_closed_loop(s, k);
        ipm_stage_reach(s, k);
        ipm_propagate_covariance(s);
    }
    ipm_stage_reach(s, NS);
}

/* Recursion with the present weights; where a pivot may be zero, with an addition to it that grows until it is enough. */
static int ipm_factorize(solver_t *s)
{
    riccati_t *r = &s->riccati;
    int attempt;
    r->regularize = 0;
    r->regularize_zero = R(0);
    if (riccati_factorize(s, NS)) {
        return 1;
    }
    r->regularize = 1;
    r->regularize_zero = s->ipm.least_pivot;
    for (attempt = 0; attempt < 5; attempt++) {
        if (riccati_factorize(s, NS)) {
            return 1;
        }
        r->regularize_zero *= R(1024);
    }
    return 0;
}

/* A cost for the bounded rows of a QP whose Hessian is singular without them: the largest of Q_jj d^2 and |g_j| d over the
 * controls with two finite bounds, d apart. */
static real_t ipm_damping_cost(solver_t *s)
{
    real_t most = R(0);
    int k, j;
    for (k = 0; k < NS; k++) {
        for (j = 0; j < NUS; j++) {
            const real_t d = s->qp.upper[k * NUS + j] - s->qp.lower[k * NUS + j];
            const real_t square = stage_Q(s, k)[NXS + j][NXS + j] * d * d;
            const real_t linear = FABS(stage_g(s, k)[NXS + j]) * d;
            most = (isfinite(square) && square > most) ? square : most;
            most = (isfinite(linear) && linear > most) ? linear : most;
        }
    }
    return (most > R(0)) ? most : R(1);
}

/* What is added to a pivot that is zero and has no scale of its own. */
static real_t ipm_least_pivot(solver_t *s)
{
    real_t most = R(0);
    int k, i;
    for (k = 0; k <= NS; k++) {
        for (i = 0; i < ((k < NS) ? NZS : NXS); i++) {
            const real_t d = (k < NS) ? stage_Q(s, k)[i][i] : stage_Q_N(s)[i][i];
            most = (d > most) ? d : most;
        }
    }
    return SQRT(TOL_UNIT) * ((most > R(0) && isfinite(most)) ? most : R(1));
}

/* Where the Hessian is singular the steps are those of the proximal point method, or rounding drives them along its null space:
 * a small share of the largest diagonal entry of each control and free component of x_0. */
static void ipm_set_proximal(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int k, i;
    for (i = 0; i < NZS; i++) {
        real_t most = R(0);
        for (k = 0; k < NS; k++) {
            most = (stage_Q(s, k)[i][i] > most) ? stage_Q(s, k)[i][i] : most;
        }
        most = SQRT(TOL_UNIT) * most;
        q->proximal[i] = R(64) * ((most > R(0)) ? most : q->least_pivot);
    }
}

/* Weights for the first factorisation: equations, and if the Hessian needs it a damping of the rows with two bounds. */
static void ipm_first_weights(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int c;
    for (c = 0; c < NV + NG; c++) {
        const real_t d = s->qp.upper[c] - s->qp.lower[c];
        q->weight[c] = (q->kind[c] == 1) ? q->stiffness[c] : R(0);
        if (q->damping > R(0) && q->kind[c] == 0 && d > R(0) && isfinite(d)) {
            q->weight[c] = q->damping / (d * d);
        }
    }
    ipm_set_weights(s);
}

/* An equation is met in one step but for a small share of its reach^2 times the multiplier. Returns 1 if there is one. */
static int ipm_set_stiffness(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int c, any = 0;
    for (c = 0; c < NV + NG; c++) {
        const int equation = q->kind[c] == 1 && q->reach[c] > R(0);
        q->stiffness[c] = R(0);
        if (equation) {
            q->stiffness[c] = R(1) / (TOL_IPM_EQUATION_REGULARIZATION * q->reach[c] * q->reach[c]);
        }
        any |= equation;
    }
    return any;
}

/* Factorisation of the problem with equations only, and units of the rows. plain: as in ipm_prepare(). */
static int ipm_first_factorization(solver_t *s, int plain)
{
    ipm_t *q = &s->ipm;
    int c, stands = plain;
    memset(q->stiffness, 0, sizeof q->stiffness);
    memset(q->proximal, 0, sizeof q->proximal);
    q->damping = R(0);
    q->stiffening = R(1);
    q->least_pivot = ipm_least_pivot(s);
    ipm_first_weights(s);
    s->riccati.regularize = 0;
    for (c = 0; c < NV; c++) {
        stands &= !s->riccati.fixed[c];
    }
    if (!stands && !riccati_factorize(s, NS)) {
        q->damping = ipm_damping_cost(s);
        ipm_set_proximal(s);
        ipm_first_weights(s);
        if (!ipm_factorize(s)) {
            return 0;
        }
    }
    ipm_set_reach(s);
    if (ipm_set_stiffness(s)) {
        ipm_first_weights(s);
        return ipm_factorize(s);
    }
    return 1;
}

/* Multipliers that the rows would have at v = 0, where the first point is computed from; values of the fixed controls. Returns 1
 * if something has changed. */
static int ipm_first_forces(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int c, changed = 0;
    for (c = 0; c < NV + NG; c++) {
        const real_t middle = R(0.5) * (s->qp.lower[c] + s->qp.upper[c]);
        const real_t f = (q->weight[c] > R(0)) ? -q->weight[c] * middle : R(0);
        const real_t u = (q->kind[c] == 2) ? s->qp.lower[c] : R(0);
        changed |= !(f >= q->force[c] && f <= q->force[c]);
        q->force[c] = f;
        if (c < NV) {
            changed |= !(u >= s->riccati.du[c] && u <= s->riccati.du[c]);
            s->riccati.du[c] = u;
        }
    }
    return changed;
}

/* The backward substitution that does not need dx_0. */
static void ipm_first_backward(solver_t *s)
{
    int k;
    for (k = 0; k < NS; k++) {
        memcpy(s->riccati.g[k], stage_g(s, k), sizeof s->riccati.g[k]);
        memcpy(s->riccati.b[k], stage_b(s, k), sizeof s->riccati.b[k]);
    }
    memcpy(s->riccati.g[k], stage_g(s, k), sizeof s->riccati.g[0][0] * NXS);
    ipm_add_forces(s, s->ipm.force, s->riccati.g);
    riccati_backward(s, NS);
}

/* (x, u) = minimiser with equations only. Returns 0 if it is not finite. From here on steps are computed: no gaps, no dx_0. */
static int ipm_first_point(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t probe = R(0);
    int k, i;
    memcpy(s->qp.x[0], s->step.dx[0], sizeof s->step.dx[0]);
    riccati_forward(s, s->qp.x, s->qp.z);
    memset(s->riccati.b, 0, sizeof s->riccati.b);
    memset(s->riccati.du, 0, sizeof s->riccati.du);
    for (k = 0; k <= NS; k++) {
        for (i = 0; i < NXS; i++) {
            probe += R(0) * s->qp.x[k][i];
        }
    }
    ipm_values(s, s->qp.x, s->qp.z, q->v);
    memcpy(q->origin, q->v, sizeof q->v);
    for (i = 0; i < NV + NG; i++) {
        probe += R(0) * q->v[i];
        q->y[i] = (q->kind[i] == 1) ? q->weight[i] * (q->v[i] - s->qp.lower[i]) : R(0);
    }
    return isfinite(probe) != 0;
}

/* How much row c, which has no multiplier yet, violates its bounds beyond rounding. */
static real_t ipm_violation(const solver_t *s, int c)
{
    const real_t v = s->ipm.v[c], over = v - s->qp.upper[c], under = s->qp.lower[c] - v;
    const real_t amount = (over > under) ? over : under;
    const real_t bound = FABS((over > under) ? s->qp.upper[c] : s->qp.lower[c]);
    return (amount > TOL_IPM_VIOLATION * (bound + FABS(v))) ? amount : R(0);
}

/* Cost of the violations, sum of (violation / reach)^2, and their number. */
static real_t ipm_violation_cost(const solver_t *s, int *count)
{
    real_t sum = R(0);
    int c;
    *count = 0;
    for (c = 0; c < NV + NG; c++) {
        if (s->ipm.kind[c] == 0 && s->ipm.reach[c] > R(0)) {
            const real_t d = ipm_violation(s, c) / s->ipm.reach[c];
            sum += d * d;
            *count += d > R(0);
        }
    }
    return sum;
}

/* 1 if an inequality is violated. */
static int ipm_any_violation(const solver_t *s)
{
    int count;
    (void)ipm_violation_cost(s, &count);
    return count > 0;
}

/* Slack and multiplier of a soft side. It starts where its violation costs no more than its penalty, unless it was violated in
 * the QP before. */
static void ipm_start_soft_side(solver_t *s, int i, real_t mu, real_t distance)
{
    ipm_t *q = &s->ipm;
    const int c = q->row[i], j = i - q->hard;
    const real_t l1 = s->qp.penalty[c - NV], l2 = s->qp.curvature[c - NV];
    const real_t least = SQRT(mu) * q->reach[c];
    if (!(l1 > R(0))) {
        q->kappa[j] = R(0);
        q->e[j] = q->lam[i] / l2;
    } else if (q->warm && s->qp.side[c] == ((q->sign[i] > R(0)) ? 2 : -2)) {
        q->e[j] = (-distance > least) ? -distance : least;
        q->lam[i] = l1 + l2 * q->e[j];
        q->kappa[j] = (mu / q->e[j] < R(0.5) * q->lam[i]) ? mu / q->e[j] : R(0.5) * q->lam[i];
        q->lam[i] -= q->kappa[j];
        q->t[i] = mu / q->lam[i];
    } else {
        q->lam[i] = (q->lam[i] < R(0.5) * l1) ? q->lam[i] : R(0.5) * l1;
        q->t[i] = mu / q->lam[i];
        q->kappa[j] = l1 - q->lam[i];
        q->e[j] = mu / q->kappa[j];
    }
}

/* t lam = mu on every side, t - reach^2 lam = distance - reach^2 |multiplier before| but for violated bounds, where the distance
 * counts as 0. Multipliers that the present cost of the violations cannot explain are cut. Without a multiplier t is at most the
 * middle between the bounds, unless the value is farther away. */
static void ipm_start_sides(solver_t *s, real_t mu, real_t cost)
{
    ipm_t *q = &s->ipm;
    const real_t root_mu = SQRT(mu), most = R(4) * SQRT(cost);
    int i;
    for (i = 0; i < q->sides; i++) {
        const int c = q->row[i];
        const real_t reach = q->reach[c], distance = q->sign[i] * (q->bound[i] - q->v[c]);
        const real_t half = R(0.5) * (s->qp.upper[c] - s->qp.lower[c]);
        real_t force = q->warm ? q->sign[i] * q->before[c] * reach : R(0), t = root_mu * reach;
        t = (half < t && half > R(0)) ? half : t;
        t = (distance > t) ? distance : t;
        if (force > R(0)) {
            force = (force < most) ? force : most;
            force -= (distance > R(0)) ? distance / reach : R(0);
            t = SQRT(force * force + R(4) * mu);
            t = (force > R(0)) ? R(2) * mu * reach / (t + force) : R(0.5) * (t - force) * reach;
        }
        q->t[i] = t;
        q->lam[i] = mu / t;
        if (i >= q->hard) {
            ipm_start_soft_side(s, i, mu, distance);
        }
    }
}
