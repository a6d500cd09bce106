/* Contract of this part: units of the rows, how far one half unit of cost moves them, from the factors of the recursion. */

/* What is added to a pivot that is zero and has no scale of its own. */
static real_t riccati_least_pivot(solver_t *s)
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

#if NG || INTERIOR_POINT
/* Stage k under u = K x + G xi, unit covariance of xi: G' (columns of fixed controls 0, G G' = M_uu^{-1}) into `noise`,
 * (A + B K)' into `closed`, (B G)' into `push`. */
static void riccati_closed_loop(solver_t *s, int k)
{
    const riccati_t *r = &s->riccati;
    units_t *q = &s->units;
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
static void riccati_propagate_covariance(solver_t *s)
{
    units_t *q = &s->units;
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
static real_t riccati_reach(solver_t *s, int k, const real_t *a_x, const real_t *a_u)
{
    units_t *q = &s->units;
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
static void riccati_stage_reach(solver_t *s, int k)
{
    units_t *q = &s->units;
    real_t zero[NZS] = {0};
    int j;
    for (j = 0; k < NS && j < NUS; j++) {
        zero[NXS + j] = R(1);
        q->reach[k * NUS + j] = riccati_reach(s, k, zero, zero + NXS);
        zero[NXS + j] = R(0);
    }
#if NG
    for (int m = stage_first[k]; m < stage_first[k + 1]; m++) {
        const int i = stage_state[m];
#if GENERAL_ROWS || NE || BLOCK_ROWS
        if (i < 0) {
            const real_t *a = stage_row(s, m);
            q->reach[NV + m] = riccati_reach(s, k, a, (k < NS) ? a + NXS : zero);
            continue;
        }
#endif
        q->reach[NV + m] = (q->covariance[i][i] > R(0.0)) ? SQRT(q->covariance[i][i]) : R(0.0);
    }
#endif
}

/* reach_c = (a_c'H^{-1}a_c)^{1/2}: how far one half unit of cost moves row c, H that of the factorisation on the null space of
 * the dynamics. Covariances of a linear system driven by unit noise: those of the variables have the inverse H^{-1}. 0: no control
 * moves the row. */
static void riccati_set_reach(solver_t *s)
{
    units_t *q = &s->units;
    int k;
    memset(q->covariance, 0, sizeof q->covariance);
#if NF
    for (int f = 0; f < NF; f++) {
        memset(s->riccati.p[0], 0, sizeof s->riccati.p[0]);
        s->riccati.p[0][free_state[f]] = -R(1);
        riccati_solve_free(&s->riccati, q->covariance[free_state[f]]);
    }
#endif
#if NXS > NX
    for (int f = 0; f < NXS - NX; f++) {
        memcpy(q->covariance[NX + f], q->covariance[copied_state[f]], sizeof q->covariance[0]);
    }
#endif
    for (k = 0; k < NS; k++) {
        riccati_closed_loop(s, k);
        riccati_stage_reach(s, k);
        riccati_propagate_covariance(s);
    }
    riccati_stage_reach(s, NS);
}
#endif
