/* ==== qp: riccati_active_set ============================================================================== */

/* ---------------------------------------------------------------------------------------------------------------------
 * qp: active set on the Riccati recursion
 *
 *     min  sum_{k<NS} 1/2 z_k'Q_k z_k + g_k'z_k  +  1/2 x_NS'Q_NS x_NS + g_NS'x_NS,   x_{k+1} = S_k z_k + b_k,   dx_0 given
 *     s.t. lower <= (u, rows) <= upper
 *
 * Contract of the seam
 *   qp_init       once: everything zero, all bounds and penalties infinite, empty working set.
 *   qp_factorize  preparation: all but x_0 is known, lower and upper hold a prediction. Recursion at the predicted working set.
 *   qp_gradient   gradients of the stages changed, matrices did not.
 *   qp_solve      feedback: dx_0 in step.dx[0], lower, upper, penalty are known. Writes x, z, mult, iterations, changes, relaxed.
 *                 OK; ITERATION_LIMIT, STALLED (a working set came back), INFEASIBLE; NUMERICAL_FAILURE: x = z = mult = 0.
 *   qp_shift_working_set  before qp_factorize: the prediction moves n controls towards the front, and rows as told (its own template).
 * Bounds may be infinite; equality = equal bounds. Soft rows (penalty finite) cost penalty v + curvature / 2 v^2 for a
 * violation v; how many are violated is counted in relaxed.
 * side[] is the working set and stays for the warm start (+-1: member at its upper or lower bound, +-2: soft and violated); a
 * caller may edit it before qp_factorize.
 *
 * Method: the minimiser on the working set by one Riccati recursion: given controls are eliminated, members that are rows enter
 * by the method of multipliers, which needs no decision about their rank. Then every side anew from values and signs of
 * multipliers (primal-dual active set; Hintermueller, Ito, Kunisch 2003); the recursion is repeated from the last stage that
 * changed down to 0.
 * ------------------------------------------------------------------------------------------------------------------ */

/* Riccati recursion on the stage QP, shared by the Riccati solvers.
 *
 *     min  sum_{k<NS} 1/2 z_k'M_k z_k + g_k'z_k  +  1/2 x_NS'M_NS x_NS + g_NS'x_NS,   z = (x, u),   x_{k+1} = S_k z_k + b_k
 *
 *     M_k = Q_k + diag(diagonal[k]) + sum of weight[m] a_m a_m' over the rows m of stage k;   u_j given where fixed[j] != 0
 *
 * Cost to go 1/2 x'P_k x + p_k'x. With M_k := M_k + S_k'P_{k+1}S_k, its rows M_u of the controls and M_uu = L D L' of those that
 * are free:   K = -M_uu^{-1} M_ux,   P_k = M_xx + M_ux'K.
 *
 * Contract
 *   riccati_init       once: everything zero.
 *   riccati_factorize  M, L, inverse, K of the stages last .. 0 and P_last .. P_0 from Q, S, diagonal, weight, fixed (last = NS:
 *                      all of them, P_NS too). Later stages stand. 0: a pivot is not positive (stage in failed), else 1.
 *   riccati_backward   p, feed, h of the stages last .. 0 from g, b, du (values of the fixed controls); later ones stand.
 *   riccati_forward    x[1..NS] and u of the minimiser, from x[0]; its free components are computed.
 * The caller sets diagonal, weight, fixed, then g, b, du. Symmetric matrices P_k are stored in full; their rows and columns
 * NX .. LDX are padding. Products run in blocks of four rows and eight columns: such loops are the ones that compilers turn
 * into vector operations without being asked to. */

/* Four rows of a product: c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < 8. */
static inline void riccati_block_8(golden_real *c, int ldc, const golden_real *a, int lda, const golden_real *b, int ldb, int n)
{
    golden_real s0[8] = {0}, s1[8] = {0}, s2[8] = {0}, s3[8] = {0};
    int i, l;
    for (l = 0; l < n; l++) {
        const golden_real a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (i = 0; i < 8; i++) { s0[i] += a0 * b[i]; }
        for (i = 0; i < 8; i++) { s1[i] += a1 * b[i]; }
        for (i = 0; i < 8; i++) { s2[i] += a2 * b[i]; }
        for (i = 0; i < 8; i++) { s3[i] += a3 * b[i]; }
        a += lda;
        b += ldb;
    }
    for (i = 0; i < 8; i++) { c[i] += s0[i]; }
    for (i = 0; i < 8; i++) { c[ldc + i] += s1[i]; }
    for (i = 0; i < 8; i++) { c[2 * ldc + i] += s2[i]; }
    for (i = 0; i < 8; i++) { c[3 * ldc + i] += s3[i]; }
}

/* The same for j < 4. */
static inline void riccati_block_4(golden_real *c, int ldc, const golden_real *a, int lda, const golden_real *b, int ldb, int n)
{
    golden_real s0[4] = {0}, s1[4] = {0}, s2[4] = {0}, s3[4] = {0};
    int i, l;
    for (l = 0; l < n; l++) {
        const golden_real a0 = a[0], a1 = a[1], a2 = a[2], a3 = a[3];
        for (i = 0; i < 4; i++) { s0[i] += a0 * b[i]; }
        for (i = 0; i < 4; i++) { s1[i] += a1 * b[i]; }
        for (i = 0; i < 4; i++) { s2[i] += a2 * b[i]; }
        for (i = 0; i < 4; i++) { s3[i] += a3 * b[i]; }
        a += lda;
        b += ldb;
    }
    for (i = 0; i < 4; i++) { c[i] += s0[i]; }
    for (i = 0; i < 4; i++) { c[ldc + i] += s1[i]; }
    for (i = 0; i < 4; i++) { c[2 * ldc + i] += s2[i]; }
    for (i = 0; i < 4; i++) { c[3 * ldc + i] += s3[i]; }
}

/* c[r][j] += sum_{l<n} a[l][r] b[l][j],  r < 4, j < width; width is a multiple of 4. */
static void riccati_rows(golden_real *c, int ldc, const golden_real *a, int lda, const golden_real *b, int ldb, int n, int width)
{
    int j;
    for (j = 0; j + 8 <= width; j += 8) {
        riccati_block_8(c + j, ldc, a, lda, b + j, ldb, n);
    }
    if (j < width) {
        riccati_block_4(c + j, ldc, a, lda, b + j, ldb, n);
    }
}

/* y[j] += a x[j],  j < n; n is a multiple of 4. */
static inline void riccati_add(golden_real *y, golden_real a, const golden_real *x, int n)
{
    int j, i;
    for (j = 0; j < n; j += 4) {
        golden_real s[4];
        for (i = 0; i < 4; i++) { s[i] = y[j + i] + a * x[j + i]; }
        for (i = 0; i < 4; i++) { y[j + i] = s[i]; }
    }
}

/* y[j] += sum_{l<n} a[l] rows[l][j],  j < width. */
static inline void riccati_combine(golden_real *y, const golden_real *a, const golden_real *rows, int ld, int n, int width)
{
    const int eights = width / 8 * 8, fours = width / 4 * 4;
    int j, i, l;
    for (j = 0; j < eights; j += 8) {
        golden_real s[8] = {0};
        for (l = 0; l < n; l++) {
            const golden_real *row = rows + l * ld + j;
            for (i = 0; i < 8; i++) { s[i] += a[l] * row[i]; }
        }
        for (i = 0; i < 8; i++) { y[j + i] += s[i]; }
    }
    for (j = eights; j < fours; j += 4) {
        golden_real s[4] = {0};
        for (l = 0; l < n; l++) {
            const golden_real *row = rows + l * ld + j;
            for (i = 0; i < 4; i++) { s[i] += a[l] * row[i]; }
        }
        for (i = 0; i < 4; i++) { y[j + i] += s[i]; }
    }
    for (j = fours; j < width; j++) {
        golden_real sum = 0.0;
        for (l = 0; l < n; l++) {
            sum += a[l] * rows[l * ld + j];
        }
        y[j] += sum;
    }
}

/* sum_j a[j] b[j],  j < n. */
static inline golden_real riccati_dot(const golden_real *a, const golden_real *b, int n)
{
    golden_real s[8] = {0}, t[4];
    golden_real sum = 0.0;
    const int eights = n / 8 * 8, fours = n / 4 * 4;
    int j, i;
    for (j = 0; j < eights; j += 8) {
        for (i = 0; i < 8; i++) { s[i] += a[j + i] * b[j + i]; }
    }
    for (i = 0; i < 4; i++) { t[i] = s[i] + s[i + 4]; }
    for (j = eights; j < fours; j += 4) {
        for (i = 0; i < 4; i++) { t[i] += a[j + i] * b[j + i]; }
    }
    for (j = fours; j < n; j++) {
        sum += a[j] * b[j];
    }
    return sum + ((t[0] + t[2]) + (t[1] + t[3]));
}

/* The padding of P_k takes part in products. */
static inline void riccati_clear_padding(golden_real (*P)[GOLDEN_LDX])
{
    int i, j;
    for (i = 0; i < GOLDEN_LDX; i++) {
        for (j = (i < GOLDEN_NXS) ? GOLDEN_NXS : 0; j < GOLDEN_LDX; j++) {
            P[i][j] = 0.0;
        }
    }
}

/* P_k (lower triangle) and M_u before the cost to go enters: Q_k and the diagonal. */
static void riccati_load_stage(golden_solver_t *s, int k)
{
    golden_riccati_t *r = &s->riccati;
    golden_real (*Q)[GOLDEN_NZS] = stage_Q(s, k);
    golden_real (*P)[GOLDEN_LDX] = r->P[k];
    golden_real (*M)[GOLDEN_LDZ] = r->M[k];
    int i, j;
    for (i = 0; i < GOLDEN_NXS; i++) {
        memcpy(P[i], Q[i], sizeof(Q[0][0]) * GOLDEN_NXS);
        P[i][i] += r->diagonal[k][i];
    }
    riccati_clear_padding(P);
    for (j = 0; j < GOLDEN_NUS; j++) {
        memcpy(M[j], Q[GOLDEN_NXS + j], sizeof Q[0]);
        M[j][GOLDEN_NXS + j] += r->diagonal[k][GOLDEN_NXS + j];
    }
}

static void riccati_load_terminal(golden_solver_t *s)
{
    golden_riccati_t *r = &s->riccati;
    int i;
    for (i = 0; i < GOLDEN_NXS; i++) {
        memcpy(r->P[GOLDEN_NS][i], stage_Q_N(s)[i], sizeof r->P[0][0][0] * GOLDEN_NXS);
        r->P[GOLDEN_NS][i][i] += r->diagonal[GOLDEN_NS][i];
    }
    riccati_clear_padding(r->P[GOLDEN_NS]);
}

/* Lower triangle of P += A'B for rows A, B of n entries each. */
static inline void riccati_update_states(golden_riccati_t *r, int k, const golden_real *A, const golden_real *B, int n)
{
    int i;
    for (i = 0; i < GOLDEN_LDX; i += 4) {
        riccati_rows(r->P[k][i], GOLDEN_LDX, A + i, GOLDEN_LDW, B, GOLDEN_LDZ, n, i + 4);
    }
}

static inline void riccati_update_controls(golden_riccati_t *r, int k, const golden_real *A, const golden_real *B, int n)
{
    int j;
    for (j = 0; j < GOLDEN_NUS; j += 4) {
        riccati_rows(r->M[k][j], GOLDEN_LDZ, A + GOLDEN_NXS + j, GOLDEN_LDW, B, GOLDEN_LDZ, n, GOLDEN_LDZ);
    }
}

/* weight a a' of the rows of stage k: state bounds on the diagonal, the others in groups of four. */
static void riccati_add_weights(golden_solver_t *s, int k)
{
    golden_riccati_t *r = &s->riccati;
    const int width = k < GOLDEN_NS ? GOLDEN_NZS : GOLDEN_NXS;
    int n = 0, m, i;
    for (m = stage_first[k]; m < stage_first[k + 1]; m++) {
        const int state = stage_state[m];
        const golden_real w = r->weight[m];
        if (w != 0.0 && state >= 0) {
            r->P[k][state][state] += w;
        } else if (w != 0.0) {
            const golden_real *a = stage_row(s, m);
            for (i = 0; i < width; i++) {
                r->W[n][i] = w * a[i];
                r->T[n][i] = a[i];
            }
            n++;
        }
        if (n == 4 || (n > 0 && m + 1 == stage_first[k + 1])) {
            riccati_update_states(r, k, r->W[0], r->T[0], n);
            if (k < GOLDEN_NS) {
                riccati_update_controls(r, k, r->W[0], r->T[0], n);
            }
            n = 0;
        }
    }
}

/* T = P_{k+1} S_k, S_k padded in W. */
static void riccati_propagate(golden_solver_t *s, int k)
{
    golden_riccati_t *r = &s->riccati;
    golden_real (*S)[GOLDEN_NZS] = stage_S(s, k);
    int i;
    for (i = 0; i < GOLDEN_NXS; i++) {
        memcpy(r->W[i], S[i], sizeof S[0]);
    }
    memset(r->T, 0, sizeof r->T);
    for (i = 0; i < GOLDEN_LDX; i += 4) {
        riccati_rows(r->T[i], GOLDEN_LDZ, &r->P[k + 1][0][i], GOLDEN_LDX, r->W[0], GOLDEN_LDW, GOLDEN_NXS, GOLDEN_LDZ);
    }
}

/* M_uu of the free controls into L (lower triangle), their M_ux into V (T below the states); fixed ones: rows of the identity,
 * and of zeros. */
static inline void riccati_load_controls(golden_riccati_t *r, int k)
{
    const int32_t *fixed = &r->fixed[k * GOLDEN_NUS];
    int i, j, l;
    for (j = 0; j < GOLDEN_NUS; j++) {
        const golden_real *M = r->M[k][j];
        golden_real *V = r->T[GOLDEN_NXS + j];
        for (l = 0; l < j; l++) {
            r->L[k][j][l] = (fixed[j] || fixed[l]) ? 0.0 : M[GOLDEN_NXS + l];
        }
        r->L[k][j][j] = fixed[j] ? 1.0 : M[GOLDEN_NXS + j];
        for (i = 0; i < GOLDEN_LDX; i++) {
            V[i] = (fixed[j] || i >= GOLDEN_NXS) ? 0.0 : M[i];
        }
    }
}

/* The pivot d of a matrix whose diagonal entry was `reference`. One that may be zero gets a share of that entry, if this is
 * asked for. Returns 0 if it is not positive. */
static inline golden_real riccati_pivot(const golden_riccati_t *r, golden_real d, golden_real reference, golden_real *added)
{
    const golden_real unit = sqrt(2.220446049250313e-16);
    *added = 0.0;
    if (isfinite(d) && d > 7.105427357601002e-15 * reference) {
        return d;
    }
    if (!r->regularize || !(d >= -unit * fabs(reference) - r->regularize_zero) || !isfinite(reference)) {
        return 0.0;
    }
    *added = 512.0 * unit * reference + r->regularize_zero;
    return d + *added;
}

/* M_uu = L D L',  V = L^{-1} M_ux,  -D^{-1} V into W below the states. 0 if a pivot is not positive. */
static int riccati_eliminate_controls(golden_riccati_t *r, int k)
{
    golden_real (*L)[GOLDEN_NUS] = r->L[k];
    golden_real (*V)[GOLDEN_LDZ] = r->T + GOLDEN_NXS;
    int i, j, l;
    riccati_load_controls(r, k);
    for (l = 0; l < GOLDEN_NUS; l++) {
        const int fixed = r->fixed[k * GOLDEN_NUS + l];
        golden_real *reference = &r->M[k][l][GOLDEN_NXS + l];
        const golden_real pivot = riccati_pivot(r, L[l][l], fixed ? 0.0 : *reference, &r->proximal[k][l]);
        if (!(pivot > 0.0)) {
            return 0;
        }
        *reference += r->proximal[k][l];
        r->inverse[k][l] = 1.0 / pivot;
        for (j = l + 1; j < GOLDEN_NUS; j++) {
            const golden_real y = L[j][l];
            L[j][l] = y * r->inverse[k][l];
            for (i = l + 1; i <= j; i++) {
                L[j][i] -= y * L[i][l];
            }
            riccati_add(V[j], -L[j][l], V[l], GOLDEN_LDX);
        }
        for (i = 0; i < GOLDEN_LDX; i++) {
            r->W[GOLDEN_NXS + l][i] = -r->inverse[k][l] * V[l][i];
        }
    }
    return 1;
}

