/* Contract of this part: the minimiser on the working set to rounding. Corrections solve for the residuals of the original
 * optimality conditions with the factors at hand, so what these hold beyond the original data (weights of members, shares on
 * pivots) costs steps, not accuracy. Members: the method of multipliers; pivots: the proximal point method. */

/* y += H z,  H symmetric, its lower triangle in rows of length ld. */
static inline void qp_add_symmetric(real_t *y, const real_t *H, int ld, const real_t *z, int n)
{
    int i, j;
    for (i = 0; i < n; i++) {
        const real_t *row = H + i * ld;
        real_t sum = row[i] * z[i];
        for (j = 0; j < i; j++) {
            sum += row[j] * z[j];
            y[j] += row[j] * z[i];
        }
        y[i] += sum;
    }
}

/* 1 if the factors are not those of the original problem on the working set. */
static int qp_is_approximate(const solver_t *s)
{
    int k, c;
#if NG
    for (c = 0; c < NG; c++) {
        if (s->qp.side[NV + c] == 1 || s->qp.side[NV + c] == -1) {
            return 1;
        }
    }
#endif
    for (k = 0; k < NS; k++) {
        for (c = 0; c < NUS; c++) {
            if (s->riccati.proximal[k][c] > R(0)) {
                return 1;
            }
        }
    }
#if NF
    for (c = 0; c < NF; c++) {
        if (s->riccati.proximal_free[c] > R(0)) {
            return 1;
        }
    }
#endif
    return 0;
}

/* Gradient of the Lagrangian at stage k and gap of the dynamics into the right-hand sides. */
static void qp_residual(solver_t *s, int k)
{
    qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    real_t z[NZS], *y = r->g[k];
    int i;
    memcpy(z, q->x[k], sizeof q->x[0]);
    memcpy(y, stage_g(s, k), sizeof z[0] * (k < NS ? NZS : NXS));
    if (k < NS) {
        real_t (*S)[NZS] = stage_S(s, k);
        memcpy(z + NXS, &q->z[k * NUS], sizeof z[0] * NUS);
        qp_add_symmetric(y, stage_Q(s, k)[0], NZS, z, NZS);
        riccati_combine(y, q->lam[k + 1], S[0], NZS, NXS, NZS);
        for (i = 0; i < NXS; i++) {
            r->b[k][i] = stage_b(s, k)[i] - q->x[k + 1][i] + riccati_dot(S[i], z, NZS);
        }
        for (i = 0; i < NUS; i++) {
            y[NXS + i] += q->mult[k * NUS + i];
            r->du[k * NUS + i] = R(0);
        }
    } else {
        qp_add_symmetric(y, stage_Q_N(s)[0], NXS, z, NXS);
    }
    for (i = 0; k > 0 && i < NXS; i++) {
        y[i] -= q->lam[k][i];
    }
#if NG
    for (int m = stage_first[k]; m < stage_first[k + 1]; m++) {
        if (q->side[NV + m] != 0) {
            qp_add_row(s, m, q->mult[NV + m], y);
        }
    }
#endif
}

/* The largest entry of the gradient relative to multipliers of the dynamics, or what they exert on the controls. */
static real_t qp_gradient_size(solver_t *s)
{
    qp_t *q = &s->qp;
    real_t *size = q->size, worst = R(0);
    int k, i, j;
    memset(size, 0, sizeof q->size);
    for (k = 0; k < NS; k++) {
        const real_t *g = stage_g(s, k);
        real_t terms[NUS];
        for (j = 0; j < NUS; j++) {
            terms[j] = FABS(q->mult[k * NUS + j]) + FABS(g[NXS + j]);
        }
        for (i = 0; i < NXS; i++) {
            const real_t lam = FABS(q->lam[k + 1][i]);
            const real_t term = lam + FABS(g[i]);
            size[i] = term > size[i] ? term : size[i];
            for (j = 0; j < NUS; j++) {
                terms[j] += lam * FABS(stage_S(s, k)[i][NXS + j]);
            }
        }
        for (j = 0; j < NUS; j++) {
            size[NXS + j] = terms[j] > size[NXS + j] ? terms[j] : size[NXS + j];
        }
    }
    for (k = 0; k <= NS; k++) {
        for (i = 0; i < (k < NS ? NZS : NXS); i++) {
            const real_t y = (k == 0 && i < NXS) ? R(0) : FABS(s->riccati.g[k][i]);
            worst = y > worst * size[i] ? y / size[i] : worst;
        }
    }
    return worst;
}

#if NG
/* By how much to stretch the correction (dx, dz), d = distances of the members: to the least (d + times change)'W(d + times change).
 * Where members nearly depend on each other the method of multipliers takes short steps in one direction. */
