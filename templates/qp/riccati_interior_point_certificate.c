/* Contract of this part: the multipliers against the dynamics, as stationarity or as a proof that there is no feasible point. */

#if NXS > NX
/* Entries of vectors of the states that belong to copies of components of x_0 join those of the originals. */
static inline void ipm_fold(real_t *w)
{
    int c;
    for (c = 0; c < NXS - NX; c++) {
        w[copied_state[c]] += w[NX + c];
        w[NX + c] = R(0);
    }
}

#endif
/* w = S_k'lam + g_k, lam the adjoint of x_{k+1}. */
static inline void ipm_adjoint_step(solver_t *s, int k, const real_t *lam, real_t *w)
{
    memcpy(w, s->riccati.g[k], sizeof s->riccati.g[k]);
    riccati_combine(w, lam, stage_S(s, k)[0], NZS, NXS, NZS);
}

/* The sum of the absolute terms of entry i of the gradient at stage k without the dynamics: cost and rows. */
static inline real_t ipm_gradient_terms(solver_t *s, int k, int i)
{
    const real_t g = stage_g(s, k)[i], cost = s->ipm.gradient[k][i];
    return FABS(g) + FABS(cost - g) + FABS(s->riccati.g[k][i] - cost);
}

/* size[j]: the sum of the absolute terms of the gradient of control j at stage k, next[] those of the entries of lam. What lam is
 * a sum of may cancel in it, as where a row holds a state, so its rounding is not seen from lam. */
static void ipm_term_sizes(solver_t *s, int k, const real_t *next, real_t *size)
{
    int i, j;
    for (j = 0; j < NUS; j++) {
        size[j] = ipm_gradient_terms(s, k, NXS + j);
        for (i = 0; i < NXS; i++) {
            size[j] += FABS(stage_S(s, k)[i][NXS + j]) * next[i];
        }
    }
}

/* The largest |gradient| and the largest sum of its terms, both times the way that one unit of cost allows. */
static inline void ipm_take_gradient(real_t rest, real_t terms, real_t unit, real_t *worst, real_t *most)
{
    *worst = (FABS(rest) * unit > *worst) ? FABS(rest) * unit : *worst;
    *most = (terms * unit > *most) ? terms * unit : *most;
}

/* Gradient of the Lagrangian with respect to the free controls and components of x_0 relative to the largest of the terms it is
 * a sum of, each times the way that one unit of cost allows, under the feedback u = K x + v: so rounding does not grow along an
 * unstable horizon. Fixed controls get their multipliers. */
static real_t ipm_stationarity(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t lam[NXS], w[NZS], size[NUS], next[NXS], worst = R(0), most = R(0);
    int k, j;
    memcpy(s->riccati.g, q->gradient, sizeof s->riccati.g);
    ipm_add_forces(s, s->qp.mult, s->riccati.g);
    memcpy(lam, s->riccati.g[NS], sizeof lam);
    for (j = 0; j < NXS; j++) {
        next[j] = ipm_gradient_terms(s, NS, j);
    }
    for (k = NS - 1; k >= 0; k--) {
        ipm_adjoint_step(s, k, lam, w);
        ipm_term_sizes(s, k, next, size);
        for (j = 0; j < NUS; j++) {
            const int c = k * NUS + j;
            if (q->kind[c] == 2) {
                s->qp.mult[c] -= w[NXS + j];
            } else {
                ipm_take_gradient(w[NXS + j], size[j], s->units.reach[c], &worst, &most);
            }
        }
        for (j = 0; j < NXS; j++) {
            next[j] = ipm_gradient_terms(s, k, j) + FABS(w[j] - s->riccati.g[k][j]);
        }
        riccati_combine(w, w + NXS, s->riccati.K[k][0], LDX, NUS, NXS);
        memcpy(lam, w, sizeof lam);
    }
#if NXS > NX
    ipm_fold(lam);
    ipm_fold(next);
#endif
#if NF
    for (j = 0; j < NF; j++) {
        const real_t unit = R(1) / SQRT(s->riccati.F[j][j]);
        ipm_take_gradient(lam[free_state[j]], next[free_state[j]], unit, &worst, &most);
    }
#endif
    return (worst > R(0)) ? worst / most : R(0);
}

/* f B of a row with weight f: B its upper bound for f > 0, its lower one for f < 0. */
static inline real_t ipm_support(const solver_t *s, int c, real_t f)
{
    return (f > R(0)) ? f * s->qp.upper[c] : (f < R(0)) ? f * s->qp.lower[c] : R(0);
}

/* certificate = f: multipliers of the hard rows, each with the sign of a finite bound. Returns the largest. */
static real_t ipm_ray(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t most = R(0);
    int c;
    for (c = 0; c < NV + NG; c++) {
        const int soft = c >= NV && s->qp.penalty[c - NV] < (real_t)INFINITY;
        const real_t f = (soft || c < NV) ? R(0) : s->qp.mult[c];
        q->ray[c] = isfinite(ipm_support(s, c, f)) ? f : R(0);
        most = (FABS(q->ray[c]) > most) ? FABS(q->ray[c]) : most;
    }
    return most;
}

