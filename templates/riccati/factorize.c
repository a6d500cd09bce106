/* Sets the padding of P_k to zero, as it takes part in products. */
static inline void riccati_clear_padding(real_t (*P)[LDX])
{
    for (int i = 0; i < LDX; i++) {
        for (int j = (i < NX) ? NX : 0; j < LDX; j++) {
            P[i][j] = R(0);
        }
    }
}

/* Loads P_k (lower triangle) and M_u before the cost to go is added: Q_k, and `diagonal` for the controls. */
static void riccati_load_stage(solver_t *s, int k)
{
    riccati_t *r = &s->riccati;
    real_t(*Q)[NZ] = stage_Q(s, k);
    real_t(*P)[LDX] = r->P[k];
    real_t(*M)[LDZ] = r->M[k];
    for (int i = 0; i < NX; i++) {
        (void)memcpy(P[i], Q[i], sizeof(Q[0][0]) * NX);
    }
    if (!SMALL) {
        riccati_clear_padding(P);
    }
    for (int j = 0; j < NU; j++) {
        (void)memcpy(M[j], Q[NX + j], sizeof Q[0]);
        M[j][NX + j] += r->diagonal[k][j];
    }
}

static void riccati_load_terminal(solver_t *s)
{
    riccati_t *r = &s->riccati;
    for (int i = 0; i < NX; i++) {
        (void)memcpy(r->P[N][i], stage_Q_N(s)[i], sizeof r->P[0][0][0] * NX);
    }
    if (!SMALL) {
        riccati_clear_padding(r->P[N]);
    }
}

/* P += A'B, lower triangle, where A and B have n rows. */
static inline void riccati_update_states(riccati_t *r, int k, const real_t *A, const real_t *B, int n)
{
    if (SMALL) {
        riccati_lower(r->P[k][0], LDX, A, LDW, B, LDZ, n, NX);
    } else {
        for (int i = 0; i < LDX; i += 4) {
            riccati_rows(r->P[k][i], LDX, A + i, LDW, B, LDZ, n, i + 4);
        }
    }
}

static inline void riccati_update_controls(riccati_t *r, int k, const real_t *A, const real_t *B, int n)
{
    if (SMALL) {
        riccati_product(r->M[k][0], LDZ, A + NX, LDW, B, LDZ, n, NU, NZ);
    } else {
        for (int j = 0; j < NU; j += 4) {
            riccati_rows(r->M[k][j], LDZ, A + NX + j, LDW, B, LDZ, n, LDZ);
        }
    }
}

/* Returns the weight of a a' for row m. */
static inline real_t riccati_weight(const riccati_t *r, int m)
{
    if (REGULARIZE_REDUCED) {
        return (r->held[m] > R(0)) ? r->weight[m] + r->held[m] : r->weight[m];
    } else {
        return r->weight[m];
    }
}

/* Writes the general row m to index n of a group. */
static inline void riccati_collect_row(solver_t *s, int m, int n)
{
    recursion_t *work = &s->riccati.work.recursion;
    const int width = row_node(m) < N ? NZ : NX;
    const real_t *a = row_gradient(s, m), w = riccati_weight(&s->riccati, m);
    for (int i = 0; i < width; i++) {
        work->W[n][i] = w * a[i];
        work->T[n][i] = a[i];
    }
}

/* Adds the n rows of a group to the Hessian of stage k. */
static inline void riccati_add_group(riccati_t *r, int k, int n)
{
    /* 1 <= n <= 4 */
    const recursion_t *work = &r->work.recursion;
    riccati_update_states(r, k, work->W[0], work->T[0], n);
    if (k < N) {
        riccati_update_controls(r, k, work->W[0], work->T[0], n);
    }
}

