/* Contract of this part: rows of the QP (controls first, then general rows), their sides with finite bounds, directions. */

/* Value of every row at (x, u). */
static void ipm_values(solver_t *s, real_t (*x)[NXS], const real_t *u, real_t *v)
{
    memcpy(v, u, sizeof v[0] * NV);
#if !NG
    (void)s;
    (void)x;
#endif
#if NG
    for (int m = 0; m < NG; m++) {
        const int k = stage_of_row[m];
#if GENERAL_ROWS || NE || BLOCK_ROWS
        if (stage_state[m] < 0) {
            const real_t *a = stage_row(s, m);
            v[NV + m] = riccati_dot(a, x[k], NXS);
            if (k < NS) {
                v[NV + m] += riccati_dot(a + NXS, u + k * NUS, NUS);
            }
            continue;
        }
#else
        (void)s;
#endif
        v[NV + m] = x[k][stage_state[m]];
    }
#endif
}

/* g += sum_c force_c a_c, stage by stage. */
static void ipm_add_forces(solver_t *s, const real_t *force, real_t (*g)[NZS])
{
    int k, j;
#if !NG
    (void)s;
#endif
    for (k = 0; k < NS; k++) {
        for (j = 0; j < NUS; j++) {
            g[k][NXS + j] += force[k * NUS + j];
        }
    }
#if NG
    for (int m = 0; m < NG; m++) {
        const real_t f = force[NV + m];
        real_t *w = g[stage_of_row[m]];
#if GENERAL_ROWS || NE || BLOCK_ROWS
        if (stage_state[m] < 0) {
            const real_t *a = stage_row(s, m);
            const int width = (stage_of_row[m] < NS) ? NZS : NXS;
            for (int i = 0; f != R(0.0) && i < width; ++i) {
                w[i] += f * a[i];
            }
            continue;
        }
#else
        (void)s;
#endif
        w[stage_state[m]] += f;
    }
#endif
}

/* w += Q z, Q symmetric of n rows (lower triangle), in blocks of four rows. */
static void ipm_add_symmetric(const real_t *Q, int ld, const real_t *z, real_t *w, int n)
{
    int i, r, c;
    for (i = 0; i < n; i += 4) {
        const int rows = (n - i < 4) ? n - i : 4;
        riccati_combine(w, z + i, Q + i * ld, ld, rows, i);
        for (r = i; r < i + rows; r++) {
            const real_t *row = Q + r * ld;
            w[r] += riccati_dot(row, z, i) + row[r] * z[r];
            for (c = i; c < r; c++) {
                w[r] += row[c] * z[c];
                w[c] += row[c] * z[r];
            }
        }
    }
}

/* gradient_k = g_k + Q_k z_k at the iterate. */
static void ipm_cost_gradient(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t z[NZS];
    int k;
    for (k = 0; k < NS; k++) {
        memcpy(z, s->qp.x[k], sizeof s->qp.x[k]);
        memcpy(z + NXS, s->qp.z + k * NUS, sizeof z[0] * NUS);
        memcpy(q->gradient[k], stage_g(s, k), sizeof q->gradient[k]);
        ipm_add_symmetric(stage_Q(s, k)[0], NZS, z, q->gradient[k], NZS);
    }
    memcpy(q->gradient[k], stage_g(s, k), sizeof q->gradient[0][0] * NXS);
    ipm_add_symmetric(stage_Q_N(s)[0], NXS, s->qp.x[k], q->gradient[k], NXS);
}

/* What row c is: 0 inequality or free, 1 equation, 2 fixed control. Soft rows are never equations. */
static inline int ipm_row_kind(const solver_t *s, int c)
{
    if (c >= NV && s->qp.penalty[c - NV] < (real_t)INFINITY) {
        return 0;
    }
    return (s->qp.lower[c] >= s->qp.upper[c]) ? ((c < NV) ? 2 : 1) : 0;
}

/* Rows or controls of the given kind: 1 if there is one. */
static int ipm_any(const ipm_t *q, int kind)
{
    int c, any = 0;
    for (c = 0; c < NV + NG; c++) {
        any |= q->kind[c] == kind;
    }
    return any;
}

