/* This part evaluates the rows of the QP (controls first, then general rows), their sides with finite bounds, and
 * directions. */

/* Kind of a row: an inequality or an unbounded row; an equation; a control that is fixed by equal bounds. */
enum { INEQUALITY = 0, EQUATION = 1, GIVEN_CONTROL = 2 };

/* Computes the values of all rows at the iterate. */
static void ipm_values(solver_t *s)
{
    (void)memcpy(s->ipm.v, s->qp.z, sizeof s->qp.z);
    for (int m = 0; m < NG; m++) {
        s->ipm.v[NV + m] = qp_row_value(s, m);
    }
}

/* Computes the changes of all rows along the direction. */
static void ipm_changes(solver_t *s)
{
    (void)memcpy(s->ipm.dv, s->riccati.work.vectors.rhs.direction.du, sizeof s->qp.z);
    for (int m = 0; m < NG; m++) {
        s->ipm.dv[NV + m] = qp_row_change(s, m);
    }
}

/* g += sum_c force_c a_c, where g is the right-hand side. */
static void ipm_add_forces(solver_t *s, const real_t *force)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->riccati.work.vectors.rhs.g[k][NX + j] += force[k * NU + j];
        }
    }
    for (int m = 0; m < NG; m++) {
        qp_add_row(s, m, force[NV + m]);
    }
}

/* gradient_k = g_k + Q_k z_k at the iterate. */
static void ipm_cost_gradient(solver_t *s)
{
    for (int k = 0; k <= N; k++) {
        qp_cost_gradient(s, k, s->ipm.gradient[k]);
    }
}

/* Copies the gradient of the cost at the iterate to the right-hand side. */
static void ipm_load_gradient(solver_t *s)
{
    (void)memcpy(s->riccati.work.vectors.rhs.g, s->ipm.gradient, sizeof s->ipm.gradient);
}

/* Returns the kind of row c. */
static inline int ipm_row_kind(const qp_t *q, int c)
{
    if (!(q->lower[c] >= q->upper[c])) {
        return INEQUALITY;
    }
    if (c < NV) {
        return GIVEN_CONTROL;
    }
    if (NG) {
        if (!qp_is_soft(q, c - NV)) {
            return EQUATION;
        }
    }
    return INEQUALITY;
}

/* Returns 1 if there is a row or control of the given kind. */
static int ipm_any(const ipm_t *q, int kind)
{
    int any = 0;
    for (int c = 0; c < NV + NG; c++) {
        any |= q->kind[c] == kind;
    }
    return any;
}

/* Stores the kinds of all rows. Returns 1 if one differs from the kind for which the factorisation was computed. */
static int ipm_take_kinds(solver_t *s)
{
    int changed = 0;
    for (int c = 0; c < NV + NG; c++) {
        const int kind = ipm_row_kind(&s->qp, c);
        changed |= kind != s->ipm.kind[c];
        s->ipm.kind[c] = kind;
    }
    for (int c = 0; c < NV; c++) {
        s->riccati.fixed[c] = s->ipm.kind[c] == GIVEN_CONTROL;
    }
    return changed;
}

/* Returns the row of side i; upper: 1 for its upper side; sign: 1 for the upper and -1 for the lower side. */
static inline int ipm_row(const ipm_t *q, int i)
{
    return q->place[i] / 2;
}

static inline int ipm_is_upper(const ipm_t *q, int i)
{
    return q->place[i] % 2;
}

static inline real_t ipm_sign(const ipm_t *q, int i)
{
    return ipm_is_upper(q, i) ? R(1) : -R(1);
}

static inline real_t ipm_bound(const solver_t *s, int i)
{
    const int c = ipm_row(&s->ipm, i);
    return ipm_is_upper(&s->ipm, i) ? s->qp.upper[c] : s->qp.lower[c];
}

/* Returns the distance of the value of the row from the bound of side i; negative if the bound is violated. */
static inline real_t ipm_distance(const solver_t *s, int i)
{
    return ipm_sign(&s->ipm, i) * (ipm_bound(s, i) - s->ipm.v[ipm_row(&s->ipm, i)]);
}

/* Appends the sides of row c with finite bounds to the list. A row that the controls do not move is skipped. */
static void ipm_add_sides(solver_t *s, int c)
{
    ipm_t *q = &s->ipm;
    if (q->kind[c] != INEQUALITY || !(s->units.reach[c] > R(0))) {
        return;
    }
    if (isfinite(s->qp.lower[c])) {
        q->place[q->sides] = 2 * c;
        q->sides++;
    }
    if (isfinite(s->qp.upper[c])) {
        q->place[q->sides] = 2 * c + 1;
        q->sides++;
    }
}