static real_t qp_stretch(solver_t *s)
{
    qp_t *q = &s->qp;
    real_t gain = R(0), size = R(0);
    int m;
    for (m = 0; m < NG; m++) {
        const int c = NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            const real_t change = qp_row_value(s, m, q->dx, q->dz);
            gain -= s->riccati.weight[m] * change * (q->value[m] - q->target[c]);
            size += s->riccati.weight[m] * change * change;
        }
    }
    if (!(gain > size)) {
        return R(1);
    }
    return gain < R(65536) * size ? gain / size : R(65536);
}

#endif
/* Adds `times` the correction (dx, dz) and what it does to the multipliers: those of members from its value, small as it is, for
 * the rounding of a'z - t would be multiplied by the weight. */
static void qp_add_correction(solver_t *s, real_t times)
{
    qp_t *q = &s->qp;
    riccati_t *r = &s->riccati;
    real_t lam[NXS];
    int k, i, c;
    for (k = 0; k <= NS; k++) {
        riccati_adjoint(r, k, q->dx[k], lam);
        for (i = 0; i < NXS; i++) {
            q->lam[k][i] += times * lam[i];
            q->x[k][i] += times * q->dx[k][i];
        }
    }
    for (c = 0; c < NV; c++) {
        k = c / NUS;
        if (q->side[c] != 0) {
            q->mult[c] -= times * riccati_control_gradient(r, k, c % NUS, q->dx[k], &q->dz[k * NUS]);
        }
    }
    for (c = 0; c < NV; c++) {
        q->z[c] += times * q->dz[c];
    }
#if NG
    for (int m = 0; m < NG; m++) {
        const real_t change = qp_row_value(s, m, q->dx, q->dz);
        c = NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            q->mult[c] += times * r->weight[m] * (change + (q->value[m] - q->target[c]));
        } else if (q->side[c] != 0) {
            q->mult[c] += times * r->weight[m] * change;
        }
        q->value[m] = qp_row_value(s, m, q->x, q->z);
    }
#endif
}

#if NG
/* The largest distance of a member from its bound, relative. */
static real_t qp_distance(const solver_t *s)
{
    const qp_t *q = &s->qp;
    real_t largest = R(0);
    int m;
    for (m = 0; m < NG; m++) {
        const int c = NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            const real_t distance = FABS(q->value[m] - q->target[c]);
            const real_t size = qp_row_size(s, m) + FABS(q->target[c]);
            largest = distance > largest * size ? distance / size : largest;
        }
    }
    return largest;
}

#endif
/* The correction of (x, z, lam, mult) for the residuals in the right-hand sides; weight (a'z - t) a of members joins them. */
static void qp_direction(solver_t *s)
{
    qp_t *q = &s->qp;
#if NG
    for (int m = 0; m < NG; m++) {
        const int c = NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            qp_add_row(s, m, s->riccati.weight[m] * (q->value[m] - q->target[c]), s->riccati.g[stage_of_row[m]]);
        }
    }
#endif
    riccati_backward(s, NS);
    memset(q->dx[0], 0, sizeof q->dx[0]);
    riccati_forward(s, q->dx, q->dz);
}

/* Corrections until the residuals are rounding; slow ones near to it are stretched, every other one. OK; STALLED: they fall no
 * more, the members may contradict each other; NUMERICAL_FAILURE. */
static status_t qp_refine(solver_t *s)
{
    qp_t *q = &s->qp;
    real_t slow = (real_t)INFINITY;
    int i, k, stretched = 0;
    for (k = 0; k <= NS; k++) {
        riccati_adjoint(&s->riccati, k, q->x[k], q->lam[k]);
    }
    q->stale_vectors = NS;
    q->refined = 1;
    q->residual = (real_t)INFINITY;
    for (i = 0; i <= QP_MAX_REFINEMENTS; i++) {
        const real_t before = q->residual;
        real_t distance;
        for (k = 0; k <= NS; k++) {
            qp_residual(s, k);
        }
        q->residual = qp_gradient_size(s);
        distance = R(0);
#if NG
        distance = qp_distance(s);
        q->residual = distance > q->residual ? distance : q->residual;
#endif
        if (!isfinite(q->residual) || !qp_measure(q)) {
            return NUMERICAL_FAILURE;
        }
        if (q->residual <= TOL_RICCATI_REFINED) {
            return OK;
        }
        stretched = !stretched && q->residual > R(0.5) * before;
        if (stretched) {
            if (distance < q->residual || q->residual > TOL_RICCATI_ROUNDING || q->residual > R(0.5) * slow) {
                return STALLED;
            }
            slow = q->residual;
        }
        qp_direction(s);
#if NG
        qp_add_correction(s, stretched ? qp_stretch(s) : R(1.0));
#else
        qp_add_correction(s, R(1.0));
#endif
        q->refinements++;
    }
    return STALLED;
}