/* 1 if the kind of a row is not what the factorisation was made for; the kinds are taken. */
static int ipm_take_kinds(solver_t *s)
{
    int c, changed = 0;
    for (c = 0; c < NV + NG; c++) {
        const int kind = ipm_row_kind(s, c);
        changed |= kind != s->ipm.kind[c];
        s->ipm.kind[c] = kind;
        if (c < NV) {
            s->riccati.fixed[c] = kind == 2;
        }
    }
    return changed;
}

/* Bounds and penalties: NUMERICAL_FAILURE if one is invalid, INFEASIBLE if bounds cross, else OK. */
static status_t ipm_check_bounds(const solver_t *s)
{
    int valid = 1, ordered = 1, c;
    for (c = 0; c < NV + NG; c++) {
        valid &= s->qp.lower[c] < (real_t)INFINITY && s->qp.upper[c] > -(real_t)INFINITY;
        ordered &= s->qp.lower[c] <= s->qp.upper[c];
    }
#if NG
    for (int m = 0; m < NG; m++) {
        valid &= s->qp.penalty[m] >= R(0) && s->qp.curvature[m] >= R(0) && isfinite(s->qp.curvature[m]);
    }
#endif
    return !valid ? NUMERICAL_FAILURE : ordered ? OK : INFEASIBLE;
}

/* The side of row c enters the list if its bound is finite and its violation costs anything. */
static void ipm_add_side(solver_t *s, int c, int upper)
{
    ipm_t *q = &s->ipm;
    const real_t bound = upper ? s->qp.upper[c] : s->qp.lower[c];
    const int m = c - NV, soft = m >= 0 && s->qp.penalty[m] < (real_t)INFINITY;
    const int costless = soft && !(s->qp.penalty[m] + s->qp.curvature[m] > R(0));
    if (isfinite(bound) && !costless) {
        q->row[q->sides] = c;
        q->sign[q->sides] = upper ? R(1) : -R(1);
        q->bound[q->sides] = bound;
        q->sides++;
    }
}

/* Sides of all inequalities, hard ones first. A row that the controls do not move is left to ipm_constant_rows. */
static void ipm_list_sides(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int pass, c;
    q->sides = q->hard = 0;
    for (pass = 0; pass < 2; pass++) {
        for (c = 0; c < NV + NG; c++) {
            const int soft = c >= NV && s->qp.penalty[c - NV] < (real_t)INFINITY;
            if (soft == pass && q->kind[c] == 0 && s->units.reach[c] > R(0)) {
                ipm_add_side(s, c, 0);
                ipm_add_side(s, c, 1);
            }
        }
        q->hard = (pass == 0) ? q->sides : q->hard;
    }
}

/* Hands the weights of the rows to the recursion. */
static void ipm_set_weights(solver_t *s)
{
    int k, j;
    for (k = 0; k < NS; k++) {
        for (j = 0; j < NUS; j++) {
            s->riccati.diagonal[k][NXS + j] = s->ipm.weight[k * NUS + j] + s->ipm.proximal[NXS + j];
        }
    }
#if NF
    for (j = 0; j < NF; j++) {
        s->riccati.diagonal[0][free_state[j]] = s->ipm.proximal[free_state[j]];
    }
#endif
    memcpy(s->riccati.weight, s->ipm.weight + NV, sizeof s->ipm.weight[0] * NG);
}

/* Residuals of the sides, r = distance + e - t and r_e = l1 + l2 e - lam - kappa, and the mean of t lam and e kappa. */
static void ipm_side_residuals(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t sum = R(0);
    int i, pairs = q->sides;
    for (i = 0; i < q->sides; i++) {
        q->r[i] = q->sign[i] * (q->bound[i] - q->v[q->row[i]]) - q->t[i];
        sum += q->t[i] * q->lam[i];
    }
    for (i = q->hard; i < q->sides; i++) {
        const int j = i - q->hard, m = q->row[i] - NV;
        q->r[i] += q->e[j];
        q->r_e[j] = s->qp.penalty[m] + s->qp.curvature[m] * q->e[j] - q->lam[i] - q->kappa[j];
        sum += q->e[j] * q->kappa[j];
        pairs += q->kappa[j] > R(0);
    }
    q->mu = (pairs > 0) ? sum / (real_t)pairs : R(0);
}