/* L'K = -D^{-1} V. */
static inline void riccati_gain(golden_riccati_t *r, int k)
{
    int j, l;
    for (j = GOLDEN_NUS - 1; j >= 0; j--) {
        memcpy(r->K[k][j], r->W[GOLDEN_NXS + j], sizeof r->K[0][0]);
        for (l = j + 1; l < GOLDEN_NUS; l++) {
            riccati_add(r->K[k][j], -r->L[k][l][j], r->K[k][l], GOLDEN_LDX);
        }
    }
}

/* The upper triangle of P_k from the lower one. */
static inline void riccati_mirror(golden_real (*P)[GOLDEN_LDX])
{
    int i, j;
    for (i = 1; i < GOLDEN_NXS; i++) {
        for (j = 0; j < i; j++) {
            P[j][i] = P[i][j];
        }
    }
}

/* P_k = Q_xx + A'P_{k+1}A - V'D^{-1}V: one product of (A, -D^{-1}V) with (P_{k+1}A, V). */
static int riccati_stage(golden_solver_t *s, int k)
{
    golden_riccati_t *r = &s->riccati;
    riccati_load_stage(s, k);
    riccati_add_weights(s, k);
    riccati_propagate(s, k);
    riccati_update_controls(r, k, r->W[0], r->T[0], GOLDEN_NXS);
    if (!riccati_eliminate_controls(r, k)) {
        r->failed = k;
        return 0;
    }
    riccati_gain(r, k);
    riccati_update_states(r, k, r->W[0], r->T[0], GOLDEN_NZS);
    riccati_mirror(r->P[k]);
    return 1;
}

/* Copies of components of x_0 are no variables of their own: P_0 gets their rows and columns where the originals have theirs. */
static inline void riccati_fold(golden_riccati_t *r)
{
    int c, j;
    for (c = 0; c < GOLDEN_NXS - GOLDEN_NX; c++) {
        const int from = GOLDEN_NX + c, to = copied_state[c];
        riccati_add(r->P[0][to], 1.0, r->P[0][from], GOLDEN_LDX);
        for (j = 0; j < GOLDEN_NXS; j++) {
            r->P[0][j][to] += r->P[0][j][from];
            r->P[0][j][from] = 0.0;
        }
        memset(r->P[0][from], 0, sizeof r->P[0][from]);
    }
}

/* L D L' of the block of P_0 that belongs to the free components of x_0; pivots as above. */
static int riccati_factorize_free(golden_riccati_t *r)
{
    int i, j, l;
    for (l = 0; l < GOLDEN_NF; l++) {
        const golden_real reference = r->P[0][free_state[l]][free_state[l]];
        golden_real d = reference;
        for (j = 0; j < l; j++) {
            d -= r->F[l][j] * r->F[l][j] * r->F[j][j];
        }
        d = riccati_pivot(r, d, reference, &r->proximal_free[l]);
        if (!(d > 0.0)) {
            r->failed = -1;
            return 0;
        }
        r->F[l][l] = d;
        for (i = l + 1; i < GOLDEN_NF; i++) {
            golden_real y = r->P[0][free_state[i]][free_state[l]];
            for (j = 0; j < l; j++) {
                y -= r->F[i][j] * r->F[l][j] * r->F[j][j];
            }
            r->F[i][l] = y / d;
        }
    }
    return 1;
}

/* The recursion from stage last down to 0; last = NS: P_NS too. */
static int riccati_factorize(golden_solver_t *s, int last)
{
    int k = last;
    if (k == GOLDEN_NS) {
        riccati_load_terminal(s);
        riccati_add_weights(s, k);
        riccati_mirror(s->riccati.P[k]);
        k--;
    }
    for (; k >= 0; k--) {
        if (!riccati_stage(s, k)) {
            return 0;
        }
    }
    riccati_fold(&s->riccati);
    return riccati_factorize_free(&s->riccati);
}

/* Solves L D L'y = y for the free controls; entries of fixed ones are 0 and stay so. */
static inline void riccati_solve_controls(const golden_riccati_t *r, int k, golden_real *y)
{
    int i, j;
    for (j = 1; j < GOLDEN_NUS; j++) {
        for (i = 0; i < j; i++) {
            y[j] -= r->L[k][j][i] * y[i];
        }
    }
    for (j = GOLDEN_NUS - 1; j >= 0; j--) {
        y[j] *= r->inverse[k][j];
        for (i = j + 1; i < GOLDEN_NUS; i++) {
            y[j] -= r->L[k][i][j] * y[i];
        }
    }
}

/* w = g_k + S_k'(p_{k+1} + P_{k+1} b_k): gradient at z = 0, controls free. With f the fixed controls:
 *     feed = -M_uu^{-1} (w_u + M_uf du_f),   p_k = w_x + M_xf du_f + K'(w_u + M_uf du_f) */
static void riccati_backward_stage(golden_solver_t *s, int k)
{
    golden_riccati_t *r = &s->riccati;
    golden_real v[GOLDEN_LDX], w[GOLDEN_NZS], y[GOLDEN_NUS];
    int i, j, gaps = 0;
    memcpy(v, r->p[k + 1], sizeof v);
    for (i = 0; i < GOLDEN_NXS; i++) {
        gaps |= r->b[k][i] < 0.0 || !(r->b[k][i] <= 0.0);
    }
    if (gaps) {
        riccati_combine(v, r->b[k], r->P[k + 1][0], GOLDEN_LDX, GOLDEN_NXS, GOLDEN_LDX);
    }
    memcpy(w, r->g[k], sizeof w);
    riccati_combine(w, v, stage_S(s, k)[0], GOLDEN_NZS, GOLDEN_NXS, GOLDEN_NZS);
    memcpy(r->h[k], w + GOLDEN_NXS, sizeof r->h[k]);
    for (j = 0; j < GOLDEN_NUS; j++) {
        if (r->fixed[k * GOLDEN_NUS + j]) {
            const golden_real du = r->du[k * GOLDEN_NUS + j];
            riccati_combine(w, &du, r->M[k][j], GOLDEN_LDZ, 1, GOLDEN_NXS);
            for (i = 0; i < GOLDEN_NUS; i++) {
                w[GOLDEN_NXS + i] += du * ((i < j) ? r->M[k][j][GOLDEN_NXS + i] : r->M[k][i][GOLDEN_NXS + j]);
            }
        }
    }
    for (j = 0; j < GOLDEN_NUS; j++) {
        y[j] = r->fixed[k * GOLDEN_NUS + j] ? 0.0 : w[GOLDEN_NXS + j];
    }
    memcpy(r->p[k], w, sizeof w[0] * GOLDEN_NXS);
    riccati_combine(r->p[k], y, r->K[k][0], GOLDEN_LDX, GOLDEN_NUS, GOLDEN_LDX);
    riccati_solve_controls(r, k, y);
    for (j = 0; j < GOLDEN_NUS; j++) {
        r->feed[k][j] = r->fixed[k * GOLDEN_NUS + j] ? r->du[k * GOLDEN_NUS + j] : -y[j];
    }
}

/* p, feed and h of the stages last .. 0; last = NS: p_NS too. */
static void riccati_backward(golden_solver_t *s, int last)
{
    int k = last;
    if (k == GOLDEN_NS) {
        memcpy(s->riccati.p[k], s->riccati.g[k], sizeof s->riccati.g[0][0] * GOLDEN_NXS);
        k--;
    }
    for (; k >= 0; k--) {
        riccati_backward_stage(s, k);
    }
    for (k = 0; k < GOLDEN_NXS - GOLDEN_NX; k++) {
        s->riccati.p[0][copied_state[k]] += s->riccati.p[0][GOLDEN_NX + k];
        s->riccati.p[0][GOLDEN_NX + k] = 0.0;
    }
}

/* Free components of x_0 and their copies: P_ff x_f = -(p_f + P_fm x_m), m the others. */
static void riccati_solve_free(const golden_riccati_t *r, golden_real *x)
{
    golden_real y[GOLDEN_NXS];
    int f, i;
    for (f = 0; f < GOLDEN_NF; f++) {
        x[free_state[f]] = 0.0;
    }
    for (i = GOLDEN_NX; i < GOLDEN_NXS; i++) {
        x[i] = 0.0;
    }
    for (f = 0; f < GOLDEN_NF; f++) {
        y[f] = -r->p[0][free_state[f]] - riccati_dot(r->P[0][free_state[f]], x, GOLDEN_NXS);
        for (i = 0; i < f; i++) {
            y[f] -= r->F[f][i] * y[i];
        }
    }
    for (f = GOLDEN_NF - 1; f >= 0; f--) {
        y[f] /= r->F[f][f];
        for (i = f + 1; i < GOLDEN_NF; i++) {
            y[f] -= r->F[i][f] * y[i];
        }
    }
    for (f = 0; f < GOLDEN_NF; f++) {
        x[free_state[f]] = y[f];
    }
    for (i = 0; i < GOLDEN_NXS - GOLDEN_NX; i++) {
        x[GOLDEN_NX + i] = x[copied_state[i]];
    }
}

/* u_k = feed_k + K_k x_k,  x_{k+1} = S_k (x_k, u_k) + b_k. */
static void riccati_forward(golden_solver_t *s, golden_real (*x)[GOLDEN_NXS], golden_real *u)
{
    const golden_riccati_t *r = &s->riccati;
    golden_real z[GOLDEN_LDZ] = {0};
    int i, j, k;
    riccati_solve_free(r, x[0]);
    memcpy(z, x[0], sizeof x[0]);
    for (k = 0; k < GOLDEN_NS; k++) {
        golden_real (*S)[GOLDEN_NZS] = stage_S(s, k);
        for (j = 0; j < GOLDEN_NUS; j++) {
            z[GOLDEN_NXS + j] = r->feed[k][j] + riccati_dot(r->K[k][j], z, GOLDEN_LDX);
            u[k * GOLDEN_NUS + j] = z[GOLDEN_NXS + j];
        }
        for (i = 0; i < GOLDEN_NXS; i++) {
            x[k + 1][i] = r->b[k][i] + riccati_dot(S[i], z, GOLDEN_NZS);
        }
        memcpy(z, x[k + 1], sizeof x[0]);
    }
}

static void riccati_init(golden_solver_t *s)
{
    memset(&s->riccati, 0, sizeof s->riccati);
}

/* riccati_convexify   before qp_factorize: the Hessian is convex, or stays as it is. Returns 1 if the factors at hand are those
 *                     without given controls and without rows. */
static inline int riccati_convexify(golden_solver_t *s)
{
    (void)s;
    return 0;
}

/* riccati_adjoint           lam = P_k x + p_k, the multiplier of x_k
 * riccati_control_gradient  derivative of the cost to go with respect to u_j at stage k, 0 at the minimiser if u_j is free: minus
 *                           the multiplier of a fixed control */

/* lam = P_k x + p_k. */
static void riccati_adjoint(const golden_riccati_t *r, int k, const golden_real *x, golden_real *lam)
{
    memcpy(lam, r->p[k], sizeof lam[0] * GOLDEN_NXS);
    riccati_combine(lam, x, r->P[k][0], GOLDEN_LDX, GOLDEN_NXS, GOLDEN_NXS);
}

/* h_j + M_j z at stage k, M_j the row of control j. */
static golden_real riccati_control_gradient(const golden_riccati_t *r, int k, int j, const golden_real *x, const golden_real *u)
{
    golden_real sum = r->h[k][j] + riccati_dot(r->M[k][j], x, GOLDEN_NXS);
    int i;
    for (i = 0; i < GOLDEN_NUS; i++) {
        sum += u[i] * ((i < j) ? r->M[k][j][GOLDEN_NXS + i] : r->M[k][i][GOLDEN_NXS + j]);
    }
    return sum;
}

/* Contract of this part: the working set side[], what it does to the recursion, and what its minimiser says about it.
 *
 * A member (+-1) is an equation at its bound: a control is given, a row has the augmented Lagrangian
 *     center (a'z - t) + weight/2 (a'z - t)^2,   mult = center + weight (a'z - t)
 * A soft row that is violated (+-2) has the cost +-l1 (a'z - t) + l2/2 (a'z - t)^2. */

static inline golden_real qp_target(const golden_qp_t *q, int c)
{
    return q->side[c] > 0 ? q->upper[c] : q->lower[c];
}

/* a'z of row m. */
static inline golden_real qp_row_value(const golden_solver_t *s, int m, golden_real (*x)[GOLDEN_NXS], const golden_real *u)
{
    const int k = stage_of_row[m];
    const golden_real *a;
    golden_real sum;
    int j;
    if (stage_state[m] >= 0) {
        return x[k][stage_state[m]];
    }
    a = stage_row(s, m);
    sum = riccati_dot(a, x[k], GOLDEN_NXS);
    for (j = 0; k < GOLDEN_NS && j < GOLDEN_NUS; j++) {
        sum += a[GOLDEN_NXS + j] * u[k * GOLDEN_NUS + j];
    }
    return sum;
}

/* y += f a of row m; y has the entries of z at its stage. */
static inline void qp_add_row(golden_solver_t *s, int m, golden_real f, golden_real *y)
{
    if (stage_state[m] >= 0) {
        y[stage_state[m]] += f;
    } else {
        riccati_combine(y, &f, stage_row(s, m), GOLDEN_NZS, 1, stage_of_row[m] < GOLDEN_NS ? GOLDEN_NZS : GOLDEN_NXS);
    }
}

/* |a|'|z| of row m with the largest entry of every component. */
static golden_real qp_row_size(const golden_solver_t *s, int m)
{
    const golden_real *scale = s->qp.scale;
    const int n = stage_of_row[m] < GOLDEN_NS ? GOLDEN_NZS : GOLDEN_NXS;
    const golden_real *a;
    golden_real sum = 0.0;
    int i;
    if (stage_state[m] >= 0) {
        return scale[stage_state[m]];
    }
    a = stage_row(s, m);
    for (i = 0; i < n; i++) {
        sum += fabs(a[i]) * scale[i];
    }
    return sum;
}

/* The factors of the stages up to k do not fit the working set any more. */
static inline void qp_outdate(golden_qp_t *q, int k)
{
    q->stale = k > q->stale ? k : q->stale;
    q->stale_vectors = k > q->stale_vectors ? k : q->stale_vectors;
}

/* What row m adds to the Hessian along a a'. */
static inline golden_real qp_weight(const golden_qp_t *q, int m, int side)
{
    if (side == 0) {
        return 0.0;
    }
    return (side == 1 || side == -1) ? q->weight[m] : q->curvature[m];
}

static void qp_set_control(golden_solver_t *s, int c, int side)
{
    golden_qp_t *q = &s->qp;
    if (side != q->side[c]) {
        q->side[c] = side;
        q->changes++;
        s->riccati.fixed[c] = side != 0;
        qp_outdate(q, c / GOLDEN_NUS);
    }
}

/* What enters has no multiplier yet. */
static void qp_set_row(golden_solver_t *s, int m, int side)
{
    golden_qp_t *q = &s->qp;
    const int c = GOLDEN_NV + m;
    if (side != q->side[c]) {
        q->side[c] = side;
        q->changes++;
        q->mult[c] = 0.0;
        s->riccati.weight[m] = qp_weight(q, m, side);
        qp_outdate(q, stage_of_row[m]);
    }
}

