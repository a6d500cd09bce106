/* The preconditioner is a factorisation of H + shift scale^-2 over the free variables, from the last node to the first.
 * A_k = L_k' D_k L_k with unit lower triangular L_k, so that the controls of a node are eliminated before its states,
 * W_k = L_{k+1}^{-T} B_k, and A_k loses W_k' D_{k+1}^{-1} W_k. The diagonal of a block holds D_k^{-1}; entries above it
 * have no meaning. */

/* to = factor from, for a row of LDZ entries; entries where `open` is 0 become 0. */
static inline void mask_row(real_t *to, real_t factor, const real_t *from, const real_t *open)
{
    for (int j = 0; j < LDZ; j += 4) {
        real_t t[4];
        for (int i = 0; i < 4; i++) {
            t[i] = factor * from[j + i] * open[j + i];
        }
        for (int i = 0; i < 4; i++) {
            to[j + i] = t[i];
        }
    }
}

/* Computes W_k and subtracts: A_k -= W_k' D_{k+1}^{-1} W_k. */
static void eliminate_successor(auglag_t *a, int k)
{
    real_t(*L)[LDZ] = a->L[k + 1], (*W)[LDZ] = a->W[k], scaled[NX][LDZ];
    for (int l = 0; l < NX; l++) {
        mask_row(W[l], a->open[k + 1][l], a->B[k][l], a->open[k]);
    }
    for (int l = NX - 1; l >= 0; l--) {
        mask_row(scaled[l], -L[l][l], W[l], a->open[k]);
        for (int p = 0; p < l; p++) {
            riccati_add(W[p], -L[l][p], W[l], LDZ);
        }
    }
    for (int i = 0; i < LDZ; i += 4) {
        riccati_rows(a->L[k][i], LDZ, scaled[0] + i, LDZ, W[0], LDZ, NX, i + 4);
    }
}

/* A_k = L_k' D_k L_k in place; rows of fixed variables are those of the identity. Returns 0 if a pivot is not
 * positive. */
static int factorize_block(auglag_t *a, int k)
{
    real_t(*A)[LDZ] = a->L[k];
    const real_t *open = a->open[k];
    for (int l = NZ - 1; l >= 0; l--) {
        const real_t pivot = A[l][l];
        if (open[l] <= R(0)) {
            (void)memset(A[l], 0, sizeof A[l]);
            A[l][l] = R(1);
            continue;
        }
        if (!(pivot > TOL_UNIT * a->largest * variable_weight[l]) || !(pivot < INF)) {
            return 0;
        }
        const real_t inverse = R(1) / pivot;
        mask_row(A[l], inverse, A[l], open);
        for (int p = 0; p < l; p++) {
            riccati_add(A[p], -pivot * A[l][p], A[l], p / 4 * 4 + 4);
        }
        A[l][l] = inverse;
    }
    return 1;
}

/* Factorises the blocks `from` to 0; the blocks after `from` are still valid. Returns 0 if a pivot is not positive. */
static int factorize_with(solver_t *s, real_t shift, int from)
{
    auglag_t *a = &s->auglag;
    for (int k = from; k >= 0; k--) { /* at most N + 1 passes */
        (void)memcpy(a->L[k], a->H[k], sizeof a->L[k]);
        for (int i = 0; i < NZ; i++) {
            a->L[k][i][i] += shift * variable_weight[i];
        }
        if (k < N) {
            eliminate_successor(a, k);
        }
        if (!factorize_block(a, k)) {
            return 0;
        }
    }
    return 1;
}

/* Returns the largest diagonal entry of the Hessian in scaled variables. */
static real_t largest_curvature(const auglag_t *a)
{
    real_t largest = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t scaled = FABS(a->H[k][i][i]) * variable_scale[i] * variable_scale[i];
            largest = (scaled > largest) ? scaled : largest;
        }
    }
    return largest;
}

/* Factorises after the face has changed at the nodes up to `from`, with the shift of the last factorisation or, if that
 * fails, with larger ones, at most MAX_SHIFTS in an iteration. Returns 0 if none succeeds. */
static int factorize(solver_t *s, int from)
{
    auglag_t *a = &s->auglag;
    for (int last = from; a->shifts <= MAX_SHIFTS; last = N) { /* at most MAX_SHIFTS + 1 passes */
        if (factorize_with(s, a->proximal + a->shift, last)) {
            return 1;
        }
        s->stats.shifts++;
        a->shifts++;
        a->shift = (a->shifts == 1) ? FACTOR_AUGMENTED_FIRST_SHIFT * a->bend : FACTOR_AUGMENTED_NEXT_SHIFT * a->shift;
    }
    return 0;
}

/* Forward pass: y := L_k^{-T} y. */
static void eliminate_node(const auglag_t *a, int k, real_t *y)
{
    for (int l = NZ - 1; l > 0; l--) {
        for (int i = 0; i < l; i++) {
            y[i] -= a->L[k][l][i] * y[l];
        }
    }
}

/* Backward pass: y := L_k^{-1} D_k^{-1} y; 0 for fixed variables. */
static void substitute_node(const auglag_t *a, int k, real_t *y)
{
    for (int l = 0; l < NZ; l++) {
        real_t sum = y[l] * a->L[k][l][l];
        for (int i = 0; i < l; i++) {
            sum -= a->L[k][l][i] * y[i];
        }
        y[l] = a->open[k][l] * sum;
    }
}

/* y = (preconditioner) y over the free variables, by the factors or, where there are none, as scale^2 / largest y. */
static void precondition(const auglag_t *a, real_t (*y)[LDZ])
{
    if (!a->factorized) {
        for (int k = 0; k <= N; k++) {
            for (int l = 0; l < NZ; l++) {
                y[k][l] *= a->open[k][l] * variable_scale[l] * variable_scale[l] / a->largest;
            }
        }
        return;
    }
    eliminate_node(a, N, y[N]);
    for (int k = N - 1; k >= 0; k--) {
        real_t force[NX];
        for (int l = 0; l < NX; l++) {
            force[l] = -y[k + 1][l] * a->L[k + 1][l][l];
        }
        add_panels(y[k], force, a->W[k][0], NX);
        eliminate_node(a, k, y[k]);
    }
    substitute_node(a, 0, y[0]);
    for (int k = 0; k < N; k++) {
        for (int l = 0; l < NX; l++) {
            y[k + 1][l] -= riccati_dot(a->W[k][l], y[k], LDZ);
        }
        substitute_node(a, k + 1, y[k + 1]);
    }
}
