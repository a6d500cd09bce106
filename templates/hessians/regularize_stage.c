/* Replaces every block by V f(Lambda) V', f = max(|Lambda|, floor) if MIRROR, else max(Lambda, floor); the floor
 * is relative to the largest |Lambda| of the node. Nodes whose blocks are safely positive definite keep them.
 * Irreducible diagonal blocks are decomposed one after the other, each for LANES nodes at once. */

#include "generated/hessian_blocks.c"

/* norm[l] = largest |entry| in the lower triangle of matrix l, n x n; inverse[l] = 1 / norm[l], or 0 for a zero
 * matrix. */
static void block_norms(const real_t *Q, int stride, int n, int nodes, real_t *norm, real_t *inverse)
{
    int l, i, j;
    for (l = 0; l < LANES; l++) {
        const int at = ((l < nodes) ? l : nodes - 1) * stride;
        const real_t *q = Q + at;
        real_t largest = R(0);
        for (i = 0; i < n; i++) {
            for (j = 0; j <= i; j++) {
                const real_t a = FABS(q[i * n + j]);
                largest = (a > largest) ? a : largest;
            }
        }
        norm[l] = largest;
        inverse[l] = (largest > R(0)) ? R(1) / largest : R(0);
    }
}

/* A = lower triangle of one block of every lane, scaled to entries of at most 1 in magnitude. */
static void gather_block(
    real_t (*A)[LANES], const real_t *Q, int stride, int ld, int nodes, const int *row, int n, const real_t *inverse)
{
    int l, i, j;
    for (l = 0; l < LANES; l++) {
        const int at = ((l < nodes) ? l : nodes - 1) * stride;
        const real_t *q = Q + at;
        for (i = 0; i < n; i++) {
            for (j = 0; j <= i; j++) {
                A[i * n + j][l] = q[row[i] * ld + row[j]] * inverse[l];
            }
        }
    }
}

/* Computes entry (i, j) of A - shift I = L D L'; W holds L D in its lower triangle and L above its diagonal. */
static inline void test_entry(real_t (*A)[LANES], real_t (*W)[LANES], int n, int i, int j, const real_t *shift)
{
    real_t sum[LANES];
    int k, l;
    for (l = 0; l < LANES; l++) {
        sum[l] = A[i * n + j][l] - ((i == j) ? shift[l] : R(0));
    }
    for (k = 0; k < j; k++) {
        for (l = 0; l < LANES; l++) {
            sum[l] -= W[i * n + k][l] * W[k * n + j][l];
        }
    }
    for (l = 0; l < LANES; l++) {
        W[i * n + j][l] = sum[l];
    }
}

/* keep[l] = 0 if a pivot of A - shift I (lower triangle) is not positive; L D L' is stored in W. */
static void test_block(real_t (*A)[LANES], real_t (*W)[LANES], int n, const real_t *shift, int *keep)
{
    int i, j, l;
    for (i = 0; i < n; i++) {
        for (j = 0; j <= i; j++) {
            test_entry(A, W, n, i, j, shift);
            if (j < i) {
                for (l = 0; l < LANES; l++) {
                    W[j * n + i][l] = W[i * n + j][l] / W[j * n + j][l];
                }
            }
        }
        for (l = 0; l < LANES; l++) {
            keep[l] &= W[i * n + i][l] > R(0);
        }
    }
}

/* A = V' f(Lambda) V, lower triangle; on entry the diagonal of A holds Lambda. */
static void rebuild_block(real_t (*A)[LANES], real_t (*V)[LANES], int n, const real_t *floor_value)
{
    real_t value[NZ][LANES];
    int i, j, k, l;
    for (k = 0; k < n; k++) {
        for (l = 0; l < LANES; l++) {
            const real_t a = A[k * n + k][l];
            const real_t b = (MIRROR && a < R(0)) ? -a : a;
            value[k][l] = (b < floor_value[l]) ? floor_value[l] : b;
        }
    }
    for (i = 0; i < n; i++) {
        for (j = 0; j <= i; j++) {
            real_t sum[LANES] = {0};
            for (k = 0; k < n; k++) {
                for (l = 0; l < LANES; l++) {
                    sum[l] += value[k][l] * V[k * n + i][l] * V[k * n + j][l];
                }
            }
            for (l = 0; l < LANES; l++) {
                A[i * n + j][l] = sum[l];
            }
        }
    }
}