/* A side that the bounds of c allow: equations stay members, infinite bounds and hard rows have no violated side. */
static inline int qp_allowed(const golden_qp_t *q, int c, int side, golden_real penalty)
{
    int allowed = side;
    if ((side > 0 && !(q->upper[c] < (golden_real)INFINITY)) || (side < 0 && !(q->lower[c] > -(golden_real)INFINITY))) {
        allowed = 0;
    }
    if (allowed == 0 && q->lower[c] >= q->upper[c]) {
        allowed = q->upper[c] < (golden_real)INFINITY ? 1 : -1;
    }
    return penalty < (golden_real)INFINITY ? allowed : allowed > 0 ? 1 : allowed < 0 ? -1 : 0;
}

static inline void qp_outdate_target(golden_qp_t *q, int c, int k)
{
    if (q->side[c] != 0 && q->target[c] != qp_target(q, c)) {
        q->stale_vectors = k > q->stale_vectors ? k : q->stale_vectors;
    }
}

/* Bounds as they are now: sides that they do not allow, targets that moved. */
static void qp_take_bounds(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    int c, m;
    for (c = 0; c < GOLDEN_NV; c++) {
        qp_set_control(s, c, qp_allowed(q, c, q->side[c], (golden_real)INFINITY));
        qp_outdate_target(q, c, c / GOLDEN_NUS);
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        c = GOLDEN_NV + m;
        qp_set_row(s, m, qp_allowed(q, c, q->side[c], q->penalty[m]));
        qp_outdate_target(q, c, stage_of_row[m]);
    }
}

/* Right-hand sides of the stages whose vectors are stale. */
static void qp_load(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_riccati_t *r = &s->riccati;
    int k, m, c;
    for (k = 0; k <= q->stale_vectors; k++) {
        memcpy(r->g[k], stage_g(s, k), sizeof r->g[0][0] * (k < GOLDEN_NS ? GOLDEN_NZS : GOLDEN_NXS));
        if (k < GOLDEN_NS) {
            memcpy(r->b[k], stage_b(s, k), sizeof r->b[0]);
        }
        for (c = k * GOLDEN_NUS; k < GOLDEN_NS && c < (k + 1) * GOLDEN_NUS; c++) {
            r->du[c] = q->side[c] != 0 ? qp_target(q, c) : 0.0;
            q->target[c] = r->du[c];
        }
        for (m = stage_first[k]; m < stage_first[k + 1]; m++) {
            const int side = q->side[GOLDEN_NV + m];
            if (side != 0) {
                const golden_real l1 = side > 0 ? q->penalty[m] : -q->penalty[m];
                q->target[GOLDEN_NV + m] = qp_target(q, GOLDEN_NV + m);
                q->center[m] = (side == 1 || side == -1) ? q->mult[GOLDEN_NV + m] : l1;
                qp_add_row(s, m, q->center[m] - r->weight[m] * q->target[GOLDEN_NV + m], r->g[k]);
            }
        }
    }
}

/* The largest entry of every component of x and z. 0 if a number is not finite. */
static int qp_measure(golden_qp_t *q)
{
    golden_real sum = 0.0;
    int i, k;
    for (i = 0; i < GOLDEN_NZS; i++) {
        q->scale[i] = 0.0;
    }
    for (k = 0; k <= GOLDEN_NS; k++) {
        for (i = 0; i < GOLDEN_NXS; i++) {
            const golden_real size = fabs(q->x[k][i]);
            q->scale[i] = size > q->scale[i] ? size : q->scale[i];
            sum += size;
        }
    }
    for (k = 0; k < GOLDEN_NS; k++) {
        for (i = 0; i < GOLDEN_NUS; i++) {
            const golden_real size = fabs(q->z[k * GOLDEN_NUS + i]);
            q->scale[GOLDEN_NXS + i] = size > q->scale[GOLDEN_NXS + i] ? size : q->scale[GOLDEN_NXS + i];
            sum += size;
        }
    }
    return isfinite(sum);
}

/* Multipliers at the minimiser on the working set. 0 if one, or the value of a row, is not finite. */
static int qp_take_multipliers(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_riccati_t *r = &s->riccati;
    golden_real sum = 0.0;
    int k, c, m;
    for (c = 0; c < GOLDEN_NV; c++) {
        k = c / GOLDEN_NUS;
        q->mult[c] = 0.0;
        if (q->side[c] != 0) {
            q->z[c] = q->target[c];
            q->mult[c] = -riccati_control_gradient(r, k, c % GOLDEN_NUS, q->x[k], &q->z[k * GOLDEN_NUS]);
            sum += fabs(q->mult[c]);
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        c = GOLDEN_NV + m;
        q->value[m] = qp_row_value(s, m, q->x, q->z);
        q->mult[c] = q->side[c] != 0 ? q->center[m] + r->weight[m] * (q->value[m] - q->target[c]) : 0.0;
        sum += fabs(q->value[m]);
    }
    return isfinite(sum);
}

/* Contract of this part: the minimiser on the working set to rounding. Corrections solve for the residuals of the original
 * optimality conditions with the factors at hand, so what these hold beyond the original data (weights of members, shares on
 * pivots) costs steps, not accuracy. Members: the method of multipliers; pivots: the proximal point method. */

/* y += H z,  H symmetric, its lower triangle in rows of length ld. */
static inline void qp_add_symmetric(golden_real *y, const golden_real *H, int ld, const golden_real *z, int n)
{
    int i, j;
    for (i = 0; i < n; i++) {
        const golden_real *row = H + i * ld;
        golden_real sum = row[i] * z[i];
        for (j = 0; j < i; j++) {
            sum += row[j] * z[j];
            y[j] += row[j] * z[i];
        }
        y[i] += sum;
    }
}

/* 1 if the factors are not those of the original problem on the working set. */
static int qp_is_approximate(const golden_solver_t *s)
{
    int k, c;
    for (c = 0; c < GOLDEN_NG; c++) {
        if (s->qp.side[GOLDEN_NV + c] == 1 || s->qp.side[GOLDEN_NV + c] == -1) {
            return 1;
        }
    }
    for (k = 0; k < GOLDEN_NS; k++) {
        for (c = 0; c < GOLDEN_NUS; c++) {
            if (s->riccati.proximal[k][c] > 0.0) {
                return 1;
            }
        }
    }
    for (c = 0; c < GOLDEN_NF; c++) {
        if (s->riccati.proximal_free[c] > 0.0) {
            return 1;
        }
    }
    return 0;
}

/* Gradient of the Lagrangian at stage k and gap of the dynamics into the right-hand sides. */
static void qp_residual(golden_solver_t *s, int k)
{
    golden_qp_t *q = &s->qp;
    golden_riccati_t *r = &s->riccati;
    golden_real z[GOLDEN_NZS], *y = r->g[k];
    int i, m;
    memcpy(z, q->x[k], sizeof q->x[0]);
    memcpy(y, stage_g(s, k), sizeof z[0] * (k < GOLDEN_NS ? GOLDEN_NZS : GOLDEN_NXS));
    if (k < GOLDEN_NS) {
        golden_real (*S)[GOLDEN_NZS] = stage_S(s, k);
        memcpy(z + GOLDEN_NXS, &q->z[k * GOLDEN_NUS], sizeof z[0] * GOLDEN_NUS);
        qp_add_symmetric(y, stage_Q(s, k)[0], GOLDEN_NZS, z, GOLDEN_NZS);
        riccati_combine(y, q->lam[k + 1], S[0], GOLDEN_NZS, GOLDEN_NXS, GOLDEN_NZS);
        for (i = 0; i < GOLDEN_NXS; i++) {
            r->b[k][i] = stage_b(s, k)[i] - q->x[k + 1][i] + riccati_dot(S[i], z, GOLDEN_NZS);
        }
        for (i = 0; i < GOLDEN_NUS; i++) {
            y[GOLDEN_NXS + i] += q->mult[k * GOLDEN_NUS + i];
            r->du[k * GOLDEN_NUS + i] = 0.0;
        }
    } else {
        qp_add_symmetric(y, stage_Q_N(s)[0], GOLDEN_NXS, z, GOLDEN_NXS);
    }
    for (i = 0; k > 0 && i < GOLDEN_NXS; i++) {
        y[i] -= q->lam[k][i];
    }
    for (m = stage_first[k]; m < stage_first[k + 1]; m++) {
        if (q->side[GOLDEN_NV + m] != 0) {
            qp_add_row(s, m, q->mult[GOLDEN_NV + m], y);
        }
    }
}

/* The largest entry of the gradient relative to multipliers of the dynamics, or what they exert on the controls. */
static golden_real qp_gradient_size(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_real *size = q->size, worst = 0.0;
    int k, i, j;
    memset(size, 0, sizeof q->size);
    for (k = 0; k < GOLDEN_NS; k++) {
        const golden_real *g = stage_g(s, k);
        golden_real terms[GOLDEN_NUS];
        for (j = 0; j < GOLDEN_NUS; j++) {
            terms[j] = fabs(q->mult[k * GOLDEN_NUS + j]) + fabs(g[GOLDEN_NXS + j]);
        }
        for (i = 0; i < GOLDEN_NXS; i++) {
            const golden_real lam = fabs(q->lam[k + 1][i]);
            const golden_real term = lam + fabs(g[i]);
            size[i] = term > size[i] ? term : size[i];
            for (j = 0; j < GOLDEN_NUS; j++) {
                terms[j] += lam * fabs(stage_S(s, k)[i][GOLDEN_NXS + j]);
            }
        }
        for (j = 0; j < GOLDEN_NUS; j++) {
            size[GOLDEN_NXS + j] = terms[j] > size[GOLDEN_NXS + j] ? terms[j] : size[GOLDEN_NXS + j];
        }
    }
    for (k = 0; k <= GOLDEN_NS; k++) {
        for (i = 0; i < (k < GOLDEN_NS ? GOLDEN_NZS : GOLDEN_NXS); i++) {
            const golden_real y = (k == 0 && i < GOLDEN_NXS) ? 0.0 : fabs(s->riccati.g[k][i]);
            worst = y > worst * size[i] ? y / size[i] : worst;
        }
    }
    return worst;
}

/* By how much to stretch the correction (dx, dz), d = distances of the members: to the least (d + times change)'W(d + times change).
 * Where members nearly depend on each other the method of multipliers takes short steps in one direction. */
static golden_real qp_stretch(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_real gain = 0.0, size = 0.0;
    int m;
    for (m = 0; m < GOLDEN_NG; m++) {
        const int c = GOLDEN_NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            const golden_real change = qp_row_value(s, m, q->dx, q->dz);
            gain -= s->riccati.weight[m] * change * (q->value[m] - q->target[c]);
            size += s->riccati.weight[m] * change * change;
        }
    }
    if (!(gain > size)) {
        return 1.0;
    }
    return gain < 65536.0 * size ? gain / size : 65536.0;
}

/* Adds `times` the correction (dx, dz) and what it does to the multipliers: those of members from its value, small as it is, for
 * the rounding of a'z - t would be multiplied by the weight. */
static void qp_add_correction(golden_solver_t *s, golden_real times)
{
    golden_qp_t *q = &s->qp;
    golden_riccati_t *r = &s->riccati;
    golden_real lam[GOLDEN_NXS];
    int k, i, c, m;
    for (k = 0; k <= GOLDEN_NS; k++) {
        riccati_adjoint(r, k, q->dx[k], lam);
        for (i = 0; i < GOLDEN_NXS; i++) {
            q->lam[k][i] += times * lam[i];
            q->x[k][i] += times * q->dx[k][i];
        }
    }
    for (c = 0; c < GOLDEN_NV; c++) {
        k = c / GOLDEN_NUS;
        if (q->side[c] != 0) {
            q->mult[c] -= times * riccati_control_gradient(r, k, c % GOLDEN_NUS, q->dx[k], &q->dz[k * GOLDEN_NUS]);
        }
    }
    for (c = 0; c < GOLDEN_NV; c++) {
        q->z[c] += times * q->dz[c];
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        const golden_real change = qp_row_value(s, m, q->dx, q->dz);
        c = GOLDEN_NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            q->mult[c] += times * r->weight[m] * (change + (q->value[m] - q->target[c]));
        } else if (q->side[c] != 0) {
            q->mult[c] += times * r->weight[m] * change;
        }
        q->value[m] = qp_row_value(s, m, q->x, q->z);
    }
}

/* The largest distance of a member from its bound, relative. */
static golden_real qp_distance(const golden_solver_t *s)
{
    const golden_qp_t *q = &s->qp;
    golden_real largest = 0.0;
    int m;
    for (m = 0; m < GOLDEN_NG; m++) {
        const int c = GOLDEN_NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            const golden_real distance = fabs(q->value[m] - q->target[c]);
            const golden_real size = qp_row_size(s, m) + fabs(q->target[c]);
            largest = distance > largest * size ? distance / size : largest;
        }
    }
    return largest;
}

/* The correction of (x, z, lam, mult) for the residuals in the right-hand sides; weight (a'z - t) a of members joins them. */
static void qp_correct(golden_solver_t *s, int stretched)
{
    golden_qp_t *q = &s->qp;
    int m;
    for (m = 0; m < GOLDEN_NG; m++) {
        const int c = GOLDEN_NV + m;
        if (q->side[c] == 1 || q->side[c] == -1) {
            qp_add_row(s, m, s->riccati.weight[m] * (q->value[m] - q->target[c]), s->riccati.g[stage_of_row[m]]);
        }
    }
    riccati_backward(s, GOLDEN_NS);
    memset(q->dx[0], 0, sizeof q->dx[0]);
    riccati_forward(s, q->dx, q->dz);
    qp_add_correction(s, stretched ? qp_stretch(s) : 1.0);
    q->refinements++;
}

/* Corrections until the residuals are rounding; slow ones near to it are stretched, every other one. OK; STALLED: they fall no
 * more, the members may contradict each other; NUMERICAL_FAILURE. */
static golden_status_t qp_refine(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_real slow = (golden_real)INFINITY;
    int i, k, stretched = 0;
    for (k = 0; k <= GOLDEN_NS; k++) {
        riccati_adjoint(&s->riccati, k, q->x[k], q->lam[k]);
    }
    q->stale_vectors = GOLDEN_NS;
    q->refined = 1;
    q->residual = (golden_real)INFINITY;
    for (i = 0; i <= GOLDEN_QP_MAX_REFINEMENTS; i++) {
        const golden_real before = q->residual;
        golden_real distance;
        for (k = 0; k <= GOLDEN_NS; k++) {
            qp_residual(s, k);
        }
        q->residual = qp_gradient_size(s);
        distance = qp_distance(s);
        q->residual = distance > q->residual ? distance : q->residual;
        if (!isfinite(q->residual) || !qp_measure(q)) {
            return GOLDEN_NUMERICAL_FAILURE;
        }
        if (q->residual <= 8.881784197001252e-16) {
            return GOLDEN_OK;
        }
        stretched = !stretched && q->residual > 0.5 * before;
        if (stretched) {
            if (distance < q->residual || q->residual > 2.3283064365386963e-10 || q->residual > 0.5 * slow) {
                return GOLDEN_STALLED;
            }
            slow = q->residual;
        }
        qp_correct(s, stretched);
    }
    return GOLDEN_STALLED;
}

/* Contract of this part: from a working set to the next, all changes at once (primal-dual active set). */

/* What is taken as rounding: as long as the minimiser is not refined, errors of the root of the precision too. */
static inline golden_real qp_tolerance(const golden_qp_t *q, golden_real exact)
{
    const golden_real rough = 16.0 * sqrt(2.220446049250313e-16);
    return q->rough ? rough : exact;
}