/* Lists the sides of all inequalities, hard ones first. Rows that the controls do not move are left out. */
static void ipm_list_sides(solver_t *s)
{
    ipm_t *q = &s->ipm;
    q->sides = 0;
    for (int c = 0; c < NV; c++) {
        ipm_add_sides(s, c);
    }
    for (int m = 0; m < NG; m++) {
        if (!qp_is_soft(&s->qp, m)) {
            ipm_add_sides(s, NV + m);
        }
    }
    q->hard = q->sides;
    for (int m = 0; m < NG; m++) { /* rows whose violation has a cost */
        if (qp_is_soft(&s->qp, m) && s->qp.penalty[m] + s->qp.curvature[m] > R(0)) {
            ipm_add_sides(s, NV + m);
        }
    }
}

/* Passes the weights of the rows to the recursion. */
static void ipm_set_weights(solver_t *s)
{
    const ipm_t *q = &s->ipm;
    riccati_t *r = &s->riccati;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            r->diagonal[k][j] = q->weight[k * NU + j] + q->proximal[NX + j];
        }
    }
    for (int f = 0; f < NF; f++) {
        r->diagonal_free[f] = q->proximal[free_state[f]];
    }
    (void)memcpy(r->weight, q->weight + NV, sizeof r->weight);
}

/* Computes the residuals of the sides, r = distance + e - t and r_e = l1 + l2 e - lam - kappa, and the mean of t lam
 * and e kappa. */
static void ipm_side_residuals(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t sum = R(0);
    int pairs = q->sides;
    for (int i = 0; i < q->sides; i++) {
        q->r[i] = ipm_distance(s, i) - q->t[i];
        sum += q->t[i] * q->lam[i];
    }
    if (NG) {
        for (int i = q->hard; i < q->sides; i++) { /* at most 2 * NG passes */
            const int j = i - q->hard, m = ipm_row(q, i) - NV;
            q->r[i] += q->e[j];
            q->r_e[j] = s->qp.penalty[m] + s->qp.curvature[m] * q->e[j] - q->lam[i] - q->kappa[j];
            sum += q->e[j] * q->kappa[j];
            pairs += q->kappa[j] > R(0);
        }
    }
    q->mu = (pairs > 0) ? sum / (real_t)pairs : R(0);
}

/* Returns the regularisation of row c: its compliance in addition to that of its sides. */
static inline real_t ipm_regularization(const solver_t *s, int c)
{
    const real_t reach = s->units.reach[c];
    return TOL_IPM_DUAL_REGULARIZATION / s->ipm.stiffening * reach * reach;
}

/* Returns the number of sides, 1 or 2, of the row to which side i belongs. Side i is the first of them; sides of one
 * row are adjacent. */
static inline int ipm_sides_of_row(const ipm_t *q, int i)
{
    return (i + 1 < q->sides && ipm_row(q, i) == ipm_row(q, i + 1)) ? 2 : 1;
}

/* Computes omega = 1 / (t / lam + 1 / (l2 + kappa / e)) of every side, and the weights of the rows, 1 / (regularization
 * + 1 / sum omega). */
static void ipm_weigh(solver_t *s)
{
    ipm_t *q = &s->ipm;
    (void)memset(q->weight, 0, sizeof q->weight);
    for (int m = 0; m < NG; m++) {
        q->weight[NV + m] = q->stiffness[m] * q->stiffening;
    }
    for (int i = 0; i < q->sides; i++) {
        q->omega[i] = q->t[i] / q->lam[i];
    }
    if (NG) {
        for (int i = q->hard; i < q->sides; i++) { /* at most 2 * NG passes */
            const int j = i - q->hard;
            q->compliance[j] = R(1) / (s->qp.curvature[ipm_row(q, i) - NV] + q->kappa[j] / q->e[j]);
            q->omega[i] += q->compliance[j];
        }
    }
    for (int i = 0; i < q->sides; i++) {
        q->omega[i] = R(1) / q->omega[i];
        q->weight[ipm_row(q, i)] += q->omega[i];
    }
    for (int i = 0; i < q->sides; i += ipm_sides_of_row(q, i)) { /* at most NV + NG passes */
        const int c = ipm_row(q, i);
        q->weight[c] = R(1) / (ipm_regularization(s, c) + R(1) / q->weight[c]);
    }
    ipm_set_weights(s);
}