/* The absolute terms of component j of w = S_k'nu + g_k, at stage k. */
static real_t ipm_ray_terms(solver_t *s, int k, int j, const real_t *nu)
{
    real_t size = FABS(s->riccati.g[k][j]);
    int i;
    for (i = 0; i < NXS; i++) {
        size += FABS(stage_S(s, k)[i][j] * nu[i]);
    }
    return size;
}

/* 1 if component j of w is the rounding of the terms it is a sum of. */
static inline int ipm_vanishes(solver_t *s, int k, int j, const real_t *nu, real_t w)
{
    return FABS(w) <= TOL_IPM_RAY * ipm_ray_terms(s, k, j, nu);
}

#if NF
/* The same for component j of x_0 with its copies. */
static int ipm_free_vanishes(solver_t *s, int j, const real_t *nu, const real_t *w)
{
    real_t sum = w[j], size = ipm_ray_terms(s, 0, j, nu);
#if NXS > NX
    for (int c = 0; c < NXS - NX; c++) {
        if (copied_state[c] == j) {
            sum += w[NX + c];
            size += ipm_ray_terms(s, 0, NX + c, nu);
        }
    }
#endif
    return FABS(sum) <= TOL_IPM_RAY * size;
}

#endif
/* The weights f of the rows leave sum_c f_c a_c = w for the controls and free states of stage k. The bound of a control takes
 * -w_j if there is one on that side; else w_j must be rounding. Returns 0 if it is not. */
static int ipm_balance(solver_t *s, int k, const real_t *nu, const real_t *w)
{
    int j;
    for (j = 0; j < NUS; j++) {
        const real_t f = -w[NXS + j];
        const int finite = isfinite(ipm_support(s, k * NUS + j, f)) != 0;
        s->ipm.ray[k * NUS + j] = finite ? f : R(0);
        if (!finite && !ipm_vanishes(s, k, NXS + j, nu, -f)) {
            return 0;
        }
    }
#if NF
    for (j = 0; k == 0 && j < NF; j++) {
        if (!ipm_free_vanishes(s, free_state[j], nu, w)) {
            return 0;
        }
    }
#endif
    return 1;
}

/* 1 if the rows contradict each other: with the adjoint nu of the weights f, sum_c f_c v_c = nu_0'dx_0 + sum_k nu_{k+1}'b_k for
 * all points of the dynamics, and f_c v_c <= f_c B_c. */
static int ipm_contradiction(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t nu[NXS], w[NZS], gap = R(0), size = R(0);
    int k, i, c;
    memset(s->riccati.g, 0, sizeof s->riccati.g);
    ipm_add_forces(s, q->ray, s->riccati.g);
    memcpy(nu, s->riccati.g[NS], sizeof nu);
    for (k = NS - 1; k >= 0; k--) {
        ipm_adjoint_step(s, k, nu, w);
        if (!ipm_balance(s, k, nu, w)) {
            return 0;
        }
        for (i = 0; i < NXS; i++) {
            gap -= nu[i] * stage_b(s, k)[i];
            size += FABS(nu[i] * stage_b(s, k)[i]);
        }
        memcpy(nu, w, sizeof nu);
    }
    for (i = 0; i < NX; i++) {
        const real_t term = (is_measured[i] || is_accumulator[i]) ? nu[i] * s->step.dx[0][i] : R(0);
        gap -= term;
        size += FABS(term);
    }
    for (c = 0; c < NV + NG; c++) {
        const real_t term = ipm_support(s, c, q->ray[c]);
        gap += term;
        size += FABS(term);
    }
    return gap < -TOL_IPM_CONTRADICTION * size;
}

/* Writes the certificate, its largest entry 1. */
static void ipm_write_certificate(solver_t *s)
{
    ipm_t *q = &s->ipm;
    real_t most = R(0);
    int c;
    for (c = 0; c < NV + NG; c++) {
        most = (FABS(q->ray[c]) > most) ? FABS(q->ray[c]) : most;
    }
    for (c = 0; c < NV + NG; c++) {
        s->qp.certificate[c] = q->ray[c] / most;
    }
}

/* 1, with the certificate, if the present multipliers prove that there is no feasible point. */
static int ipm_infeasible(solver_t *s)
{
    const real_t most = ipm_ray(s);
    if (most > R(0) && isfinite(most) && ipm_contradiction(s)) {
        ipm_write_certificate(s);
        return 1;
    }
    return 0;
}

#if NG
/* Rows that no control moves are met or not, whatever is done. 1, with the certificate, if one is not. */
static int ipm_constant_rows(solver_t *s)
{
    ipm_t *q = &s->ipm;
    int c;
    for (c = NV; c < NV + NG; c++) {
        const int constant = !(s->units.reach[c] > R(0));
        const int hard = !(s->qp.penalty[c - NV] < (real_t)INFINITY);
        if (constant && hard && ipm_violation(s, c) > R(0)) {
            memset(q->ray, 0, sizeof q->ray);
            q->ray[c] = (q->v[c] > s->qp.upper[c]) ? R(1) : -R(1);
            if (ipm_contradiction(s)) {
                ipm_write_certificate(s);
                return 1;
            }
        }
    }
    return 0;
}

#endif