/* The side that bounds say: v is the value of what is no member. */
static inline int qp_side_of_value(const golden_qp_t *q, int c, golden_real v, golden_real size)
{
    const golden_real tolerance = qp_tolerance(q, 1.4210854715202004e-14);
    if (v - q->upper[c] > tolerance * (size + fabs(q->upper[c]))) {
        return 1;
    }
    return (q->lower[c] - v > tolerance * (size + fabs(q->lower[c]))) ? -1 : 0;
}

/* The side of control c. A member leaves if its multiplier has the wrong sign by more than rounding. */
static int qp_side_of_control(const golden_solver_t *s, int c)
{
    const golden_qp_t *q = &s->qp;
    const golden_riccati_t *r = &s->riccati;
    const int side = q->side[c], k = c / GOLDEN_NUS, j = c % GOLDEN_NUS;
    golden_real mult, size;
    if (side == 0) {
        return qp_side_of_value(q, c, q->z[c], q->scale[GOLDEN_NXS + j]);
    }
    if (q->lower[c] >= q->upper[c]) {
        return side;
    }
    mult = side > 0 ? q->mult[c] : -q->mult[c];
    size = q->size[GOLDEN_NXS + j];
    if (!q->refined) {
        size = r->M[k][j][GOLDEN_NXS + j] * q->scale[GOLDEN_NXS + j] + fabs(r->h[k][j]);
    }
    return mult >= -5.684341886080802e-14 * size ? side : 0;
}

/* The side of row m: members leave by the sign of their multiplier, soft ones become violated at the limit of it, and
 * violated ones come back when they are not. */
static int qp_side_of_row(const golden_solver_t *s, int m)
{
    const golden_qp_t *q = &s->qp;
    const int c = GOLDEN_NV + m, side = q->side[c], sign = side > 0 ? 1 : -1;
    const golden_real size = qp_row_size(s, m), mult = side > 0 ? q->mult[c] : -q->mult[c];
    const golden_real terms = q->root[m] * q->largest < q->largest_mult ? q->root[m] * q->largest : q->largest_mult;
    const golden_real stiff = q->refined ? 0.0 : q->root[m] * q->root[m] * size;
    const golden_real rounding = qp_tolerance(q, 5.684341886080802e-14) * (terms + stiff);
    if (side == 0) {
        return qp_side_of_value(q, c, q->value[m], size);
    }
    if (side != sign) {
        const golden_real violation = side > 0 ? q->value[m] - q->upper[c] : q->lower[c] - q->value[m];
        return violation >= -qp_tolerance(q, 1.4210854715202004e-14) * (size + fabs(q->target[c])) ? side : sign;
    }
    if (mult > q->penalty[m] + rounding) {
        return 2 * sign;
    }
    if (mult >= -rounding) {
        return side;
    }
    if (q->lower[c] < q->upper[c]) {
        return 0;
    }
    return -mult > q->penalty[m] + rounding ? -2 * sign : side;
}

/* Violation of row m, which is no member, relative to what its value sums and its bound. */
static golden_real qp_violation(const golden_solver_t *s, int m)
{
    const golden_qp_t *q = &s->qp;
    const int c = GOLDEN_NV + m;
    const golden_real over = q->value[m] - q->upper[c], under = q->lower[c] - q->value[m];
    const golden_real bound = fabs(over > under ? q->upper[c] : q->lower[c]);
    return (over > under ? over : under) / (qp_row_size(s, m) + bound);
}

/* Every side anew; returns the number of changes. Of the rows only the most violated ones enter: when one of them is met its
 * neighbours in time are too, as a rule, and more members than controls contradict each other. */
static int qp_revise(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    const int before = q->changes;
    golden_real worst = 0.0;
    int c, m;
    q->largest = q->largest_mult = 0.0;
    for (m = 0; m < GOLDEN_NG; m++) {
        const golden_real force = fabs(q->mult[GOLDEN_NV + m]);
        q->largest_mult = force > q->largest_mult ? force : q->largest_mult;
        q->largest = force > q->largest * q->root[m] ? force / q->root[m] : q->largest;
        if (q->side[GOLDEN_NV + m] == 0) {
            const golden_real violation = qp_violation(s, m);
            worst = violation > worst ? violation : worst;
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        c = GOLDEN_NV + m;
        if (q->side[c] != 0 || qp_violation(s, m) >= 0.5 * worst) {
            qp_set_row(s, m, qp_allowed(q, c, qp_side_of_row(s, m), q->penalty[m]));
        }
    }
    for (c = 0; c < GOLDEN_NV; c++) {
        qp_set_control(s, c, qp_side_of_control(s, c));
    }
    return q->changes - before;
}

/* 1 if the working set is among the first `tried` of this solve; remembers it. */
static int qp_seen(golden_qp_t *q, int tried)
{
    uint32_t hash = 2166136261u;
    int c, i;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        hash = (hash ^ (uint32_t)(q->side[c] + 2)) * 16777619u;
    }
    q->history[tried] = (int32_t)(hash >> 1);
    for (i = 0; i < tried; i++) {
        if (q->history[i] == q->history[tried]) {
            return 1;
        }
    }
    return 0;
}

/* Recursion and vectors, as far as they are out of date. */
static int qp_renew(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    if (q->stale >= 0 && !riccati_factorize(s, q->stale)) {
        return 0;
    }
    if (q->stale_vectors >= 0) {
        qp_load(s);
        riccati_backward(s, q->stale_vectors);
    }
    q->stale = q->stale_vectors = -1;
    return 1;
}

/* Members that are still off their bounds get a larger weight; 0 if none can. */
static int qp_raise_weights(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    int m, raised = 0;
    for (m = 0; m < GOLDEN_NG; m++) {
        const int c = GOLDEN_NV + m;
        const golden_real size = qp_row_size(s, m) + fabs(q->target[c]);
        if ((q->side[c] == 1 || q->side[c] == -1) && q->raised[m] < 2 &&
            fabs(q->value[m] - q->target[c]) > 1.4210854715202004e-14 * size) {
            q->raised[m]++;
            q->weight[m] *= 1024.0;
            s->riccati.weight[m] = q->weight[m];
            qp_outdate(q, stage_of_row[m]);
            raised = 1;
        }
    }
    return raised;
}

/* The minimiser on the working set, refined if nothing but rounding is to be gained otherwise. changed: sides that it changes. */
static golden_status_t qp_minimize(golden_solver_t *s, int *changed)
{
    golden_qp_t *q = &s->qp;
    golden_status_t status = GOLDEN_OK;
    *changed = 0;
    if (!qp_renew(s)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    memcpy(q->x[0], s->step.dx[0], sizeof s->step.dx[0]);
    riccati_forward(s, q->x, q->z);
    if (!qp_measure(q) || !qp_take_multipliers(s)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    q->refined = 0;
    q->rough = qp_is_approximate(s);
    *changed = qp_revise(s);
    if (*changed == 0 && q->rough) {
        status = qp_refine(s);
        q->rough = 0;
        if (status == GOLDEN_OK || status == GOLDEN_STALLED) {
            *changed = qp_revise(s);
        }
    }
    return status;
}

/* Working sets until one repeats itself. OK; STALLED: a set came back, or the members of one contradict each other;
 * ITERATION_LIMIT; NUMERICAL_FAILURE. */
static golden_status_t qp_iterate(golden_solver_t *s, int most)
{
    int changed, tried;
    (void)qp_seen(&s->qp, 0);
    for (tried = 1; tried <= most; tried++) {
        const golden_status_t status = qp_minimize(s, &changed);
        if (status == GOLDEN_NUMERICAL_FAILURE || (status == GOLDEN_OK && changed == 0)) {
            return status;
        }
        if (changed == 0 && !qp_raise_weights(s)) {
            return s->qp.residual <= 2.3283064365386963e-10 ? GOLDEN_OK : GOLDEN_STALLED;
        }
        if (changed > 0 && qp_seen(&s->qp, tried)) {
            return GOLDEN_STALLED;
        }
        s->qp.iterations++;
    }
    return GOLDEN_ITERATION_LIMIT;
}

/* Controls inside of their bounds exactly, multipliers of the right sign, soft rows that are violated. */
static void qp_finish(golden_qp_t *q)
{
    int c;
    for (c = 0; c < GOLDEN_NV; c++) {
        q->z[c] = q->z[c] < q->lower[c] ? q->lower[c] : q->z[c] > q->upper[c] ? q->upper[c] : q->z[c];
    }
    q->relaxed = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const int wrong = q->side[c] == 0 || (q->side[c] > 0 ? q->mult[c] < 0.0 : q->mult[c] > 0.0);
        if (wrong && q->lower[c] < q->upper[c]) {
            q->mult[c] = 0.0;
        }
        q->relaxed += q->side[c] > 1 || q->side[c] < -1;
    }
}

/* Primal-dual interior point method of Mehrotra (1992) on the stages of the QP, with the Riccati recursion as its linear algebra.
 *
 *     min  sum_k 1/2 z_k'Q_k z_k + g_k'z_k + sum_soft (l1_c e_c + l2_c/2 e_c^2)   s.t.   x_{k+1} = S_k z_k + b_k,
 *          bound_i - sign_i v_i + e_i = t_i >= 0  for every finite side i of a row,   v_c = B_c  for an equation
 *
 * A step solves for the directions of t, lam (and of e, kappa of a soft side) row by row, so that only the weights of the rows
 * enter the recursion; equations have the weight of a small compliance and are met by corrections of their multipliers.
 */

/* Contract of this part: rows of the QP (controls first, then general rows), their sides with finite bounds, directions. */

/* Value of every row at (x, u). */
static void ipm_values(golden_solver_t *s, golden_real (*x)[GOLDEN_NXS], const golden_real *u, golden_real *v)
{
    int m;
    memcpy(v, u, sizeof v[0] * GOLDEN_NV);
    for (m = 0; m < GOLDEN_NG; m++) {
        const int k = stage_of_row[m];
        if (stage_state[m] >= 0) {
            v[GOLDEN_NV + m] = x[k][stage_state[m]];
        } else {
            const golden_real *a = stage_row(s, m);
            v[GOLDEN_NV + m] = riccati_dot(a, x[k], GOLDEN_NXS);
            if (k < GOLDEN_NS) {
                v[GOLDEN_NV + m] += riccati_dot(a + GOLDEN_NXS, u + k * GOLDEN_NUS, GOLDEN_NUS);
            }
        }
    }
}

/* g += sum_c force_c a_c, stage by stage. */
static void ipm_add_forces(golden_solver_t *s, const golden_real *force, golden_real (*g)[GOLDEN_NZS])
{
    int k, j, m, i;
    for (k = 0; k < GOLDEN_NS; k++) {
        for (j = 0; j < GOLDEN_NUS; j++) {
            g[k][GOLDEN_NXS + j] += force[k * GOLDEN_NUS + j];
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        const golden_real f = force[GOLDEN_NV + m];
        golden_real *w = g[stage_of_row[m]];
        if (stage_state[m] >= 0) {
            w[stage_state[m]] += f;
        } else if (f != 0.0) {
            const golden_real *a = stage_row(s, m);
            const int width = (stage_of_row[m] < GOLDEN_NS) ? GOLDEN_NZS : GOLDEN_NXS;
            for (i = 0; i < width; i++) {
                w[i] += f * a[i];
            }
        }
    }
}

/* w += Q z, Q symmetric of n rows (lower triangle), in blocks of four rows. */
static void ipm_add_symmetric(const golden_real *Q, int ld, const golden_real *z, golden_real *w, int n)
{
    int i, r, c;
    for (i = 0; i < n; i += 4) {
        const int rows = (n - i < 4) ? n - i : 4;
        riccati_combine(w, z + i, Q + i * ld, ld, rows, i);
        for (r = i; r < i + rows; r++) {
            const golden_real *row = Q + r * ld;
            w[r] += riccati_dot(row, z, i) + row[r] * z[r];
            for (c = i; c < r; c++) {
                w[r] += row[c] * z[c];
                w[c] += row[c] * z[r];
            }
        }
    }
}

/* gradient_k = g_k + Q_k z_k at the iterate. */
static void ipm_cost_gradient(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real z[GOLDEN_NZS];
    int k;
    for (k = 0; k < GOLDEN_NS; k++) {
        memcpy(z, s->qp.x[k], sizeof s->qp.x[k]);
        memcpy(z + GOLDEN_NXS, s->qp.z + k * GOLDEN_NUS, sizeof z[0] * GOLDEN_NUS);
        memcpy(q->gradient[k], stage_g(s, k), sizeof q->gradient[k]);
        ipm_add_symmetric(stage_Q(s, k)[0], GOLDEN_NZS, z, q->gradient[k], GOLDEN_NZS);
    }
    memcpy(q->gradient[k], stage_g(s, k), sizeof q->gradient[0][0] * GOLDEN_NXS);
    ipm_add_symmetric(stage_Q_N(s)[0], GOLDEN_NXS, s->qp.x[k], q->gradient[k], GOLDEN_NXS);
}

/* What row c is: 0 inequality or free, 1 equation, 2 fixed control. Soft rows are never equations. */
static inline int ipm_row_kind(const golden_solver_t *s, int c)
{
    if (c >= GOLDEN_NV && s->qp.penalty[c - GOLDEN_NV] < (golden_real)INFINITY) {
        return 0;
    }
    return (s->qp.lower[c] >= s->qp.upper[c]) ? ((c < GOLDEN_NV) ? 2 : 1) : 0;
}

/* Rows or controls of the given kind: 1 if there is one. */
static int ipm_any(const golden_ipm_t *q, int kind)
{
    int c, any = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        any |= q->kind[c] == kind;
    }
    return any;
}

/* 1 if the kind of a row is not what the factorisation was made for; the kinds are taken. */
static int ipm_take_kinds(golden_solver_t *s)
{
    int c, changed = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const int kind = ipm_row_kind(s, c);
        changed |= kind != s->ipm.kind[c];
        s->ipm.kind[c] = kind;
        if (c < GOLDEN_NV) {
            s->riccati.fixed[c] = kind == 2;
        }
    }
    return changed;
}

/* Bounds and penalties: NUMERICAL_FAILURE if one is invalid, INFEASIBLE if bounds cross, else OK. */
static golden_status_t ipm_check_bounds(const golden_solver_t *s)
{
    int valid = 1, ordered = 1, c, m;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        valid &= s->qp.lower[c] < (golden_real)INFINITY && s->qp.upper[c] > -(golden_real)INFINITY;
        ordered &= s->qp.lower[c] <= s->qp.upper[c];
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        valid &= s->qp.penalty[m] >= 0.0 && s->qp.curvature[m] >= 0.0 && isfinite(s->qp.curvature[m]);
    }
    return !valid ? GOLDEN_NUMERICAL_FAILURE : ordered ? GOLDEN_OK : GOLDEN_INFEASIBLE;
}

/* The side of row c enters the list if its bound is finite and its violation costs anything. */
static void ipm_add_side(golden_solver_t *s, int c, int upper)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real bound = upper ? s->qp.upper[c] : s->qp.lower[c];
    const int m = c - GOLDEN_NV, soft = m >= 0 && s->qp.penalty[m] < (golden_real)INFINITY;
    const int costless = soft && !(s->qp.penalty[m] + s->qp.curvature[m] > 0.0);
    if (isfinite(bound) && !costless) {
        q->row[q->sides] = c;
        q->sign[q->sides] = upper ? 1.0 : -1.0;
        q->bound[q->sides] = bound;
        q->sides++;
    }
}