/* omega = 1 / (t / lam + regularization + 1 / (l2 + kappa / e)); weights of the rows. */
static void ipm_weigh(solver_t *s)
{
    ipm_t *q = &s->ipm;
    const real_t share = TOL_IPM_DUAL_REGULARIZATION / q->stiffening;
    int i, c;
    for (c = 0; c < NV + NG; c++) {
        q->weight[c] = q->stiffness[c] * q->stiffening;
    }
    for (i = 0; i < q->sides; i++) {
        const real_t reach = s->units.reach[q->row[i]];
        q->ratio[i] = q->t[i] / q->lam[i];
        q->omega[i] = q->ratio[i] + share * reach * reach;
    }
    for (i = q->hard; i < q->sides; i++) {
        const int j = i - q->hard;
        q->compliance[j] = R(1) / (s->qp.curvature[q->row[i] - NV] + q->kappa[j] / q->e[j]);
        q->omega[i] += q->compliance[j];
    }
    for (i = 0; i < q->sides; i++) {
        q->omega[i] = R(1) / q->omega[i];
        q->weight[q->row[i]] += q->omega[i];
    }
    ipm_set_weights(s);
}

/* With c_1 = -t lam + lam extra_i, c_2 = -kappa e + e extra_e the linearised conditions of a side
 *     dt = r - sign dv + de + regularization dlam,   lam dt + t dlam = c_1,
 *     l2 de - dlam - dkappa = -r_e,   kappa de + e dkappa = c_2
 * give dlam = omega (sign dv + rho),  rho = extra_i - t - r - (extra_e - kappa - r_e) compliance.
 * force: what the multipliers become where dv = 0. */
static void ipm_forces(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int i, c;
    for (c = 0; c < NV + NG; c++) {
        q->force[c] = (q->kind[c] == 1) ? q->y[c] + q->weight[c] * (q->v[c] - s->qp.lower[c]) : R(0);
    }
    for (i = 0; i < q->sides; i++) {
        q->rho[i] = q->extra[i] - q->t[i] - q->r[i];
    }
    for (i = q->hard; i < q->sides; i++) {
        const int j = i - q->hard;
        q->rho[i] -= (q->extra_e[j] - q->kappa[j] - q->r_e[j]) * q->compliance[j];
    }
    for (i = 0; i < q->sides; i++) {
        q->force[q->row[i]] += q->sign[i] * (q->lam[i] + q->omega[i] * q->rho[i]);
    }
}

/* The direction of all unknowns for the present extra, extra_e: one substitution. */
static void ipm_direction(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int i;
    ipm_forces(s);
    memcpy(s->riccati.g, q->gradient, sizeof s->riccati.g);
    ipm_add_forces(s, q->force, s->riccati.g);
    riccati_backward(s, NS);
    memset(q->dx[0], 0, sizeof q->dx[0]);
    riccati_forward(s, q->dx, q->du);
    ipm_values(s, q->dx, q->du, q->dv);
    for (i = 0; i < q->sides; i++) {
        q->dlam[i] = q->omega[i] * (q->sign[i] * q->dv[q->row[i]] + q->rho[i]);
        q->dt[i] = q->extra[i] - q->t[i] - q->ratio[i] * q->dlam[i];
    }
    for (i = q->hard; i < q->sides; i++) {
        const int j = i - q->hard;
        q->de[j] = (q->dlam[i] + q->extra_e[j] - q->kappa[j] - q->r_e[j]) * q->compliance[j];
        q->dkappa[j] = q->extra_e[j] - q->kappa[j] - q->kappa[j] / q->e[j] * q->de[j];
    }
}