/* Adds weight a a' for the rows of stage k: state bounds to the diagonal, the others in groups of four. */
static void riccati_add_weights(solver_t *s, int k)
{
    riccati_t *r = &s->riccati;
    int n = 0;
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        const int i = row_index(m), bounds = row_is_state(m);
        const real_t weight = riccati_weight(r, m);
        const int counts = weight != R(0); /* rows without weight are skipped */
        if (counts && bounds) {
            r->P[k][i][i] += weight;
        }
        if (GENERAL_ROWS || NE) {
            if (counts && !bounds) {
                riccati_collect_row(s, m, n);
                n++;
            }
            if (n == 4 || (n > 0 && m + 1 == row_first[k + 1])) {
                riccati_add_group(r, k, n);
                n = 0;
            }
        }
    }
}

#if !TILES
/* T = P_{k+1} S_k, with S_k copied to W and padded. */
static void riccati_propagate(solver_t *s, int k)
{
    const riccati_t *r = &s->riccati;
    recursion_t *work = &s->riccati.work.recursion;
    real_t(*S)[NZ] = stage_S(s, k);
    for (int i = 0; i < NX; i++) {
        (void)memcpy(work->W[i], S[i], sizeof S[0]);
    }
    (void)memset(work->T, 0, sizeof work->T);
    if (SMALL) {
        riccati_product(work->T[0], LDZ, r->P[k + 1][0], LDX, work->W[0], LDW, NX, NX, NZ);
    } else {
        for (int i = 0; i < LDX; i += 4) {
            riccati_rows(work->T[i], LDZ, &r->P[k + 1][0][i], LDX, work->W[0], LDW, NX, LDZ);
        }
    }
}

/* Copies M_uu of the free controls to L (lower triangle) and their M_ux to V (T below the states). Fixed controls get
 * rows of the identity in L and zero rows in V. */
static inline void riccati_load_controls(riccati_t *r, int k)
{
    const int first = k * NU;
    const int32_t *fixed = &r->fixed[first];
    for (int j = 0; j < NU; j++) {
        const real_t *M = r->M[k][j];
        real_t *V = r->work.recursion.T[NX + j];
        for (int l = 0; l < j; l++) {
            r->L[k][j][l] = (fixed[j] || fixed[l]) ? R(0) : M[NX + l];
        }
        r->L[k][j][j] = fixed[j] ? R(1) : M[NX + j];
        for (int i = 0; i < LDX; i++) {
            V[i] = (fixed[j] || i >= NX) ? R(0) : M[i];
        }
    }
}

#endif
/* Returns the pivot d of a matrix whose diagonal entry is `reference`, or 0 if it is not positive. If r->regularize is
 * set, a pivot that may be zero is increased by `added`, a small fraction of that entry. */
static inline real_t riccati_pivot(const riccati_t *r, real_t d, real_t reference, real_t *added)
{
    const real_t unit = SQRT(TOL_UNIT);
    *added = R(0);
    if (isfinite(d) && d > TOL_RICCATI_PIVOT * reference) {
        return d;
    }
    if (!r->regularize || !(d >= -unit * FABS(reference) - r->regularize_zero) || !isfinite(reference)) {
        return R(0);
    }
    *added = FACTOR_RICCATI_RAISED_PIVOT * unit * reference + r->regularize_zero;
    return d + *added;
}

#if TILES
#include "riccati/factorize_lanes.c"
#else
/* Eliminates the controls: factorises M_uu = L D L', with 1 / D on the diagonal of L, and computes V = L^{-1} M_ux. The
 * rows of W after those of the states become -D^{-1} V. Returns 0 if a pivot is not positive. */
static int riccati_eliminate_controls(riccati_t *r, int k)
{
    real_t(*L)[NU] = r->L[k];
    real_t(*V)[LDZ] = r->work.recursion.T + NX;
    riccati_load_controls(r, k);
    r->raised[k] = 0;
    for (int l = 0; l < NU; l++) {
        real_t *reference = &r->M[k][l][NX + l], *scaled = r->work.recursion.W[NX + l], added;
        const real_t pivot = riccati_pivot(r, L[l][l], r->fixed[k * NU + l] ? R(0) : *reference, &added);
        if (!(pivot > R(0))) {
            return 0;
        }
        r->raised[k] |= added > R(0);
        *reference += added;
        L[l][l] = R(1) / pivot;
        for (int j = l + 1; j < NU; j++) {
            const real_t y = L[j][l];
            L[j][l] = y * L[l][l];
            for (int i = l + 1; i <= j; i++) {
                L[j][i] -= y * L[i][l];
            }
            riccati_add(V[j], -L[j][l], V[l], LDX);
        }
        for (int i = 0; i < LDX; i++) {
            scaled[i] = -L[l][l] * V[l][i];
        }
    }
    return 1;
}

