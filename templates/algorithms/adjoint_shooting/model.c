/* This part is the quadratic model over steps d of the scaled controls, r' d + 1/2 d' H d, whose H is that of
 * Gauss-Newton: second derivatives of the cost and the terms of the rows along the linearised trajectory,
 *
 *     dx_{k+1} = A_k dx_k + B_k du_k,   w_k = B_k' lam_{k+1} + (H_k d_k)_u,   lam_k = A_k' lam_{k+1} + (H_k d_k)_x,
 *
 * and, for terminal rows with values c, slopes Xi = dc / du and weights Omega, mu' (c + Xi d) + 1/2 (c + Xi d)' Omega
 * (c + Xi d), where Omega is so large that c + Xi d = 0 holds to the precision at hand. */

/* y += factor x */
static void add_multiple(real_t *y, real_t factor, const real_t *x)
{
    for (int i = 0; i < N * NU; i++) {
        y[i] += factor * x[i];
    }
}

/* Loads (dx_k, du_k) of the direction p. */
static void load_direction(const solver_t *s, int k, real_t *d)
{
    const shooting_t *a = &s->shooting;
    for (int i = 0; i < NX; i++) {
        d[i] = (k > 0) ? a->dx[k - 1][i] : R(0);
    }
    for (int j = 0; j < NU; j++) {
        d[NX + j] = control_scale[j] * a->p[k][j];
    }
}

/* Returns what node k, with n variables, adds to the change of the lumped row along d, times its factor. */
static real_t lumped_change(const solver_t *s, int k, int n, const real_t *d)
{
    real_t g[NZ] = {R(0)}, sum = R(0);
    add_rows(s, k, HARD, d, g);
    for (int i = 0; i < n; i++) {
        sum += g[i] * d[i];
    }
    return sum;
}

/* w = H p without the terminal rows. */
static void multiply(solver_t *s)
{
    shooting_t *a = &s->shooting;
    real_t d[NZ], lam[NX] = {R(0)}, g[NZ];
    real_t change = R(0);
    for (int k = 0; k < N; k++) {
        load_direction(s, k, d);
        if (NG && LUMPED_ROWS) {
            change += lumped_change(s, k, NZ, d);
        }
        INTEGRATOR_FORWARD(s, k, d, d + NX, a->dx[k]);
    }
    if (NG && LUMPED_ROWS) {
        change += lumped_change(s, N, NX, a->dx[N - 1]);
        a->lump_change = penalty_of_rows(s) * change / (a->lump * a->lump);
    }
    TERMINAL_PRODUCT(s, a->dx[N - 1], lam);
    add_rows(s, N, PRODUCT, a->dx[N - 1], lam);
    for (int k = N - 1; k >= 0; k--) {
        real_t own[NZ];
        (void)memset(own, 0, sizeof own);
        load_direction(s, k, d);
        PATH_PRODUCT(s, k, d, own);
        add_rows(s, k, PRODUCT, d, own);
        INTEGRATOR_ADJOINT(s, k, lam, g);
        for (int i = 0; i < NX; i++) {
            lam[i] = g[i] + own[i];
        }
        for (int j = 0; j < NU; j++) {
            a->w[k][j] = control_scale[j] * (g[NX + j] + own[NX + j]);
        }
    }
}

/* Computes the gradient of terminal row t with respect to x_N; returns the value of the row. */
static real_t terminal_slope(const solver_t *s, int t, real_t *lam)
{
    const int m = terminal_row[t];
    real_t h[NH + NH_N + NE] = {R(0)}, J[(NH + NH_N + NE) * NZ] = {R(0)};
    evaluate_nodal_rows(s, N, h, J);
    for (int i = 0; i < NX; i++) {
        lam[i] = R(0);
    }
    if (row_is_state(m)) {
        lam[row_index(m)] = R(1);
        return s->x[N][row_index(m)];
    }
    const real_t *gradient = gradient_of_row(m, J);
    for (int i = 0; i < NX; i++) {
        lam[i] = gradient[i];
    }
    return h[place_of_row(m)];
}

/* c_t = distance of terminal row t from the bound at which it is held; 0, and weight 0, if no bound holds it. */
static int set_target(solver_t *s, int t, real_t v)
{
    const int m = terminal_row[t];
    const real_t lower = row_lower(s, m), upper = row_upper(s, m);
    const real_t moved = v + s->row[m] / (penalty_of_rows(s) * row_weight[m]);
    if (lower < upper && moved > lower && moved < upper) {
        s->shooting.gap[t] = R(0);
        s->row[m] = R(0);
        return 0;
    }
    s->shooting.gap[t] = v - clip(moved, lower, upper);
    return 1;
}

