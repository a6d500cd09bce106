/* This part tests the multipliers by the adjoint equation, for stationarity or as a proof of infeasibility. */

/* w = S_k'lam + g_k, where lam is the adjoint of x_{k+1}. */
static inline void ipm_adjoint_step(solver_t *s, int k, const real_t *lam, real_t *w)
{
    (void)memcpy(w, s->riccati.work.vectors.rhs.g[k], sizeof s->riccati.work.vectors.rhs.g[k]);
    riccati_combine(w, lam, stage_S(s, k)[0], NZ, NX, NZ);
}

/* Returns the sum of the absolute values of the terms of entry i of the gradient at stage k, from cost and rows but
 * without the dynamics. */
static inline real_t ipm_gradient_terms(solver_t *s, int k, int i)
{
    const real_t g = stage_g(s, k)[i], cost = s->ipm.gradient[k][i];
    return FABS(g) + FABS(cost - g) + FABS(s->riccati.work.vectors.rhs.g[k][i] - cost);
}

/* Computes size[j], the sum of the absolute values of the terms of the gradient of control j at stage k, and next[],
 * the same for the entries of lam. The terms of lam may cancel, for instance if a row holds a state, so that lam itself
 * does not show its rounding error. */
static void ipm_term_sizes(solver_t *s, int k, const real_t *next, real_t *size)
{
    for (int j = 0; j < NU; j++) {
        size[j] = ipm_gradient_terms(s, k, NX + j);
        for (int i = 0; i < NX; i++) {
            size[j] += FABS(stage_S(s, k)[i][NX + j]) * next[i];
        }
    }
}

/* Largest |gradient| and largest sum of its terms, both scaled by the reach. */
typedef struct {
    real_t rest;
    real_t terms;
} slope_t;

static inline void ipm_take_gradient(real_t rest, real_t terms, real_t unit, slope_t *largest)
{
    largest->rest = (FABS(rest) * unit > largest->rest) ? FABS(rest) * unit : largest->rest;
    largest->terms = (terms * unit > largest->terms) ? terms * unit : largest->terms;
}

/* Records the gradient w of the controls of stage k and the sums of its terms in `size`; fixed controls get their
 * multipliers. */
static void ipm_take_controls(solver_t *s, int k, const real_t *w, const real_t *size, slope_t *largest)
{
    for (int j = 0; j < NU; j++) {
        const int c = k * NU + j;
        if (s->ipm.kind[c] == GIVEN_CONTROL) {
            s->qp.mult[c] -= w[j];
        } else {
            ipm_take_gradient(w[j], size[j], s->units.reach[c], largest);
        }
    }
}

/* Returns the gradient of the Lagrangian with respect to the free controls and components of x_0, relative to the
 * largest sum of its terms, both scaled by the reach. It is evaluated under the feedback u = K x + v, so that rounding
 * errors do not grow along an unstable horizon. Fixed controls get their multipliers. */
static real_t ipm_stationarity(solver_t *s)
{
    real_t(*g)[NZ] = s->riccati.work.vectors.rhs.g;
    slope_t largest = {R(0), R(0)};
    real_t lam[NX], w[NZ], size[NU], next[NX];
    ipm_load_gradient(s);
    ipm_add_forces(s, s->qp.mult);
    (void)memcpy(lam, g[N], sizeof lam);
    for (int j = 0; j < NX; j++) {
        next[j] = ipm_gradient_terms(s, N, j);
    }
    for (int k = N - 1; k >= 0; k--) {
        ipm_adjoint_step(s, k, lam, w);
        ipm_term_sizes(s, k, next, size);
        ipm_take_controls(s, k, w + NX, size, &largest);
        for (int j = 0; j < NX; j++) {
            next[j] = ipm_gradient_terms(s, k, j) + FABS(w[j] - g[k][j]);
        }
        riccati_combine(w, w + NX, s->riccati.K[k][0], LDX, NU, NX);
        (void)memcpy(lam, w, sizeof lam);
    }
    for (int f = 0; f < NF; f++) {
        const real_t unit = R(1) / SQRT(s->riccati.F[f][f]);
        ipm_take_gradient(lam[free_state[f]], next[free_state[f]], unit, &largest);
    }
    return (largest.rest > R(0)) ? largest.rest / largest.terms : R(0);
}

/* Returns f B for a row with weight f, where B is its upper bound for f > 0 and its lower bound for f < 0. */
static inline real_t ipm_support(const qp_t *q, int c, real_t f)
{
    if (f > R(0)) {
        return f * q->upper[c];
    }
    return (f < R(0)) ? f * q->lower[c] : R(0);
}

/* Returns the largest |weight| of the certificate. */
static real_t ipm_largest_weight(const qp_t *q)
{
    real_t most = R(0);
    for (int c = 0; c < NV + NG; c++) {
        most = (FABS(q->certificate[c]) > most) ? FABS(q->certificate[c]) : most;
    }
    return most;
}

/* Returns the sum of the absolute values of the terms of component j of w = S_k'nu + g_k at stage k. */
static real_t ipm_ray_terms(solver_t *s, int k, int j, const real_t *nu)
{
    real_t size = FABS(s->riccati.work.vectors.rhs.g[k][j]);
    for (int i = 0; i < NX; i++) {
        size += FABS(stage_S(s, k)[i][j] * nu[i]);
    }
    return size;
}