/* Sides of all inequalities, hard ones first. A row that the controls do not move is left to ipm_constant_rows. */
static void ipm_list_sides(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int pass, c;
    q->sides = q->hard = 0;
    for (pass = 0; pass < 2; pass++) {
        for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
            const int soft = c >= GOLDEN_NV && s->qp.penalty[c - GOLDEN_NV] < (golden_real)INFINITY;
            if (soft == pass && q->kind[c] == 0 && q->reach[c] > 0.0) {
                ipm_add_side(s, c, 0);
                ipm_add_side(s, c, 1);
            }
        }
        q->hard = (pass == 0) ? q->sides : q->hard;
    }
}

/* Hands the weights of the rows to the recursion. */
static void ipm_set_weights(golden_solver_t *s)
{
    int k, j;
    for (k = 0; k < GOLDEN_NS; k++) {
        for (j = 0; j < GOLDEN_NUS; j++) {
            s->riccati.diagonal[k][GOLDEN_NXS + j] = s->ipm.weight[k * GOLDEN_NUS + j] + s->ipm.proximal[GOLDEN_NXS + j];
        }
    }
    for (j = 0; j < GOLDEN_NF; j++) {
        s->riccati.diagonal[0][free_state[j]] = s->ipm.proximal[free_state[j]];
    }
    memcpy(s->riccati.weight, s->ipm.weight + GOLDEN_NV, sizeof s->ipm.weight[0] * GOLDEN_NG);
}

/* Residuals of the sides, r = distance + e - t and r_e = l1 + l2 e - lam - kappa, and the mean of t lam and e kappa. */
static void ipm_side_residuals(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real sum = 0.0;
    int i, pairs = q->sides;
    for (i = 0; i < q->sides; i++) {
        q->r[i] = q->sign[i] * (q->bound[i] - q->v[q->row[i]]) - q->t[i];
        sum += q->t[i] * q->lam[i];
    }
    for (i = q->hard; i < q->sides; i++) {
        const int j = i - q->hard, m = q->row[i] - GOLDEN_NV;
        q->r[i] += q->e[j];
        q->r_e[j] = s->qp.penalty[m] + s->qp.curvature[m] * q->e[j] - q->lam[i] - q->kappa[j];
        sum += q->e[j] * q->kappa[j];
        pairs += q->kappa[j] > 0.0;
    }
    q->mu = (pairs > 0) ? sum / (golden_real)pairs : 0.0;
}

/* omega = 1 / (t / lam + regularization + 1 / (l2 + kappa / e)); weights of the rows. */
static void ipm_weigh(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real share = 9.313225746154785e-10 / q->stiffening;
    int i, c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        q->weight[c] = q->stiffness[c] * q->stiffening;
    }
    for (i = 0; i < q->sides; i++) {
        const golden_real reach = q->reach[q->row[i]];
        q->ratio[i] = q->t[i] / q->lam[i];
        q->omega[i] = q->ratio[i] + share * reach * reach;
    }
    for (i = q->hard; i < q->sides; i++) {
        const int j = i - q->hard;
        q->compliance[j] = 1.0 / (s->qp.curvature[q->row[i] - GOLDEN_NV] + q->kappa[j] / q->e[j]);
        q->omega[i] += q->compliance[j];
    }
    for (i = 0; i < q->sides; i++) {
        q->omega[i] = 1.0 / q->omega[i];
        q->weight[q->row[i]] += q->omega[i];
    }
    ipm_set_weights(s);
}

/* With c_1 = -t lam + lam extra_i, c_2 = -kappa e + e extra_e the linearised conditions of a side
 *     dt = r - sign dv + de + regularization dlam,   lam dt + t dlam = c_1,
 *     l2 de - dlam - dkappa = -r_e,   kappa de + e dkappa = c_2
 * give dlam = omega (sign dv + rho),  rho = extra_i - t - r - (extra_e - kappa - r_e) compliance.
 * force: what the multipliers become where dv = 0. */
static void ipm_forces(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int i, c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        q->force[c] = (q->kind[c] == 1) ? q->y[c] + q->weight[c] * (q->v[c] - s->qp.lower[c]) : 0.0;
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
static void ipm_direction(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int i;
    ipm_forces(s);
    memcpy(s->riccati.g, q->gradient, sizeof s->riccati.g);
    ipm_add_forces(s, q->force, s->riccati.g);
    riccati_backward(s, GOLDEN_NS);
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

/* Contract of this part: units of the rows and the first iterate, from the minimiser that knows equations only. */

/* Stage k under u = K x + G xi, unit covariance of xi: G' (columns of fixed controls 0, G G' = M_uu^{-1}) into `noise`,
 * (A + B K)' into `closed`, (B G)' into `push`. */
static void ipm_closed_loop(golden_solver_t *s, int k)
{
    const golden_riccati_t *r = &s->riccati;
    golden_ipm_t *q = &s->ipm;
    golden_real (*S)[GOLDEN_NZS] = stage_S(s, k);
    golden_real column[GOLDEN_LDX] = {0};
    int i, j, l;
    for (l = 0; l < GOLDEN_NUS; l++) {
        const int fixed = r->fixed[k * GOLDEN_NUS + l];
        for (j = GOLDEN_NUS - 1; j >= 0; j--) {
            q->noise[l][j] = (j == l && !fixed) ? sqrt(r->inverse[k][l]) : 0.0;
            for (i = j + 1; i <= l; i++) {
                q->noise[l][j] -= r->L[k][i][j] * q->noise[l][i];
            }
        }
    }
    for (l = 0; l < GOLDEN_NXS; l++) {
        for (i = 0; i < GOLDEN_NXS; i++) {
            q->closed[l][i] = S[i][l];
        }
    }
    memset(q->push, 0, sizeof q->push);
    for (j = 0; j < GOLDEN_NUS; j++) {
        for (i = 0; i < GOLDEN_NXS; i++) {
            column[i] = S[i][GOLDEN_NXS + j];
        }
        for (l = 0; l < GOLDEN_NXS; l++) {
            riccati_add(q->closed[l], r->K[k][j][l], column, GOLDEN_LDX);
        }
        for (l = 0; l < GOLDEN_NUS; l++) {
            riccati_add(q->push[l], q->noise[l][j], column, GOLDEN_LDX);
        }
    }
}

/* Covariance of x_{k+1}:  closed' C closed + push' push. */
static void ipm_propagate_covariance(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real *C = q->covariance[0], *U = q->product[0], *F = q->closed[0];
    int i, j;
    memset(q->product, 0, sizeof q->product);
    for (i = 0; i < GOLDEN_LDX; i += 4) {
        riccati_rows(U + i * GOLDEN_LDX, GOLDEN_LDX, C + i, GOLDEN_LDX, F, GOLDEN_LDX, GOLDEN_NXS, GOLDEN_LDX);
    }
    memset(q->covariance, 0, sizeof q->covariance);
    for (i = 0; i < GOLDEN_LDX; i += 4) {
        riccati_rows(C + i * GOLDEN_LDX, GOLDEN_LDX, F + i, GOLDEN_LDX, U, GOLDEN_LDX, GOLDEN_NXS, i + 4);
        riccati_rows(C + i * GOLDEN_LDX, GOLDEN_LDX, q->push[0] + i, GOLDEN_LDX, q->push[0], GOLDEN_LDX, GOLDEN_NUS, i + 4);
    }
    for (i = 0; i < GOLDEN_LDX; i++) {
        for (j = i + 1; j < GOLDEN_LDX; j++) {
            q->covariance[i][j] = q->covariance[j][i];
        }
    }
}

/* (a' Cov(x, u) a)^{1/2} at stage k:  c = a_x + K'a_u,  c' C c + |G'a_u|^2. */
static golden_real ipm_reach(golden_solver_t *s, int k, const golden_real *a_x, const golden_real *a_u)
{
    golden_ipm_t *q = &s->ipm;
    golden_real c[GOLDEN_LDX] = {0}, w[GOLDEN_LDX] = {0}, sum = 0.0;
    int l;
    memcpy(c, a_x, sizeof c[0] * GOLDEN_NXS);
    for (l = 0; k < GOLDEN_NS && l < GOLDEN_NUS; l++) {
        const golden_real part = riccati_dot(q->noise[l], a_u, GOLDEN_NUS);
        riccati_add(c, a_u[l], s->riccati.K[k][l], GOLDEN_LDX);
        sum += part * part;
    }
    riccati_combine(w, c, q->covariance[0], GOLDEN_LDX, GOLDEN_NXS, GOLDEN_LDX);
    sum += riccati_dot(w, c, GOLDEN_LDX);
    return (sum > 0.0) ? sqrt(sum) : 0.0;
}

/* Controls and rows of stage k. */
static void ipm_stage_reach(golden_solver_t *s, int k)
{
    golden_ipm_t *q = &s->ipm;
    golden_real zero[GOLDEN_NZS] = {0};
    int j, m;
    for (j = 0; k < GOLDEN_NS && j < GOLDEN_NUS; j++) {
        zero[GOLDEN_NXS + j] = 1.0;
        q->reach[k * GOLDEN_NUS + j] = ipm_reach(s, k, zero, zero + GOLDEN_NXS);
        zero[GOLDEN_NXS + j] = 0.0;
    }
    for (m = stage_first[k]; m < stage_first[k + 1]; m++) {
        const int i = stage_state[m];
        if (i >= 0) {
            const golden_real variance = q->covariance[i][i];
            q->reach[GOLDEN_NV + m] = (variance > 0.0) ? sqrt(variance) : 0.0;
        } else {
            const golden_real *a = stage_row(s, m);
            q->reach[GOLDEN_NV + m] = ipm_reach(s, k, a, (k < GOLDEN_NS) ? a + GOLDEN_NXS : zero);
        }
    }
}

/* reach_c = (a_c'H^{-1}a_c)^{1/2}: how far one half unit of cost moves row c, H that of the factorisation on the null space of
 * the dynamics. Covariances of a linear system driven by unit noise: those of the variables have the inverse H^{-1}. 0: no control
 * moves the row. */
static void ipm_set_reach(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int k, f;
    memset(q->covariance, 0, sizeof q->covariance);
    for (f = 0; f < GOLDEN_NF; f++) {
        memset(s->riccati.p[0], 0, sizeof s->riccati.p[0]);
        s->riccati.p[0][free_state[f]] = -1.0;
        riccati_solve_free(&s->riccati, q->covariance[free_state[f]]);
    }
    for (f = 0; f < GOLDEN_NXS - GOLDEN_NX; f++) {
        memcpy(q->covariance[GOLDEN_NX + f], q->covariance[copied_state[f]], sizeof q->covariance[0]);
    }
    for (k = 0; k < GOLDEN_NS; k++) {
        ipm_closed_loop(s, k);
        ipm_stage_reach(s, k);
        ipm_propagate_covariance(s);
    }
    ipm_stage_reach(s, GOLDEN_NS);
}

/* Recursion with the present weights; where a pivot may be zero, with an addition to it that grows until it is enough. */
static int ipm_factorize(golden_solver_t *s)
{
    golden_riccati_t *r = &s->riccati;
    int attempt;
    r->regularize = 0;
    r->regularize_zero = 0.0;
    if (riccati_factorize(s, GOLDEN_NS)) {
        return 1;
    }
    r->regularize = 1;
    r->regularize_zero = s->ipm.least_pivot;
    for (attempt = 0; attempt < 5; attempt++) {
        if (riccati_factorize(s, GOLDEN_NS)) {
            return 1;
        }
        r->regularize_zero *= 1024.0;
    }
    return 0;
}

/* A cost for the bounded rows of a QP whose Hessian is singular without them: the largest of Q_jj d^2 and |g_j| d over the
 * controls with two finite bounds, d apart. */
static golden_real ipm_damping_cost(golden_solver_t *s)
{
    golden_real most = 0.0;
    int k, j;
    for (k = 0; k < GOLDEN_NS; k++) {
        for (j = 0; j < GOLDEN_NUS; j++) {
            const golden_real d = s->qp.upper[k * GOLDEN_NUS + j] - s->qp.lower[k * GOLDEN_NUS + j];
            const golden_real square = stage_Q(s, k)[GOLDEN_NXS + j][GOLDEN_NXS + j] * d * d;
            const golden_real linear = fabs(stage_g(s, k)[GOLDEN_NXS + j]) * d;
            most = (isfinite(square) && square > most) ? square : most;
            most = (isfinite(linear) && linear > most) ? linear : most;
        }
    }
    return (most > 0.0) ? most : 1.0;
}

/* What is added to a pivot that is zero and has no scale of its own. */
static golden_real ipm_least_pivot(golden_solver_t *s)
{
    golden_real most = 0.0;
    int k, i;
    for (k = 0; k <= GOLDEN_NS; k++) {
        for (i = 0; i < ((k < GOLDEN_NS) ? GOLDEN_NZS : GOLDEN_NXS); i++) {
            const golden_real d = (k < GOLDEN_NS) ? stage_Q(s, k)[i][i] : stage_Q_N(s)[i][i];
            most = (d > most) ? d : most;
        }
    }
    return sqrt(2.220446049250313e-16) * ((most > 0.0 && isfinite(most)) ? most : 1.0);
}

/* Where the Hessian is singular the steps are those of the proximal point method, or rounding drives them along its null space:
 * a small share of the largest diagonal entry of each control and free component of x_0. */
static void ipm_set_proximal(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int k, i;
    for (i = 0; i < GOLDEN_NZS; i++) {
        golden_real most = 0.0;
        for (k = 0; k < GOLDEN_NS; k++) {
            most = (stage_Q(s, k)[i][i] > most) ? stage_Q(s, k)[i][i] : most;
        }
        most = sqrt(2.220446049250313e-16) * most;
        q->proximal[i] = 64.0 * ((most > 0.0) ? most : q->least_pivot);
    }
}

/* Weights for the first factorisation: equations, and if the Hessian needs it a damping of the rows with two bounds. */
static void ipm_first_weights(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const golden_real d = s->qp.upper[c] - s->qp.lower[c];
        q->weight[c] = (q->kind[c] == 1) ? q->stiffness[c] : 0.0;
        if (q->damping > 0.0 && q->kind[c] == 0 && d > 0.0 && isfinite(d)) {
            q->weight[c] = q->damping / (d * d);
        }
    }
    ipm_set_weights(s);
}

/* An equation is met in one step but for a small share of its reach^2 times the multiplier. Returns 1 if there is one. */
static int ipm_set_stiffness(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int c, any = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const int equation = q->kind[c] == 1 && q->reach[c] > 0.0;
        q->stiffness[c] = 0.0;
        if (equation) {
            q->stiffness[c] = 1.0 / (9.313225746154785e-10 * q->reach[c] * q->reach[c]);
        }
        any |= equation;
    }
    return any;
}