/* L'K = -D^{-1} V. */
static inline void riccati_gain(riccati_t *r, int k)
{
    for (int j = NU - 1; j >= 0; j--) {
        (void)memcpy(r->K[k][j], r->work.recursion.W[NX + j], sizeof r->K[0][0]);
        for (int l = j + 1; l < NU; l++) {
            riccati_add(r->K[k][j], -r->L[k][l][j], r->K[k][l], LDX);
        }
    }
}

#endif
#if !TILES || NF
/* Copies the lower triangle of P_k to the upper one. */
static inline void riccati_mirror(real_t (*P)[LDX])
{
    for (int i = 1; i < NX; i++) {
        for (int j = 0; j < i; j++) {
            P[j][i] = P[i][j];
        }
    }
}

#endif
#if !TILES
/* P_k = Q_xx + A'P_{k+1}A - V'D^{-1}V, computed as one product of (A, -D^{-1}V) with (P_{k+1}A, V). */
static int riccati_stage(solver_t *s, int k)
{
    riccati_t *r = &s->riccati;
    const recursion_t *work = &r->work.recursion;
    riccati_load_stage(s, k);
    for (int f = 0; k == 0 && f < NF; f++) {
        r->P[0][free_state[f]][free_state[f]] += r->diagonal_free[f];
    }
    riccati_add_weights(s, k);
    riccati_propagate(s, k);
    riccati_update_controls(r, k, work->W[0], work->T[0], NX);
    if (!riccati_eliminate_controls(r, k)) {
        r->failed = k;
        return 0;
    }
    riccati_gain(r, k);
    riccati_update_states(r, k, work->W[0], work->T[0], NZ);
    riccati_mirror(r->P[k]);
    return 1;
}

#endif
/* Factorises the block of P_0 that belongs to the free components of x_0 as L D L'; small pivots are treated as
 * above. */
static int riccati_factorize_free(riccati_t *r)
{
    r->raised[N] = 0;
    for (int l = 0; l < NF; l++) {
        const real_t reference = r->P[0][free_state[l]][free_state[l]];
        real_t d = reference, added;
        for (int j = 0; j < l; j++) {
            d -= r->F[l][j] * r->F[l][j] * r->F[j][j];
        }
        d = riccati_pivot(r, d, reference, &added);
        if (!(d > R(0))) {
            r->failed = -1;
            return 0;
        }
        r->raised[N] |= added > R(0);
        r->F[l][l] = d;
        for (int i = l + 1; i < NF; i++) {
            real_t y = r->P[0][free_state[i]][free_state[l]];
            for (int j = 0; j < l; j++) {
                y -= r->F[i][j] * r->F[l][j] * r->F[j][j];
            }
            r->F[i][l] = y / d;
        }
    }
    return 1;
}

/* Runs the recursion from stage `last` down to stage 0; last = N: all stages and P_N. */
static int riccati_factorize(solver_t *s, int last)
{
    if (last == N) {
        riccati_load_terminal(s);
        riccati_add_weights(s, N);
        if (!TILES) {
            riccati_mirror(s->riccati.P[N]);
        }
    }
    for (int k = last < N ? last : N - 1; k >= 0; k--) {
        if (!riccati_stage(s, k)) {
            return 0;
        }
    }
    if (TILES && NF) {
        riccati_mirror(s->riccati.P[0]);
    }
    if (NF) {
        return riccati_factorize_free(&s->riccati);
    } else {
        return 1;
    }
}