/* Returns the mean of sign rho over the n sides of a row from side i on, with the weights omega. */
static inline real_t ipm_mean(const ipm_t *q, int i, int n)
{
    real_t sum = R(0), total = R(0);
    for (int j = i; j < i + n; j++) { /* at most 2 passes */
        sum += ipm_sign(q, j) * q->omega[j] * q->dlam[j];
        total += q->omega[j];
    }
    return sum / total;
}

/* Computes the forces of the sides. With c_1 = -t lam + lam extra, c_2 = -kappa e + e extra_e the linearised conditions
 * of a side
 *     dt = r - sign dw + de,   dw = dv - regularization sum_sides sign dlam,   lam dt + t dlam = c_1,
 *     l2 de - dlam - dkappa = -r_e,   kappa de + e dkappa = c_2
 * give dlam = omega (sign dw + rho),  rho = extra - t - r - (extra_e - kappa - r_e) compliance. The sides of a row
 * share its regularisation, so that it delays their difference, not their sum. On entry dt holds extra and dkappa holds
 * extra_e; on return dlam holds rho, and force the multipliers for dv = 0. */
static void ipm_forces(solver_t *s)
{
    ipm_t *q = &s->ipm;
    (void)memset(q->force, 0, sizeof q->force);
    for (int m = 0; m < NG; m++) {
        const int c = NV + m;
        q->force[c] = (q->kind[c] == EQUATION) ? q->y[m] + q->weight[c] * (q->v[c] - s->qp.lower[c]) : R(0);
    }
    for (int i = 0; i < q->sides; i++) {
        q->dlam[i] = q->dt[i] - q->t[i] - q->r[i];
    }
    if (NG) {
        for (int i = q->hard; i < q->sides; i++) { /* at most 2 * NG passes */
            const int j = i - q->hard;
            q->dlam[i] -= (q->dkappa[j] - q->kappa[j] - q->r_e[j]) * q->compliance[j];
        }
    }
    for (int i = 0; i < q->sides; i++) {
        q->force[ipm_row(q, i)] += ipm_sign(q, i) * q->lam[i];
    }
    for (int i = 0; i < q->sides; i += ipm_sides_of_row(q, i)) { /* at most NV + NG passes */
        const int c = ipm_row(q, i);
        q->force[c] += q->weight[c] * ipm_mean(q, i, ipm_sides_of_row(q, i));
    }
}

/* Computes the directions of lam and t from those of the rows. The sum of sign dlam over the sides of a row is dy =
 * weight (dv + mean of sign rho), hence dlam = sign omega / (sum omega) dy + (rho_1 + rho_2) / (sum 1 / omega). */
static void ipm_recover_sides(solver_t *s)
{
    ipm_t *q = &s->ipm;
    for (int i = 0, n; i < q->sides; i += n) { /* at most NV + NG passes */
        const int c = ipm_row(q, i);
        real_t total = q->omega[i], both = R(0), dy;
        n = ipm_sides_of_row(q, i);
        if (n == 2) {
            total += q->omega[i + 1];
            both = (q->dlam[i] + q->dlam[i + 1]) * q->omega[i] * (q->omega[i + 1] / total);
        }
        dy = q->weight[c] * (q->dv[c] + ipm_mean(q, i, n));
        for (int j = i; j < i + n; j++) { /* at most 2 passes */
            q->dlam[j] = ipm_sign(q, j) * dy * (q->omega[j] / total) + both;
            q->dt[j] = q->dt[j] - q->t[j] - q->t[j] / q->lam[j] * q->dlam[j];
        }
    }
}

/* Computes the direction of all unknowns for the present extra and extra_e, by one substitution. */
static void ipm_direction(solver_t *s)
{
    ipm_t *q = &s->ipm;
    direction_t *d = &s->riccati.work.vectors.rhs.direction;
    ipm_forces(s);
    ipm_load_gradient(s);
    ipm_add_forces(s, q->force);
    riccati_backward(s, N);
    (void)memset(d->dx[0], 0, sizeof d->dx[0]);
    riccati_forward(s, d->dx, d->du);
    ipm_changes(s);
    ipm_recover_sides(s);
    for (int i = q->hard; i < q->sides; i++) { /* at most 2 * NG passes */
        const int j = i - q->hard;
        q->de[j] = (q->dlam[i] + q->dkappa[j] - q->kappa[j] - q->r_e[j]) * q->compliance[j];
        q->dkappa[j] = q->dkappa[j] - q->kappa[j] - q->kappa[j] / q->e[j] * q->de[j];
    }
}