/* Factorisation of the problem with equations only, and units of the rows. plain: as in ipm_prepare(). */
static int ipm_first_factorization(golden_solver_t *s, int plain)
{
    golden_ipm_t *q = &s->ipm;
    int c, stands = plain;
    memset(q->stiffness, 0, sizeof q->stiffness);
    memset(q->proximal, 0, sizeof q->proximal);
    q->damping = 0.0;
    q->stiffening = 1.0;
    q->least_pivot = ipm_least_pivot(s);
    ipm_first_weights(s);
    s->riccati.regularize = 0;
    for (c = 0; c < GOLDEN_NV; c++) {
        stands &= !s->riccati.fixed[c];
    }
    if (!stands && !riccati_factorize(s, GOLDEN_NS)) {
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
static int ipm_first_forces(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int c, changed = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const golden_real middle = 0.5 * (s->qp.lower[c] + s->qp.upper[c]);
        const golden_real f = (q->weight[c] > 0.0) ? -q->weight[c] * middle : 0.0;
        const golden_real u = (q->kind[c] == 2) ? s->qp.lower[c] : 0.0;
        changed |= !(f >= q->force[c] && f <= q->force[c]);
        q->force[c] = f;
        if (c < GOLDEN_NV) {
            changed |= !(u >= s->riccati.du[c] && u <= s->riccati.du[c]);
            s->riccati.du[c] = u;
        }
    }
    return changed;
}

/* The backward substitution that does not need dx_0. */
static void ipm_first_backward(golden_solver_t *s)
{
    int k;
    for (k = 0; k < GOLDEN_NS; k++) {
        memcpy(s->riccati.g[k], stage_g(s, k), sizeof s->riccati.g[k]);
        memcpy(s->riccati.b[k], stage_b(s, k), sizeof s->riccati.b[k]);
    }
    memcpy(s->riccati.g[k], stage_g(s, k), sizeof s->riccati.g[0][0] * GOLDEN_NXS);
    ipm_add_forces(s, s->ipm.force, s->riccati.g);
    riccati_backward(s, GOLDEN_NS);
}

/* (x, u) = minimiser with equations only. Returns 0 if it is not finite. From here on steps are computed: no gaps, no dx_0. */
static int ipm_first_point(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real probe = 0.0;
    int k, i;
    memcpy(s->qp.x[0], s->step.dx[0], sizeof s->step.dx[0]);
    riccati_forward(s, s->qp.x, s->qp.z);
    memset(s->riccati.b, 0, sizeof s->riccati.b);
    memset(s->riccati.du, 0, sizeof s->riccati.du);
    for (k = 0; k <= GOLDEN_NS; k++) {
        for (i = 0; i < GOLDEN_NXS; i++) {
            probe += 0.0 * s->qp.x[k][i];
        }
    }
    ipm_values(s, s->qp.x, s->qp.z, q->v);
    memcpy(q->origin, q->v, sizeof q->v);
    for (i = 0; i < GOLDEN_NV + GOLDEN_NG; i++) {
        probe += 0.0 * q->v[i];
        q->y[i] = (q->kind[i] == 1) ? q->weight[i] * (q->v[i] - s->qp.lower[i]) : 0.0;
    }
    return isfinite(probe) != 0;
}

/* How much row c, which has no multiplier yet, violates its bounds beyond rounding. */
static golden_real ipm_violation(const golden_solver_t *s, int c)
{
    const golden_real v = s->ipm.v[c], over = v - s->qp.upper[c], under = s->qp.lower[c] - v;
    const golden_real amount = (over > under) ? over : under;
    const golden_real bound = fabs((over > under) ? s->qp.upper[c] : s->qp.lower[c]);
    return (amount > 5.684341886080802e-14 * (bound + fabs(v))) ? amount : 0.0;
}

/* Cost of the violations, sum of (violation / reach)^2, and their number. */
static golden_real ipm_violation_cost(const golden_solver_t *s, int *count)
{
    golden_real sum = 0.0;
    int c;
    *count = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        if (s->ipm.kind[c] == 0 && s->ipm.reach[c] > 0.0) {
            const golden_real d = ipm_violation(s, c) / s->ipm.reach[c];
            sum += d * d;
            *count += d > 0.0;
        }
    }
    return sum;
}

/* 1 if an inequality is violated. */
static int ipm_any_violation(const golden_solver_t *s)
{
    int count;
    (void)ipm_violation_cost(s, &count);
    return count > 0;
}

/* Slack and multiplier of a soft side. It starts where its violation costs no more than its penalty, unless it was violated in
 * the QP before. */
static void ipm_start_soft_side(golden_solver_t *s, int i, golden_real mu, golden_real distance)
{
    golden_ipm_t *q = &s->ipm;
    const int c = q->row[i], j = i - q->hard;
    const golden_real l1 = s->qp.penalty[c - GOLDEN_NV], l2 = s->qp.curvature[c - GOLDEN_NV];
    const golden_real least = sqrt(mu) * q->reach[c];
    if (!(l1 > 0.0)) {
        q->kappa[j] = 0.0;
        q->e[j] = q->lam[i] / l2;
    } else if (q->warm && s->qp.side[c] == ((q->sign[i] > 0.0) ? 2 : -2)) {
        q->e[j] = (-distance > least) ? -distance : least;
        q->lam[i] = l1 + l2 * q->e[j];
        q->kappa[j] = (mu / q->e[j] < 0.5 * q->lam[i]) ? mu / q->e[j] : 0.5 * q->lam[i];
        q->lam[i] -= q->kappa[j];
        q->t[i] = mu / q->lam[i];
    } else {
        q->lam[i] = (q->lam[i] < 0.5 * l1) ? q->lam[i] : 0.5 * l1;
        q->t[i] = mu / q->lam[i];
        q->kappa[j] = l1 - q->lam[i];
        q->e[j] = mu / q->kappa[j];
    }
}

/* t lam = mu on every side, t - reach^2 lam = distance - reach^2 |multiplier before| but for violated bounds, where the distance
 * counts as 0. Multipliers that the present cost of the violations cannot explain are cut. Without a multiplier t is at most the
 * middle between the bounds, unless the value is farther away. */
static void ipm_start_sides(golden_solver_t *s, golden_real mu, golden_real cost)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real root_mu = sqrt(mu), most = 4.0 * sqrt(cost);
    int i;
    for (i = 0; i < q->sides; i++) {
        const int c = q->row[i];
        const golden_real reach = q->reach[c], distance = q->sign[i] * (q->bound[i] - q->v[c]);
        const golden_real half = 0.5 * (s->qp.upper[c] - s->qp.lower[c]);
        golden_real force = q->warm ? q->sign[i] * q->before[c] * reach : 0.0, t = root_mu * reach;
        t = (half < t && half > 0.0) ? half : t;
        t = (distance > t) ? distance : t;
        if (force > 0.0) {
            force = (force < most) ? force : most;
            force -= (distance > 0.0) ? distance / reach : 0.0;
            t = sqrt(force * force + 4.0 * mu);
            t = (force > 0.0) ? 2.0 * mu * reach / (t + force) : 0.5 * (t - force) * reach;
        }
        q->t[i] = t;
        q->lam[i] = mu / t;
        if (i >= q->hard) {
            ipm_start_soft_side(s, i, mu, distance);
        }
    }
}

/* Contract of this part: the multipliers against the dynamics, as stationarity or as a proof that there is no feasible point. */

/* Entries of vectors of the states that belong to copies of components of x_0 join those of the originals. */
static inline void ipm_fold(golden_real *w)
{
    int c;
    for (c = 0; c < GOLDEN_NXS - GOLDEN_NX; c++) {
        w[copied_state[c]] += w[GOLDEN_NX + c];
        w[GOLDEN_NX + c] = 0.0;
    }
}

/* w = S_k'lam + g_k, lam the adjoint of x_{k+1}. */
static inline void ipm_adjoint_step(golden_solver_t *s, int k, const golden_real *lam, golden_real *w)
{
    memcpy(w, s->riccati.g[k], sizeof s->riccati.g[k]);
    riccati_combine(w, lam, stage_S(s, k)[0], GOLDEN_NZS, GOLDEN_NXS, GOLDEN_NZS);
}

/* The sum of the absolute terms of entry i of the gradient at stage k without the dynamics: cost and rows. */
static inline golden_real ipm_gradient_terms(golden_solver_t *s, int k, int i)
{
    const golden_real g = stage_g(s, k)[i], cost = s->ipm.gradient[k][i];
    return fabs(g) + fabs(cost - g) + fabs(s->riccati.g[k][i] - cost);
}

/* size[j]: the sum of the absolute terms of the gradient of control j at stage k, next[] those of the entries of lam. What lam is
 * a sum of may cancel in it, as where a row holds a state, so its rounding is not seen from lam. */
static void ipm_term_sizes(golden_solver_t *s, int k, const golden_real *next, golden_real *size)
{
    int i, j;
    for (j = 0; j < GOLDEN_NUS; j++) {
        size[j] = ipm_gradient_terms(s, k, GOLDEN_NXS + j);
        for (i = 0; i < GOLDEN_NXS; i++) {
            size[j] += fabs(stage_S(s, k)[i][GOLDEN_NXS + j]) * next[i];
        }
    }
}

/* The largest |gradient| and the largest sum of its terms, both times the way that one unit of cost allows. */
static inline void ipm_take_gradient(golden_real rest, golden_real terms, golden_real unit, golden_real *worst, golden_real *most)
{
    *worst = (fabs(rest) * unit > *worst) ? fabs(rest) * unit : *worst;
    *most = (terms * unit > *most) ? terms * unit : *most;
}

/* Gradient of the Lagrangian with respect to the free controls and components of x_0 relative to the largest of the terms it is
 * a sum of, each times the way that one unit of cost allows, under the feedback u = K x + v: so rounding does not grow along an
 * unstable horizon. Fixed controls get their multipliers. */
static golden_real ipm_stationarity(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real lam[GOLDEN_NXS], w[GOLDEN_NZS], size[GOLDEN_NUS], next[GOLDEN_NXS], worst = 0.0, most = 0.0;
    int k, j;
    memcpy(s->riccati.g, q->gradient, sizeof s->riccati.g);
    ipm_add_forces(s, s->qp.mult, s->riccati.g);
    memcpy(lam, s->riccati.g[GOLDEN_NS], sizeof lam);
    for (j = 0; j < GOLDEN_NXS; j++) {
        next[j] = ipm_gradient_terms(s, GOLDEN_NS, j);
    }
    for (k = GOLDEN_NS - 1; k >= 0; k--) {
        ipm_adjoint_step(s, k, lam, w);
        ipm_term_sizes(s, k, next, size);
        for (j = 0; j < GOLDEN_NUS; j++) {
            const int c = k * GOLDEN_NUS + j;
            if (q->kind[c] == 2) {
                s->qp.mult[c] -= w[GOLDEN_NXS + j];
            } else {
                ipm_take_gradient(w[GOLDEN_NXS + j], size[j], q->reach[c], &worst, &most);
            }
        }
        for (j = 0; j < GOLDEN_NXS; j++) {
            next[j] = ipm_gradient_terms(s, k, j) + fabs(w[j] - s->riccati.g[k][j]);
        }
        riccati_combine(w, w + GOLDEN_NXS, s->riccati.K[k][0], GOLDEN_LDX, GOLDEN_NUS, GOLDEN_NXS);
        memcpy(lam, w, sizeof lam);
    }
    ipm_fold(lam);
    ipm_fold(next);
    for (j = 0; j < GOLDEN_NF; j++) {
        const golden_real unit = 1.0 / sqrt(s->riccati.F[j][j]);
        ipm_take_gradient(lam[free_state[j]], next[free_state[j]], unit, &worst, &most);
    }
    return (worst > 0.0) ? worst / most : 0.0;
}

/* f B of a row with weight f: B its upper bound for f > 0, its lower one for f < 0. */
static inline golden_real ipm_support(const golden_solver_t *s, int c, golden_real f)
{
    return (f > 0.0) ? f * s->qp.upper[c] : (f < 0.0) ? f * s->qp.lower[c] : 0.0;
}

/* certificate = f: multipliers of the hard rows, each with the sign of a finite bound. Returns the largest. */
static golden_real ipm_ray(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real most = 0.0;
    int c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const int soft = c >= GOLDEN_NV && s->qp.penalty[c - GOLDEN_NV] < (golden_real)INFINITY;
        const golden_real f = (soft || c < GOLDEN_NV) ? 0.0 : s->qp.mult[c];
        q->ray[c] = isfinite(ipm_support(s, c, f)) ? f : 0.0;
        most = (fabs(q->ray[c]) > most) ? fabs(q->ray[c]) : most;
    }
    return most;
}

/* The absolute terms of component j of w = S_k'nu + g_k, at stage k. */
static golden_real ipm_ray_terms(golden_solver_t *s, int k, int j, const golden_real *nu)
{
    golden_real size = fabs(s->riccati.g[k][j]);
    int i;
    for (i = 0; i < GOLDEN_NXS; i++) {
        size += fabs(stage_S(s, k)[i][j] * nu[i]);
    }
    return size;
}

/* 1 if component j of w is the rounding of the terms it is a sum of. */
static inline int ipm_vanishes(golden_solver_t *s, int k, int j, const golden_real *nu, golden_real w)
{
    return fabs(w) <= 9.313225746154785e-10 * ipm_ray_terms(s, k, j, nu);
}

/* The same for component j of x_0 with its copies. */
static int ipm_free_vanishes(golden_solver_t *s, int j, const golden_real *nu, const golden_real *w)
{
    golden_real sum = w[j], size = ipm_ray_terms(s, 0, j, nu);
    int c;
    for (c = 0; c < GOLDEN_NXS - GOLDEN_NX; c++) {
        if (copied_state[c] == j) {
            sum += w[GOLDEN_NX + c];
            size += ipm_ray_terms(s, 0, GOLDEN_NX + c, nu);
        }
    }
    return fabs(sum) <= 9.313225746154785e-10 * size;
}

/* The weights f of the rows leave sum_c f_c a_c = w for the controls and free states of stage k. The bound of a control takes
 * -w_j if there is one on that side; else w_j must be rounding. Returns 0 if it is not. */
static int ipm_balance(golden_solver_t *s, int k, const golden_real *nu, const golden_real *w)
{
    int j;
    for (j = 0; j < GOLDEN_NUS; j++) {
        const golden_real f = -w[GOLDEN_NXS + j];
        const int finite = isfinite(ipm_support(s, k * GOLDEN_NUS + j, f)) != 0;
        s->ipm.ray[k * GOLDEN_NUS + j] = finite ? f : 0.0;
        if (!finite && !ipm_vanishes(s, k, GOLDEN_NXS + j, nu, -f)) {
            return 0;
        }
    }
    for (j = 0; k == 0 && j < GOLDEN_NF; j++) {
        if (!ipm_free_vanishes(s, free_state[j], nu, w)) {
            return 0;
        }
    }
    return 1;
}

/* 1 if the rows contradict each other: with the adjoint nu of the weights f, sum_c f_c v_c = nu_0'dx_0 + sum_k nu_{k+1}'b_k for
 * all points of the dynamics, and f_c v_c <= f_c B_c. */
static int ipm_contradiction(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real nu[GOLDEN_NXS], w[GOLDEN_NZS], gap = 0.0, size = 0.0;
    int k, i, c;
    memset(s->riccati.g, 0, sizeof s->riccati.g);
    ipm_add_forces(s, q->ray, s->riccati.g);
    memcpy(nu, s->riccati.g[GOLDEN_NS], sizeof nu);
    for (k = GOLDEN_NS - 1; k >= 0; k--) {
        ipm_adjoint_step(s, k, nu, w);
        if (!ipm_balance(s, k, nu, w)) {
            return 0;
        }
        for (i = 0; i < GOLDEN_NXS; i++) {
            gap -= nu[i] * stage_b(s, k)[i];
            size += fabs(nu[i] * stage_b(s, k)[i]);
        }
        memcpy(nu, w, sizeof nu);
    }
    for (i = 0; i < GOLDEN_NX; i++) {
        const golden_real term = (is_measured[i] || is_accumulator[i]) ? nu[i] * s->step.dx[0][i] : 0.0;
        gap -= term;
        size += fabs(term);
    }
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const golden_real term = ipm_support(s, c, q->ray[c]);
        gap += term;
        size += fabs(term);
    }
    return gap < -1.4551915228366852e-11 * size;
}

/* Writes the certificate, its largest entry 1. */
static void ipm_write_certificate(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real most = 0.0;
    int c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        most = (fabs(q->ray[c]) > most) ? fabs(q->ray[c]) : most;
    }
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        s->qp.certificate[c] = q->ray[c] / most;
    }
}

/* 1, with the certificate, if the present multipliers prove that there is no feasible point. */
static int ipm_infeasible(golden_solver_t *s)
{
    const golden_real most = ipm_ray(s);
    if (most > 0.0 && isfinite(most) && ipm_contradiction(s)) {
        ipm_write_certificate(s);
        return 1;
    }
    return 0;
}