/* Returns 1 if component j of w is zero up to the rounding of its terms. */
static inline int ipm_vanishes(solver_t *s, int k, int j, const real_t *nu, real_t w)
{
    return FABS(w) <= TOL_IPM_RAY * ipm_ray_terms(s, k, j, nu);
}

/* Balances the weights f of the rows, which leave sum_c f_c a_c = w for the controls and free states of stage k. The
 * bound of control j takes the weight -w_j if it is finite on that side; otherwise w_j must be zero up to rounding, and
 * |w_j u_j| at the iterate is added to `rest`. Returns 0 if it is not. */
static int ipm_balance(solver_t *s, int k, const real_t *nu, const real_t *w, real_t *rest)
{
    for (int j = 0; j < NU; j++) {
        const real_t f = -w[NX + j];
        const int finite = isfinite(ipm_support(&s->qp, k * NU + j, f)) != 0;
        s->qp.certificate[k * NU + j] = finite ? f : R(0);
        if (!finite && !ipm_vanishes(s, k, NX + j, nu, -f)) {
            return 0;
        }
        *rest += finite ? R(0) : FABS(f * s->qp.z[k * NU + j]);
    }
    for (int f = 0; k == 0 && f < NF; f++) {
        if (!ipm_vanishes(s, 0, free_state[f], nu, w[free_state[f]])) {
            return 0;
        }
    }
    return 1;
}

/* Returns 1 if the rows contradict one another: with the adjoint nu of the weights f,
 *     sum_c f_c v_c = nu_0'dx_0 + sum_k nu_{k+1}'b_k
 * at all points that satisfy the dynamics, while f_c v_c <= f_c B_c implies a smaller sum. */
static int ipm_contradiction(solver_t *s)
{
    real_t nu[NX], w[NZ], gap = R(0), size = R(0), rest = R(0);
    (void)memset(s->riccati.work.vectors.rhs.g, 0, sizeof s->riccati.work.vectors.rhs.g);
    ipm_add_forces(s, s->qp.certificate);
    (void)memcpy(nu, s->riccati.work.vectors.rhs.g[N], sizeof nu);
    for (int k = N - 1; k >= 0; k--) {
        ipm_adjoint_step(s, k, nu, w);
        if (!ipm_balance(s, k, nu, w, &rest)) {
            return 0;
        }
        for (int i = 0; i < NX; i++) {
            gap -= nu[i] * stage_b(s, k)[i];
            size += FABS(nu[i] * stage_b(s, k)[i]);
        }
        (void)memcpy(nu, w, sizeof nu);
    }
    for (int i = 0; i < NX; i++) {
        const real_t term = (is_measured[i] || is_accumulator[i]) ? nu[i] * s->step.dx[0][i] : R(0);
        gap -= term;
        size += FABS(term);
    }
    for (int c = 0; c < NV + NG; c++) {
        const real_t term = ipm_support(&s->qp, c, s->qp.certificate[c]);
        gap += term;
        size += FABS(term);
    }
    return gap < -TOL_IPM_CONTRADICTION * size - FACTOR_IPM_CERTIFIED * rest;
}

/* Returns 1 if the weights prove infeasibility, and scales the largest to 1. Otherwise clears the certificate. */
static int ipm_certify(solver_t *s)
{
    qp_t *q = &s->qp;
    if (ipm_contradiction(s)) {
        const real_t most = ipm_largest_weight(q);
        for (int c = 0; c < NV + NG; c++) {
            q->certificate[c] /= most;
        }
        return 1;
    }
    (void)memset(q->certificate, 0, sizeof q->certificate);
    return 0;
}

/* Returns 1, with the certificate, if the present multipliers of the hard rows prove infeasibility. Only multipliers
 * with the sign of a finite bound are used. */
static int ipm_infeasible(solver_t *s)
{
    qp_t *q = &s->qp;
    real_t most;
    (void)memset(q->certificate, 0, sizeof q->certificate);
    for (int m = 0; m < NG; m++) {
        const real_t f = qp_is_soft(q, m) ? R(0) : q->mult[NV + m];
        q->certificate[NV + m] = isfinite(ipm_support(q, NV + m, f)) ? f : R(0);
    }
    most = ipm_largest_weight(q);
    if (most > R(0) && isfinite(most)) {
        return ipm_certify(s);
    }
    (void)memset(q->certificate, 0, sizeof q->certificate);
    return 0;
}

/* Checks the hard rows that depend on no control. Returns 1, with the certificate, if one is violated. */
static int ipm_constant_rows(solver_t *s)
{
    qp_t *q = &s->qp;
    for (int m = 0; m < NG; m++) {
        const int c = NV + m;
        if (!(s->units.reach[c] > R(0)) && !qp_is_soft(q, m) && ipm_violation(s, c) > R(0)) {
            (void)memset(q->certificate, 0, sizeof q->certificate);
            q->certificate[c] = (s->ipm.v[c] > q->upper[c]) ? R(1) : -R(1);
            if (ipm_certify(s)) {
                return 1;
            }
        }
    }
    return 0;
}