/* Writes the regularised blocks back to the nodes that do not keep theirs. */
static void scatter_block(real_t (*A)[LANES], real_t *Q, int stride, int ld, int nodes, const int *row, int n,
    const real_t *norm, const int *keep)
{
    int l, i, j;
    for (l = 0; l < nodes; l++) {
        const int at = l * stride;
        real_t *q = Q + at;
        for (i = 0; i < n && !keep[l]; i++) {
            for (j = 0; j <= i; j++) {
                q[row[i] * ld + row[j]] = A[i * n + j][l] * norm[l];
            }
        }
    }
}

/* Computes floor_value of every lane from the eigenvalues of all its blocks. */
static void block_floors(real_t (*A)[LANES], const int *first, int blocks, real_t *floor_value)
{
    real_t largest[LANES] = {0};
    int b, i, l, at = 0;
    for (b = 0; b < blocks; b++) {
        const int n = first[b + 1] - first[b];
        for (i = 0; i < n; i++) {
            for (l = 0; l < LANES; l++) {
                const real_t a = FABS(A[at + i * n + i][l]);
                largest[l] = (a > largest[l]) ? a : largest[l];
            }
        }
        at += n * n;
    }
    for (l = 0; l < LANES; l++) {
        floor_value[l] = FACTOR_HESSIAN_FLOOR * largest[l];
    }
}

/* Regularises up to LANES matrices of ld rows, `stride` numbers apart; scale[l] is the largest |entry| of matrix l. */
static void regularize_batch(
    hessian_t *h, real_t *Q, int stride, int ld, int nodes, const int *row, const int *first, int blocks, real_t *scale)
{
    real_t norm[LANES], factor[LANES], shift[LANES];
    int keep[LANES], b, l, at, kept = 1;
    block_norms(Q, stride, ld, nodes, norm, factor);
    for (l = 0; l < LANES; l++) {
        keep[l] = 1;
        shift[l] = FACTOR_HESSIAN_FLOOR * (real_t)ld;
    }
    for (b = 0, at = 0; b < blocks; b++) {
        const int n = first[b + 1] - first[b];
        gather_block(h->A + at, Q, stride, ld, nodes, row + first[b], n, factor);
        test_block(h->A + at, h->V + at, n, shift, keep);
        at += n * n;
    }
    for (l = 0; l < LANES; l++) {
        factor[l] = FACTOR_HESSIAN_FLOOR;
        kept &= keep[l];
    }
    for (b = 0, at = 0; b < blocks && !kept; b++) {
        const int n = first[b + 1] - first[b];
        jacobi(h->A + at, h->V + at, n);
        at += n * n;
    }
    if (!kept) {
        block_floors(h->A, first, blocks, factor);
    }
    for (b = 0, at = 0; b < blocks; b++) {
        const int n = first[b + 1] - first[b];
        if (!kept) {
            rebuild_block(h->A + at, h->V + at, n, factor);
        }
        scatter_block(h->A + at, Q, stride, ld, nodes, row + first[b], n, norm, keep);
        at += n * n;
    }
    for (l = 0; l < nodes; l++) {
        scale[l] = norm[l];
    }
}

/* Regularises a zero matrix with the scale of the matrix that has the largest entry. */
static void regularize_zero(real_t *Q, int ld, real_t scale, real_t largest)
{
    int i;
    for (i = 0; i < ld && scale <= R(0); i++) {
        Q[i * ld + i] += FACTOR_HESSIAN_FLOOR * ((largest > R(0)) ? largest : R(1));
    }
}

static void regularize_stages(solver_t *s)
{
    hessian_t *h = &s->hessian;
    real_t largest = R(0);
    int k;
    for (k = 0; k < N; k += LANES) {
        const int nodes = (N - k < LANES) ? N - k : LANES;
        regularize_batch(h, &h->Q[k][0][0], NZ * NZ, NZ, nodes, Q_block_row, Q_block_first, Q_BLOCKS, &h->scale[k]);
    }
    regularize_batch(h, &h->Q_N[0][0], 0, NX, 1, Q_N_block_row, Q_N_block_first, Q_N_BLOCKS, &h->scale[N]);
    for (k = 0; k <= N; k++) {
        largest = (h->scale[k] > largest) ? h->scale[k] : largest;
    }
    for (k = 0; k < N; k++) {
        regularize_zero(&h->Q[k][0][0], NZ, h->scale[k], largest);
    }
    regularize_zero(&h->Q_N[0][0], NX, h->scale[N], largest);
}