/* Rows that no control moves are met or not, whatever is done. 1, with the certificate, if one is not. */
static int ipm_constant_rows(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int c;
    for (c = GOLDEN_NV; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const int constant = !(q->reach[c] > 0.0);
        const int hard = !(s->qp.penalty[c - GOLDEN_NV] < (golden_real)INFINITY);
        if (constant && hard && ipm_violation(s, c) > 0.0) {
            memset(q->ray, 0, sizeof q->ray);
            q->ray[c] = (q->v[c] > s->qp.upper[c]) ? 1.0 : -1.0;
            if (ipm_contradiction(s)) {
                ipm_write_certificate(s);
                return 1;
            }
        }
    }
    return 0;
}

/* Contract of this part: predictor-corrector iterations from started sides to the solution. */

/* Multiplier of a soft row that no control moves, 0 of any other row. */
static golden_real ipm_constant_multiplier(const golden_solver_t *s, int c)
{
    const golden_ipm_t *q = &s->ipm;
    const int m = c - GOLDEN_NV;
    golden_real violation;
    if (q->reach[c] > 0.0 || !(s->qp.penalty[m] < (golden_real)INFINITY)) {
        return 0.0;
    }
    violation = ipm_violation(s, c);
    if (!(violation > 0.0)) {
        return 0.0;
    }
    violation = s->qp.penalty[m] + s->qp.curvature[m] * violation;
    return (q->v[c] > s->qp.upper[c]) ? violation : -violation;
}

/* Multipliers of the rows, without those of fixed controls. */
static void ipm_net_multipliers(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    int i;
    for (i = 0; i < GOLDEN_NV; i++) {
        s->qp.mult[i] = 0.0;
    }
    for (i = GOLDEN_NV; i < GOLDEN_NV + GOLDEN_NG; i++) {
        s->qp.mult[i] = (q->kind[i] == 1) ? q->y[i] : ipm_constant_multiplier(s, i);
    }
    for (i = 0; i < q->sides; i++) {
        s->qp.mult[q->row[i]] += q->sign[i] * q->lam[i];
    }
}

/* The unit of the complementarity: what the inequalities cost, 1/2 sum_c mult_c (v_c at the first point - v_c), but no more than
 * the largest (mult reach)^2 of a row; no less than a small share of the largest (value / reach)^2 of a control, for inequalities
 * that only touch cost nothing. */
static golden_real ipm_cost_unit(const golden_solver_t *s)
{
    const golden_ipm_t *q = &s->ipm;
    golden_real most = 0.0, sum = 0.0, way = 0.0;
    int c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        const golden_real force = fabs(s->qp.mult[c]) * q->reach[c];
        most = (force > most) ? force : most;
        sum += s->qp.mult[c] * (q->origin[c] - q->v[c]);
    }
    for (c = 0; c < GOLDEN_NV; c++) {
        const golden_real v = fabs(q->v[c]);
        way = (q->kind[c] == 0 && v > way * q->reach[c] && q->reach[c] > 0.0) ? v / q->reach[c] : way;
    }
    sum = 0.5 * fabs(sum);
    most = (sum < most * most) ? sum : most * most;
    way *= 0.00390625;
    return (most > way * way) ? most : way * way;
}

/* sum |a_i| |z_i| of row c: what the rounding of its value is relative to. */
static golden_real ipm_terms(golden_solver_t *s, int c)
{
    const int m = c - GOLDEN_NV, k = (m >= 0) ? stage_of_row[m] : 0;
    golden_real sum = 0.0;
    const golden_real *a;
    int i;
    if (m < 0 || stage_state[m] >= 0) {
        return fabs(s->ipm.v[c]);
    }
    a = stage_row(s, m);
    for (i = 0; i < GOLDEN_NXS; i++) {
        sum += fabs(a[i] * s->qp.x[k][i]);
    }
    for (i = 0; k < GOLDEN_NS && i < GOLDEN_NUS; i++) {
        sum += fabs(a[GOLDEN_NXS + i] * s->qp.z[k * GOLDEN_NUS + i]);
    }
    return sum;
}

/* |residual| of row c relative to |bound|, the terms of its value and the way that the unit of cost allows, if larger than the one
 * before. */
static void ipm_take_residual(golden_solver_t *s, int c, golden_real bound, golden_real residual, golden_real root)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real amount = fabs(residual);
    golden_real size = fabs(bound) + fabs(q->v[c]) + root * q->reach[c];
    if (amount > q->primal * size) {
        size += ipm_terms(s, c) - fabs(q->v[c]);
        q->primal = (amount > q->primal * size) ? amount / size : q->primal;
    }
}

/* Residuals at the iterate. */
static void ipm_measure(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_real root;
    int i, c;
    ipm_values(s, s->qp.x, s->qp.z, q->v);
    ipm_net_multipliers(s);
    ipm_side_residuals(s);
    q->unit = ipm_cost_unit(s);
    q->unit = (q->unit > q->mu) ? q->unit : q->mu;
    root = sqrt(q->unit);
    q->primal = 0.0;
    for (i = 0; i < q->sides; i++) {
        ipm_take_residual(s, q->row[i], q->bound[i], q->r[i], root);
    }
    for (c = GOLDEN_NV; c < GOLDEN_NV + GOLDEN_NG; c++) {
        if (q->stiffness[c] > 0.0) {
            ipm_take_residual(s, c, s->qp.lower[c], q->v[c] - s->qp.lower[c], root);
        }
    }
}

/* Regularisation keeps a full step from meeting the rows exactly. What it leaves to rows to which others leave little room may not
 * fall fast enough: then there is less of it. Returns 1 if so. */
static int ipm_stiffen(golden_ipm_t *q, golden_real before)
{
    if (q->step > 0.9 && q->primal > 2.0 * 8.881784197001252e-16 && q->primal > 0.125 * before &&
        q->stiffening < q->stiffest) {
        q->stiffening *= 16.0;
        return 1;
    }
    return 0;
}

/* 1 / (the longest step that keeps t, lam, e and kappa positive). */
static golden_real ipm_inverse_step(const golden_solver_t *s)
{
    const golden_ipm_t *q = &s->ipm;
    golden_real most = 0.0;
    int i;
    for (i = 0; i < q->sides; i++) {
        const golden_real a = -q->dt[i] / q->t[i], b = -q->dlam[i] / q->lam[i];
        most = (a > most) ? a : most;
        most = (b > most) ? b : most;
    }
    for (i = 0; i < q->sides - q->hard; i++) {
        if (q->kappa[i] > 0.0) {
            const golden_real a = -q->de[i] / q->e[i], b = -q->dkappa[i] / q->kappa[i];
            most = (a > most) ? a : most;
            most = (b > most) ? b : most;
        }
    }
    return most;
}

/* Mean of t lam and e kappa after a step of the given length, relative to the present one. */
static golden_real ipm_reduction(const golden_solver_t *s, golden_real step)
{
    const golden_ipm_t *q = &s->ipm;
    golden_real now = 0.0, then = 0.0;
    int i;
    for (i = 0; i < q->sides; i++) {
        now += q->t[i] * q->lam[i];
        then += (q->t[i] + step * q->dt[i]) * (q->lam[i] + step * q->dlam[i]);
    }
    for (i = 0; i < q->sides - q->hard; i++) {
        now += q->e[i] * q->kappa[i];
        then += (q->e[i] + step * q->de[i]) * (q->kappa[i] + step * q->dkappa[i]);
    }
    return then / now;
}

/* Second-order correction and centring for the products t lam and e kappa: extra = (target - share dt dlam) / lam, and alike for
 * e. The correction of a direction of which only a short step is possible would do harm: share < 1. */
static void ipm_correct(golden_solver_t *s, golden_real target, golden_real share)
{
    golden_ipm_t *q = &s->ipm;
    int i;
    for (i = 0; i < q->sides; i++) {
        q->extra[i] = (target - share * q->dt[i] * q->dlam[i]) / q->lam[i];
    }
    for (i = 0; i < q->sides - q->hard; i++) {
        q->extra_e[i] = (q->kappa[i] > 0.0) ? (target - share * q->de[i] * q->dkappa[i]) / q->e[i] : 0.0;
    }
}

/* All unknowns move. */
static void ipm_move(golden_solver_t *s, golden_real step)
{
    golden_ipm_t *q = &s->ipm;
    int k, i, c;
    for (k = 0; k <= GOLDEN_NS; k++) {
        for (i = 0; i < GOLDEN_NXS; i++) {
            s->qp.x[k][i] += step * q->dx[k][i];
        }
        for (i = 0; k < GOLDEN_NS && i < GOLDEN_NXS; i++) {
            s->riccati.b[k][i] *= 1.0 - step;
        }
    }
    for (c = 0; c < GOLDEN_NV; c++) {
        s->qp.z[c] += step * q->du[c];
    }
    for (c = GOLDEN_NV; c < GOLDEN_NV + GOLDEN_NG; c++) {
        if (q->kind[c] == 1) {
            q->y[c] += step * q->weight[c] * ((q->v[c] - s->qp.lower[c]) + q->dv[c]);
        }
    }
    for (i = 0; i < q->sides; i++) {
        q->t[i] += step * q->dt[i];
        q->lam[i] += step * q->dlam[i];
    }
    for (i = 0; i < q->sides - q->hard; i++) {
        q->e[i] += step * q->de[i];
        q->kappa[i] += step * q->dkappa[i];
    }
}

/* The share of the way to the boundary that is not gone: little, and less near the solution. An iteration that takes long without
 * being near it is going round in circles, close to the boundary; a larger distance from there breaks them. */
static golden_real ipm_setback(const golden_solver_t *s)
{
    const golden_real gap = s->ipm.mu / s->ipm.unit;
    if (s->qp.iterations > 15 && gap > sqrt(2.220446049250313e-16)) {
        return 0.1;
    }
    return (gap > 0.0005) ? 0.005 : (gap < 1e-07) ? 1e-06 : 10.0 * gap;
}

/* By how much to stretch a direction, d = residual of the equations: d'W d / -d'W dv, the step of steepest ascent of the dual
 * function. Where equations nearly depend on each other the method of multipliers takes short steps in one direction. */
static golden_real ipm_stretch(const golden_solver_t *s)
{
    const golden_ipm_t *q = &s->ipm;
    golden_real gain = 0.0, size = 0.0;
    int c;
    for (c = GOLDEN_NV; c < GOLDEN_NV + GOLDEN_NG; c++) {
        if (q->kind[c] == 1) {
            const golden_real residual = q->v[c] - s->qp.lower[c];
            gain += q->weight[c] * residual * residual;
            size -= q->weight[c] * residual * q->dv[c];
        }
    }
    if (!(q->stretched && gain > size)) {
        return 1.0;
    }
    return (gain < 64.0 * size) ? gain / size : 64.0;
}

/* One iteration of Mehrotra (1992): affine direction, centring as its success allows, corrected direction. */
static void ipm_step(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real least = 0.0009765625 * 2.117582368135751e-22 * q->unit;
    golden_real inverse, share, target, way, most;
    memset(q->extra, 0, sizeof q->extra);
    memset(q->extra_e, 0, sizeof q->extra_e);
    ipm_direction(s);
    if (q->sides == 0) {
        ipm_move(s, ipm_stretch(s));
        return;
    }
    inverse = ipm_inverse_step(s);
    share = ipm_reduction(s, (inverse > 1.0) ? 1.0 / inverse : 1.0);
    share = (share > 0.0) ? ((share < 1.0) ? share : 1.0) : 0.0;
    target = share * share * share * q->mu;
    ipm_correct(s, (target > least) ? target : least, (inverse > 4.0) ? 4.0 / inverse : 1.0);
    ipm_direction(s);
    inverse = ipm_inverse_step(s);
    way = 1.0 - ipm_setback(s);
    most = ipm_stretch(s);
    q->step = (way < inverse * most) ? way / inverse : most;
    ipm_move(s, q->step);
}

/* b = S z + b - x of the next stage at the iterate, whose rounding adds up over the iterations; the largest relative to the
 * largest value of that state. */
static golden_real ipm_gaps(golden_solver_t *s)
{
    golden_real most = 0.0, size[GOLDEN_NXS] = {0}, z[GOLDEN_NZS];
    int k, i;
    for (k = 0; k <= GOLDEN_NS; k++) {
        for (i = 0; i < GOLDEN_NXS; i++) {
            const golden_real x = fabs(s->qp.x[k][i]);
            size[i] = (x > size[i]) ? x : size[i];
        }
    }
    for (k = 0; k < GOLDEN_NS; k++) {
        golden_real (*S)[GOLDEN_NZS] = stage_S(s, k);
        memcpy(z, s->qp.x[k], sizeof s->qp.x[k]);
        memcpy(z + GOLDEN_NXS, s->qp.z + k * GOLDEN_NUS, sizeof z[0] * GOLDEN_NUS);
        for (i = 0; i < GOLDEN_NXS; i++) {
            const golden_real gap = riccati_dot(S[i], z, GOLDEN_NZS) + stage_b(s, k)[i] - s->qp.x[k + 1][i];
            s->riccati.b[k][i] = gap;
            most = (fabs(gap) > most * size[i]) ? fabs(gap) / size[i] : most;
        }
    }
    return most;
}

/* Residuals that are good enough where they fall no more. */
static inline int ipm_small_residuals(const golden_ipm_t *q)
{
    return q->merit <= 16384.0 && q->slope <= 1024.0;
}

/* 1 if all residuals are at their tolerance, or small and no longer falling: the gradient may be noisy where weights are large.
 * Gaps of the dynamics are closed then. */
static int ipm_converged(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real rows_before = q->merit, gradient_before = q->slope;
    q->merit = q->primal / 8.881784197001252e-16;
    if (q->mu > q->merit * 2.117582368135751e-22 * q->unit) {
        q->merit = q->mu / (2.117582368135751e-22 * q->unit);
    }
    q->slope = (golden_real)INFINITY;
    if (!(q->merit <= 16384.0)) {
        return 0;
    }
    q->slope = ipm_stationarity(s) / 5.684341886080802e-14;
    if ((q->merit > 1.0 && q->merit <= 0.875 * rows_before) || !ipm_small_residuals(q) ||
        (q->slope > 1.0 && q->slope <= 0.5 * gradient_before)) {
        return 0;
    }
    if (q->closed_gaps < 2 && ipm_gaps(s) > 5.684341886080802e-14) {
        q->closed_gaps++;
        return 0;
    }
    return 1;
}

/* Stiff rows drown the gradient in their rounding: once that does not pass, there is less stiffening for good. Returns 1 if so. */
static int ipm_soften(golden_ipm_t *q, golden_real gradient_before)
{
    if (q->stiffening > 1.0 && q->slope < (golden_real)INFINITY && q->slope > 1024.0 &&
        q->slope > 0.5 * gradient_before) {
        q->stiffest = 0.0625 * q->stiffening;
        q->stiffening = 1.0;
        return 1;
    }
    return 0;
}

/* Stiff rows may be too much for the recursion. 0 if it fails with the regularisation that they began with, too. */
static int ipm_weigh_and_factorize(golden_solver_t *s)
{
    ipm_weigh(s);
    while (!ipm_factorize(s)) {
        if (s->ipm.stiffening <= 1.0) {
            return 0;
        }
        s->ipm.stiffening = 1.0;
        ipm_weigh(s);
    }
    return 1;
}

/* 1 if the next step is to be stretched: every other one, where nothing but equations is left that hardly come closer. */
static int ipm_slow_equations(const golden_ipm_t *q, golden_real before)
{
    return !q->stretched && q->primal > 0.875 * before && q->stiffening >= q->stiffest &&
           q->mu <= 16384.0 * 2.117582368135751e-22 * q->unit && ipm_any(q, 1);
}