/* Computes the rows of Xi by one adjoint sweep each, and Omega = curvature / (compliance |Xi_t|^2), where the curvature
 * is that of H along the sum of the unit vectors Xi_t / |Xi_t|. */
static void impulse_rows(solver_t *s)
{
    shooting_t *a = &s->shooting;
    (void)memset(a->p, 0, sizeof a->p);
    for (int t = 0; t < NT; t++) {
        real_t lam[NX], g[NZ];
        const int held = set_target(s, t, terminal_slope(s, t, lam));
        for (int k = N - 1; k >= 0; k--) {
            INTEGRATOR_ADJOINT(s, k, lam, g);
            for (int j = 0; j < NU; j++) {
                a->Xi[t][k][j] = control_scale[j] * g[NX + j];
            }
            (void)memcpy(lam, g, sizeof lam);
        }
        const real_t size = inner(a->Xi[t][0], a->Xi[t][0]);
        a->omega[t] = (held && size > R(0)) ? R(1) / size : R(0);
        add_multiple(a->p[0], SQRT(a->omega[t]), a->Xi[t][0]);
    }
    multiply(s);
    const real_t size = inner(a->p[0], a->p[0]), bend = inner(a->p[0], a->w[0]);
    const real_t curvature = (size > R(0) && bend > R(0)) ? bend / size : R(1);
    for (int t = 0; t < NT; t++) {
        a->omega[t] *= curvature / TOL_TERMINAL_COMPLIANCE;
        add_multiple(a->r[0], a->omega[t] * a->gap[t], a->Xi[t][0]);
    }
}

/* w += Xi' Omega Xi p */
static void multiply_rows(shooting_t *a)
{
    for (int t = 0; t < NT; t++) {
        add_multiple(a->w[0], a->omega[t] * inner(a->Xi[t][0], a->p[0]), a->Xi[t][0]);
    }
}

/* sum over free controls of Xi_t Xi_q */
static real_t overlap(const shooting_t *a, int t, int q)
{
    real_t sum = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            sum += if_free(a, k, j) * a->Xi[t][k][j] * a->Xi[q][k][j];
        }
    }
    return sum;
}

/* S = L L' = curvature Omega^-1 + Xi Xi' over the free controls. The diagonal of L is stored as its inverse; rows
 * without weight are those of the identity. */
static void factorize_rows(shooting_t *a)
{
    for (int t = 0; t < NT; t++) {
        for (int q = 0; q <= t; q++) {
            real_t sum = (a->omega[t] > R(0) && a->omega[q] > R(0)) ? overlap(a, t, q) : R(0);
            if (q == t) {
                sum += (a->omega[t] > R(0)) ? TOL_TERMINAL_COMPLIANCE * inner(a->Xi[t][0], a->Xi[t][0]) : R(1);
            }
            for (int i = 0; i < q; i++) {
                sum -= a->S[t][i] * a->S[q][i];
            }
            a->S[t][q] = (q < t) ? sum * a->S[q][q] : (sum > R(0)) ? R(1) / SQRT(sum) : R(0);
        }
    }
}

/* y := S^-1 y */
static void substitute_rows(const shooting_t *a, real_t *y)
{
    for (int t = 0; t < NT; t++) {
        for (int q = 0; q < t; q++) {
            y[t] -= a->S[t][q] * y[q];
        }
        y[t] *= a->S[t][t];
    }
    for (int t = NT - 1; t >= 0; t--) {
        for (int q = t + 1; q < NT; q++) {
            y[t] -= a->S[q][t] * y[q];
        }
        y[t] *= a->S[t][t];
    }
}

/* w = (I + Xi' Omega Xi / curvature)^-1 r over the free controls, by Woodbury's formula with the Schur complement S; w
 * = 0 at the held controls. Returns r' w. */
static real_t precondition(shooting_t *a)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            a->w[k][j] = if_free(a, k, j) * a->r[k][j];
        }
    }
    real_t y[NT];
    for (int t = 0; t < NT; t++) {
        y[t] = (a->omega[t] > R(0)) ? inner(a->Xi[t][0], a->w[0]) : R(0);
    }
    substitute_rows(a, y);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            for (int t = 0; !a->held[k][j] && t < NT; t++) {
                a->w[k][j] -= a->Xi[t][k][j] * y[t];
            }
        }
    }
    return inner(a->r[0], a->w[0]);
}
