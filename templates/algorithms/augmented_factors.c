/* Contract of this part: the preconditioner, a block Cholesky factorisation of H + (r + shift) scale^-2 over the free
 * variables, from the last node to the first. A_k = L_k' L_k, so that the controls of a node are eliminated before its
 * states, W_k = L_{k+1}^{-T} (coupling of x_{k+1} with node k), and A_k loses W_k' W_k. */

/* The block of node k with the shift, before its successor is eliminated: Q_k + rho + S_k' rho S_k. */
static void fill_block(solver_t *s, int k, real_t shift)
{
    auglag_t *a = &s->auglag;
    real_t(*A)[NZ] = a->L[k];
    memcpy(A, a->Q[k], sizeof a->L[k]);
    for (int i = 0; i < NZ; i++) {
        A[i][i] += shift / (variable_scale[i] * variable_scale[i]);
    }
    for (int i = 0; i < NX; i++) {
        A[i][i] += (k > 0) ? gap_weight(s, i) : start_weight(s, i);
    }
    for (int l = 0; k < N && l < NX; l++) {
        const real_t *row = s->node[k].S[l];
        for (int i = 0; i < NZ; i++) {
            const real_t factor = gap_weight(s, l) * row[i];
            for (int j = 0; j < NZ; j++) {
                A[i][j] += factor * row[j];
            }
        }
    }
}

/* W_k, and A_k -= W_k' W_k. */
static void eliminate_successor(solver_t *s, int k)
{
    auglag_t *a = &s->auglag;
    real_t(*L)[NZ] = a->L[k + 1], (*W)[NZ] = a->W[k];
    for (int l = 0; l < NX; l++) {
        const real_t weight = -gap_weight(s, l) * a->open[k + 1][l];
        for (int i = 0; i < NZ; i++) {
            W[l][i] = weight * a->open[k][i] * s->node[k].S[l][i];
        }
    }
    for (int l = NX - 1; l >= 0; l--) {
        for (int i = 0; i < NZ; i++) {
            W[l][i] *= L[l][l];
        }
        for (int p = 0; p < l; p++) {
            for (int i = 0; i < NZ; i++) {
                W[p][i] -= L[l][p] * W[l][i];
            }
        }
        for (int i = 0; i < NZ; i++) {
            for (int j = 0; j < NZ; j++) {
                a->L[k][i][j] -= W[l][i] * W[l][j];
            }
        }
    }
}

/* A_k = L' L in place, the inverse of the diagonal on the diagonal; rows of fixed variables are those of the identity.
 * Returns 0 if a pivot is not positive. */
static int factorize_block(solver_t *s, int k)
{
    auglag_t *a = &s->auglag;
    real_t(*A)[NZ] = a->L[k];
    for (int l = NZ - 1; l >= 0; l--) {
        const real_t pivot = A[l][l];
        if (a->open[k][l] <= R(0)) {
            memset(A[l], 0, sizeof A[l]);
            A[l][l] = R(1);
            continue;
        }
        if (!(pivot > TOL_UNIT * a->largest / (variable_scale[l] * variable_scale[l])) || !(pivot < INF)) {
            return 0;
        }
        A[l][l] = R(1) / SQRT(pivot);
        for (int i = 0; i < l; i++) {
            A[l][i] *= a->open[k][i] * A[l][l];
        }
        for (int p = 0; p < l; p++) {
            for (int i = 0; i <= p; i++) {
                A[p][i] -= A[l][p] * A[l][i];
            }
        }
    }
    return 1;
}

/* All blocks. Returns 0 if a pivot is not positive. */
static int factorize_with(solver_t *s, real_t shift)
{
    for (int k = N; k >= 0; k--) {
        fill_block(s, k, shift);
        if (k < N) {
            eliminate_successor(s, k);
        }
        if (!factorize_block(s, k)) {
            return 0;
        }
    }
    return 1;
}

/* Largest diagonal entry of the Hessian in scaled variables. */
static real_t largest_curvature(const solver_t *s)
{
    const auglag_t *a = &s->auglag;
    real_t largest = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t gap = (i < NX) ? gap_weight(s, i) : R(0);
            const real_t scaled = (FABS(a->Q[k][i][i]) + gap) * variable_scale[i] * variable_scale[i];
            largest = (scaled > largest) ? scaled : largest;
        }
    }
    return largest;
}

/* Factorises with the smallest of MAX_SHIFTS + 1 shifts that succeeds. Returns 0 if none does. */
static int factorize(solver_t *s)
{
    auglag_t *a = &s->auglag;
    real_t shift = R(0);
    for (int trial = 0; trial <= MAX_SHIFTS; trial++) {
        if (factorize_with(s, a->proximal + shift)) {
            return 1;
        }
        s->stats.shifts++;
        shift = (trial == 0) ? R(0.01) * a->bend : R(10) * shift;
    }
    return 0;
}

/* Forward pass: b_k := L_k^{-T} b_k and its effect on the node before. */
static void eliminate_node(const auglag_t *a, int k, real_t *y)
{
    for (int l = NZ - 1; l >= 0; l--) {
        const real_t value = y[l] * a->L[k][l][l];
        y[l] = value;
        for (int i = 0; i < l; i++) {
            y[i] -= a->L[k][l][i] * value;
        }
    }
}

/* Backward pass: solves L_k y = b. */
static void substitute_node(const auglag_t *a, int k, real_t *y)
{
    for (int l = 0; l < NZ; l++) {
        real_t sum = y[l];
        for (int i = 0; i < l; i++) {
            sum -= a->L[k][l][i] * y[i];
        }
        y[l] = a->open[k][l] * sum * a->L[k][l][l];
    }
}

/* y = (preconditioner) y over the free variables: the factors or, where there are none, scale^2 / largest. */
static void precondition(const auglag_t *a, real_t (*y)[NZ])
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
        for (int l = 0; l < NX; l++) {
            const real_t value = y[k + 1][l];
            for (int i = 0; i < NZ; i++) {
                y[k][i] -= a->W[k][l][i] * value;
            }
        }
        eliminate_node(a, k, y[k]);
    }
    substitute_node(a, 0, y[0]);
    for (int k = 0; k < N; k++) {
        for (int l = 0; l < NX; l++) {
            real_t sum = R(0);
            for (int i = 0; i < NZ; i++) {
                sum += a->W[k][l][i] * y[k][i];
            }
            y[k + 1][l] -= sum;
        }
        substitute_node(a, k + 1, y[k + 1]);
    }
}