/* The same before an end with equations that are off by more than rounding; 1 also after a stretched step: another one follows. */
static int ipm_inexact_equations(golden_ipm_t *q)
{
    q->stretched = !q->stretched;
    if (q->stretched) {
        q->stretched = ipm_any(q, 1) && q->primal > 4.0 * 8.881784197001252e-16 && q->primal <= 0.5 * q->slow;
        q->slow = q->primal;
        return q->stretched;
    }
    return 1;
}

/* OK, ITERATION_LIMIT, INFEASIBLE or NUMERICAL_FAILURE. */
static golden_status_t ipm_iterate(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    q->closed_gaps = q->stretched = 0;
    q->merit = q->slope = q->slow = (golden_real)INFINITY;
    q->step = 1.0;
    q->stiffest = 65536.0;
    q->primal = (golden_real)INFINITY;
    for (;;) {
        const golden_real before = q->primal, gradient_before = q->slope;
        int changed, converged;
        ipm_measure(s);
        changed = ipm_stiffen(q, before);
        ipm_cost_gradient(s);
        if (!isfinite(q->mu) || !isfinite(q->primal)) {
            return GOLDEN_NUMERICAL_FAILURE;
        }
        converged = ipm_converged(s);
        if (q->probing && q->slope < (golden_real)INFINITY && ipm_any_violation(s)) {
            return GOLDEN_OK;
        }
        changed |= ipm_soften(q, gradient_before);
        if (!converged || changed) {
            q->stretched = ipm_slow_equations(q, before);
        } else if (!ipm_inexact_equations(q)) {
            return GOLDEN_OK;
        }
        if (q->primal > 8.881784197001252e-16 && (q->step < 0.5 || q->primal > 0.5 * before) &&
            ipm_infeasible(s)) {
            return GOLDEN_INFEASIBLE;
        }
        if (s->qp.iterations >= (q->warm ? GOLDEN_IPM_MAX_ITERATIONS / 2 : GOLDEN_IPM_MAX_ITERATIONS)) {
            return ipm_infeasible(s) ? GOLDEN_INFEASIBLE : GOLDEN_ITERATION_LIMIT;
        }
        s->qp.iterations++;
        if (q->sides > 0 || changed) {
            if (!ipm_weigh_and_factorize(s)) {
                return ipm_small_residuals(q) ? GOLDEN_OK : GOLDEN_NUMERICAL_FAILURE;
            }
        }
        ipm_step(s);
    }
}

/* Results that say nothing. */
static void ipm_clear(golden_solver_t *s)
{
    memset(s->qp.x, 0, sizeof s->qp.x);
    memset(s->qp.z, 0, sizeof s->qp.z);
    memset(s->qp.mult, 0, sizeof s->qp.mult);
    memset(s->qp.side, 0, sizeof s->qp.side);
    memset(s->qp.certificate, 0, sizeof s->qp.certificate);
    s->qp.relaxed = 0;
}

/* side: rows whose multiplier is larger than what their distance to the bound would cost; +-2: soft ones that are violated.
 * Multipliers of the others that are only rounding become 0. */
static void ipm_write_sides(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    const golden_real least = 2.220446049250313e-16 * sqrt(q->unit);
    int i, c;
    s->qp.relaxed = 0;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        s->qp.side[c] = (q->kind[c] == 0) ? 0 : (s->qp.mult[c] < 0.0) ? -1 : 1;
    }
    for (i = 0; i < q->sides; i++) {
        const golden_real square = q->reach[q->row[i]] * q->reach[q->row[i]];
        if (q->lam[i] * square > q->t[i]) {
            const int violated = i >= q->hard && q->e[i - q->hard] > q->kappa[i - q->hard] * square;
            s->qp.side[q->row[i]] = (q->sign[i] > 0.0 ? 1 : -1) * (violated ? 2 : 1);
            s->qp.relaxed += violated;
        }
    }
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        if (c >= GOLDEN_NV && !(q->reach[c] > 0.0)) {
            const golden_real mult = ipm_constant_multiplier(s, c);
            s->qp.side[c] = (mult > 0.0) ? 2 : (mult < 0.0) ? -2 : s->qp.side[c];
            s->qp.relaxed += s->qp.side[c] == 2 || s->qp.side[c] == -2;
        } else if (s->qp.side[c] == 0 && fabs(s->qp.mult[c]) * q->reach[c] <= least) {
            s->qp.mult[c] = 0.0;
        }
    }
}

/* Everything that does not depend on dx_0. plain: the factors at hand are those without given controls and without rows. */
static golden_status_t ipm_prepare(golden_solver_t *s, int plain)
{
    s->ipm.ready = 0;
    (void)ipm_take_kinds(s);
    if (!ipm_first_factorization(s, plain)) {
        return GOLDEN_NUMERICAL_FAILURE;
    }
    (void)ipm_first_forces(s);
    ipm_first_backward(s);
    s->ipm.ready = 1;
    return GOLDEN_OK;
}

/* The first point is the solution if it meets all rows, once equations are exact and fixed controls have their multipliers.
 * Returns 1 if it is, or if something is wrong with the equations. */
static int ipm_run_without_sides(golden_solver_t *s, golden_status_t *status)
{
    golden_ipm_t *q = &s->ipm;
    q->sides = q->hard = 0;
    q->unit = 0.0;
    if (q->damping > 0.0 || (ipm_any_violation(s) && !ipm_any(q, 1))) {
        return 0;
    }
    if (!ipm_any(q, 1) && !ipm_any(q, 2)) {
        ipm_net_multipliers(s);
        return 1;
    }
    q->probing = 1;
    *status = ipm_iterate(s);
    q->probing = 0;
    memcpy(q->origin, q->v, sizeof q->v);
    return *status != GOLDEN_OK || !ipm_any_violation(s);
}

/* The first point is known. Products t lam start at twice the mean cost of the violations, with the multipliers of the QP before
 * at a tenth of it. */
static golden_status_t ipm_run(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_status_t status = GOLDEN_OK;
    golden_real cost, mu;
    int count;
    if (ipm_run_without_sides(s, &status)) {
        return status;
    }
    cost = ipm_violation_cost(s, &count);
    mu = 2.0 * cost / (golden_real)((count > 0) ? count : 1);
    mu = (q->damping > mu) ? q->damping : mu;
    ipm_list_sides(s);
    ipm_start_sides(s, q->warm ? 0.1 * mu : mu, cost);
    return ipm_iterate(s);
}

/* From the first factorisation and its backward substitution to the solution. */
static golden_status_t ipm_attempt(golden_solver_t *s)
{
    s->ipm.ready = 0;
    return !ipm_first_point(s) ? GOLDEN_NUMERICAL_FAILURE : ipm_constant_rows(s) ? GOLDEN_INFEASIBLE : ipm_run(s);
}

/* The solution for dx_0 and the present bounds. A warm start that does not get there by half the cap is given up for a cold one. */
static golden_status_t ipm_solve(golden_solver_t *s)
{
    golden_ipm_t *q = &s->ipm;
    golden_status_t status = ipm_check_bounds(s);
    q->warm = GOLDEN_IPM_WARM_START && q->solved;
    memcpy(q->before, s->qp.mult, sizeof q->before);
    s->qp.iterations = q->solved = 0;
    if (status == GOLDEN_OK) {
        if (ipm_take_kinds(s) || !q->ready) {
            status = ipm_prepare(s, 0);
        } else if (ipm_first_forces(s)) {
            ipm_first_backward(s);
        }
    }
    if (status == GOLDEN_OK) {
        status = ipm_attempt(s);
        if (q->warm && (status == GOLDEN_ITERATION_LIMIT || status == GOLDEN_NUMERICAL_FAILURE)) {
            q->warm = 0;
            status = ipm_prepare(s, 0);
            status = (status == GOLDEN_OK) ? ipm_attempt(s) : status;
        }
        q->solved = status == GOLDEN_OK;
        ipm_write_sides(s);
    } else {
        q->ready = 0;
        ipm_clear(s);
    }
    if (status == GOLDEN_NUMERICAL_FAILURE) {
        ipm_clear(s);
    }
    return status;
}

/* Contract of this part: units of the rows, and what is done when no working set is found: the interior point method, then the
 * working set that its complementarity names. */

/* The recursion gets the working set, bounds as they are now; everything is out of date. */
static void qp_enter(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_riccati_t *r = &s->riccati;
    int c, m;
    memset(r->diagonal, 0, sizeof r->diagonal);
    r->regularize = 1;
    r->regularize_zero = ipm_least_pivot(s);
    for (c = 0; c < GOLDEN_NV; c++) {
        q->side[c] = qp_allowed(q, c, q->side[c], (golden_real)INFINITY);
        r->fixed[c] = q->side[c] != 0;
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        c = GOLDEN_NV + m;
        q->side[c] = qp_allowed(q, c, q->side[c], q->penalty[m]);
        r->weight[m] = qp_weight(q, m, q->side[c]);
    }
    q->stale = q->stale_vectors = GOLDEN_NS;
}

/* The cost of moving a row by one is root^2 / 2 or more; as a member it gets a weight that is larger by the root of the precision:
 * one correction makes up for its share in the Hessian, and the rounding that it causes is no larger. */
static void qp_set_units(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    int m;
    for (m = 0; m < GOLDEN_NG; m++) {
        const golden_real reach = s->ipm.reach[GOLDEN_NV + m];
        q->root[m] = (reach > 0.0 && isfinite(reach)) ? 1.0 / reach : 1.0;
        q->weight[m] = q->root[m] * q->root[m] / sqrt(2.220446049250313e-16);
        q->raised[m] = 0;
    }
    q->scaled = 1;
}

/* Units of the rows, from the recursion without members. */
static void qp_scale_rows(golden_solver_t *s)
{
    golden_riccati_t *r = &s->riccati;
    qp_enter(s);
    memset(r->fixed, 0, sizeof r->fixed);
    memset(r->weight, 0, sizeof r->weight);
    if (GOLDEN_NG > 0 && riccati_factorize(s, GOLDEN_NS)) {
        ipm_set_reach(s);
        qp_set_units(s);
    }
}

/* The solution of the interior point method goes to its own scratch, or comes back. */
static void qp_exchange(golden_solver_t *s, int back)
{
    golden_qp_t *q = &s->qp;
    golden_ipm_t *ipm = &s->ipm;
    memcpy(back ? q->x : ipm->dx, back ? ipm->dx : q->x, sizeof q->x);
    memcpy(back ? q->z : ipm->du, back ? ipm->du : q->z, sizeof q->z);
    memcpy(back ? q->mult : ipm->force, back ? ipm->force : q->mult, sizeof q->mult);
}

/* From the empty working set, with units of this QP; where this fails, the interior point method and then the set that it names. */
static golden_status_t qp_fall_back(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_status_t status;
    int before;
    memset(q->side, 0, sizeof q->side);
    memset(q->mult, 0, sizeof q->mult);
    qp_scale_rows(s);
    qp_enter(s);
    if (qp_iterate(s, GOLDEN_QP_MAX_ITERATIONS) == GOLDEN_OK) {
        return GOLDEN_OK;
    }
    before = q->iterations;
    s->ipm.ready = 0;
    status = ipm_solve(s);
    q->iterations += before;
    q->stale = q->stale_vectors = GOLDEN_NS;
    q->factorized = 2;
    if (status != GOLDEN_OK && status != GOLDEN_ITERATION_LIMIT) {
        return status;
    }
    qp_set_units(s);
    qp_exchange(s, 0);
    qp_enter(s);
    if (qp_iterate(s, GOLDEN_QP_MAX_POLISH) == GOLDEN_OK) {
        return GOLDEN_OK;
    }
    qp_exchange(s, 1);
    ipm_write_sides(s);
    q->exact = 0;
    return status;
}

static golden_status_t qp_fail(golden_qp_t *q, golden_status_t status)
{
    memset(q->x, 0, sizeof q->x);
    memset(q->z, 0, sizeof q->z);
    memset(q->mult, 0, sizeof q->mult);
    memset(q->side, 0, sizeof q->side);
    q->factorized = q->factorized ? 2 : 0;
    return status;
}

static void qp_init(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    int c;
    memset(q, 0, sizeof *q);
    riccati_init(s);
    s->riccati.regularize = 1;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        q->lower[c] = -(golden_real)INFINITY;
        q->upper[c] = (golden_real)INFINITY;
    }
    for (c = 0; c < GOLDEN_NG; c++) {
        q->penalty[c] = (golden_real)INFINITY;
        q->root[c] = 1.0;
    }
}

/* The last stage with a member, or -1: later factors are those without members. */
static int qp_last_member(const golden_qp_t *q)
{
    int c, m, last = -1;
    for (c = 0; c < GOLDEN_NV; c++) {
        last = (q->side[c] != 0) ? c / GOLDEN_NUS : last;
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        const int k = stage_of_row[m];
        last = (q->side[GOLDEN_NV + m] != 0 && k > last) ? k : last;
    }
    return last;
}

static golden_status_t qp_factorize(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    const int plain = riccati_convexify(s);
    if (!q->scaled) {
        qp_scale_rows(s);
    }
    qp_enter(s);
    q->stale = plain ? qp_last_member(q) : GOLDEN_NS;
    q->factorized = qp_renew(s);
    if (!q->factorized) { /* weights and members may be those of a QP in other units */
        memset(q->side, 0, sizeof q->side);
        qp_scale_rows(s);
        qp_enter(s);
        q->factorized = qp_renew(s);
    }
    return q->factorized ? GOLDEN_OK : qp_fail(q, GOLDEN_NUMERICAL_FAILURE);
}

static void qp_gradient(golden_solver_t *s)
{
    s->qp.stale_vectors = GOLDEN_NS;
}

/* INFEASIBLE if bounds cross, NUMERICAL_FAILURE if one is not a number. */
static golden_status_t qp_check_bounds(const golden_qp_t *q)
{
    golden_status_t status = GOLDEN_OK;
    int c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        if (!(q->lower[c] < (golden_real)INFINITY && q->upper[c] > -(golden_real)INFINITY)) {
            return GOLDEN_NUMERICAL_FAILURE;
        }
        if (q->lower[c] > q->upper[c]) {
            status = GOLDEN_INFEASIBLE;
        }
    }
    return status;
}

/* 1 if all multipliers are finite: data of a control that is given enter nothing else. */
static int qp_has_multipliers(const golden_qp_t *q)
{
    golden_real sum = 0.0;
    int c;
    for (c = 0; c < GOLDEN_NV + GOLDEN_NG; c++) {
        sum += fabs(q->mult[c]);
    }
    return isfinite(sum);
}

static golden_status_t qp_solve(golden_solver_t *s)
{
    golden_qp_t *q = &s->qp;
    golden_status_t status = q->factorized ? qp_check_bounds(q) : GOLDEN_NUMERICAL_FAILURE;
    q->iterations = q->changes = q->refinements = q->dropped = q->relaxed = q->exact = 0;
    memset(q->certificate, 0, sizeof q->certificate);
    if (status != GOLDEN_OK) {
        return qp_fail(q, status);
    }
    if (q->factorized == 2) {
        qp_enter(s);
        q->factorized = 1;
    }
    qp_take_bounds(s);
    q->changes = 0;
    status = qp_iterate(s, GOLDEN_QP_MAX_ITERATIONS);
    q->exact = 1;
    if (status != GOLDEN_OK) { /* a breakdown that the interior point method does not cure: no minimum, or bad numbers */
        const golden_status_t next = qp_fall_back(s);
        status = (status == GOLDEN_NUMERICAL_FAILURE && next == GOLDEN_ITERATION_LIMIT) ? status : next;
        status = qp_has_multipliers(q) ? status : GOLDEN_NUMERICAL_FAILURE;
    }
    if (q->exact && status == GOLDEN_OK) {
        qp_finish(q);
    }
    return status == GOLDEN_NUMERICAL_FAILURE ? qp_fail(q, status) : status;
}
