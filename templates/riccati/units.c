/* This part computes the reach of each row, which is the distance by which half a unit of cost moves its value, from
 * the factors of the recursion. */

/* Returns the term added to a zero pivot that has no scale of its own. */
static real_t riccati_least_pivot(solver_t *s)
{
    real_t diagonal[NZ] = {0}, most = R(0);
    for (int k = 0; k < N; k++) {
        real_t(*Q)[NZ] = stage_Q(s, k);
        for (int i = 0; i < NZ; i++) {
            diagonal[i] = (Q[i][i] > diagonal[i]) ? Q[i][i] : diagonal[i];
        }
    }
    for (int i = 0; i < NX; i++) {
        const real_t d = stage_Q_N(s)[i][i];
        diagonal[i] = (d > diagonal[i]) ? d : diagonal[i];
    }
    for (int i = 0; i < NZ; i++) {
        most = (diagonal[i] > most) ? diagonal[i] : most;
    }
    return SQRT(TOL_UNIT) * ((most > R(0) && isfinite(most)) ? most : R(1));
}

/* Computes stage k under u = K x + G xi, where xi has unit covariance: G' in `gain` (columns of fixed controls 0, G G'
 * = M_uu^{-1}), (A + B K)' in `closed`, (B G)' in `push`. */
static void riccati_closed_loop(solver_t *s, int k)
{
    const riccati_t *r = &s->riccati;
    noise_t *q = &s->riccati.work.noise;
    real_t(*S)[NZ] = stage_S(s, k);
    real_t column[LDX] = {0};
    for (int l = 0; l < NU; l++) {
        const int fixed = r->fixed[k * NU + l];
        for (int j = NU - 1; j >= 0; j--) {
            q->gain[l][j] = (j == l && !fixed) ? SQRT(r->L[k][l][l]) : R(0);
            for (int i = j + 1; i <= l; i++) {
                q->gain[l][j] -= r->L[k][i][j] * q->gain[l][i];
            }
        }
    }
    for (int l = 0; l < NX; l++) {
        for (int i = 0; i < NX; i++) {
            q->closed[l][i] = S[i][l];
        }
    }
    (void)memset(q->push, 0, sizeof q->push);
    for (int j = 0; j < NU; j++) {
        for (int i = 0; i < NX; i++) {
            column[i] = S[i][NX + j];
        }
        for (int l = 0; l < NX; l++) {
            riccati_add(q->closed[l], r->K[k][j][l], column, LDX);
        }
        for (int l = 0; l < NU; l++) {
            riccati_add(q->push[l], q->gain[l][j], column, LDX);
        }
    }
}

/* Computes the covariance of x_{k+1}: closed' C closed + push' push. */
static void riccati_propagate_covariance(noise_t *q)
{
    (void)memset(q->product, 0, sizeof q->product);
    if (SMALL) {
        riccati_product(q->product[0], LDX, q->covariance[0], LDX, q->closed[0], LDX, NX, NX, NX);
    } else {
        for (int i = 0; i < LDX; i += 4) {
            riccati_rows(q->product[i], LDX, &q->covariance[0][i], LDX, q->closed[0], LDX, NX, LDX);
        }
    }
    (void)memset(q->covariance, 0, sizeof q->covariance);
    if (SMALL) {
        riccati_lower(q->covariance[0], LDX, q->closed[0], LDX, q->product[0], LDX, NX, NX);
        riccati_lower(q->covariance[0], LDX, q->push[0], LDX, q->push[0], LDX, NU, NX);
    } else {
        for (int i = 0; i < LDX; i += 4) {
            riccati_rows(q->covariance[i], LDX, &q->closed[0][i], LDX, q->product[0], LDX, NX, i + 4);
            riccati_rows(q->covariance[i], LDX, &q->push[0][i], LDX, q->push[0], LDX, NU, i + 4);
        }
    }
    for (int i = 0; i < LDX; i++) {
        for (int j = i + 1; j < LDX; j++) {
            q->covariance[i][j] = q->covariance[j][i];
        }
    }
}

/* Returns (a' Cov(x, u) a)^{1/2} at stage k: c' C c + |G'a_u|^2, c = a_x + K'a_u. */
static real_t riccati_reach(const riccati_t *r, int k, const real_t *a_x, const real_t *a_u)
{
    const noise_t *q = &r->work.noise;
    real_t c[LDX] = {0}, w[LDX] = {0}, sum = R(0);
    (void)memcpy(c, a_x, sizeof c[0] * NX);
    for (int l = 0; k < N && l < NU; l++) {
        const real_t part = riccati_dot(q->gain[l], a_u, NU);
        riccati_add(c, a_u[l], r->K[k][l], LDX);
        sum += part * part;
    }
    riccati_combine(w, c, q->covariance[0], LDX, NX, LDX);
    sum += riccati_dot(w, c, LDX);
    return (sum > R(0)) ? SQRT(sum) : R(0);
}

/* Computes the reach of the rows of stage k. */
static void riccati_rows_reach(solver_t *s, int k)
{
    const noise_t *q = &s->riccati.work.noise;
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        const int i = row_index(m);
        if (GENERAL_ROWS || NE) {
            if (!row_is_state(m)) {
                const real_t *a = row_gradient(s, m);
                s->units.reach[NV + m] = riccati_reach(&s->riccati, k, a, (k < N) ? a + NX : a);
                continue;
            }
        }
        s->units.reach[NV + m] = (q->covariance[i][i] > R(0)) ? SQRT(q->covariance[i][i]) : R(0);
    }
}

/* Computes the reach of the controls of stage k. */
static void riccati_controls_reach(solver_t *s, int k)
{
    for (int j = 0; j < NU; j++) {
        real_t a[NZ] = {0};
        a[NX + j] = R(1);
        s->units.reach[k * NU + j] = riccati_reach(&s->riccati, k, a, a + NX);
    }
}

/* reach_c = (a_c'H^{-1}a_c)^{1/2}, the distance by which half a unit of cost moves row c, where H is the factorised
 * Hessian on the null space of the dynamics. H^{-1} is computed as the covariance of the states and controls of a
 * linear system driven by unit noise. A reach of 0 means that the row depends on no control. */
static void riccati_set_reach(solver_t *s)
{
    noise_t *q = &s->riccati.work.noise;
    (void)memset(q, 0, sizeof *q);
    for (int f = 0; f < NF; f++) {
        (void)memset(s->riccati.p[0], 0, sizeof s->riccati.p[0]);
        s->riccati.p[0][free_state[f]] = -R(1);
        riccati_solve_free(&s->riccati, q->covariance[free_state[f]]);
    }
    for (int k = 0; k < N; k++) {
        riccati_closed_loop(s, k);
        riccati_controls_reach(s, k);
        riccati_rows_reach(s, k);
        riccati_propagate_covariance(q);
    }
    riccati_rows_reach(s, N);
}
