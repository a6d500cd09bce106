/* Component "condensing". Contract:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: all computations that depend neither on xhat nor on the final bounds, including the
 *                      factorisation of the QP
 *   condense_gradient  called if only gradients of the nodes have changed
 *   condense_rows      called if gaps b and values of the rows have changed, but no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_shift     shifts the predicted working set of the controls by one interval
 *   condense_shift_rows  row m takes the predicted side of row source[m]
 * Here: blocks of BLOCK intervals become one stage. All states of a block but the first are eliminated,
 *     dx_{kB+j} = G_j (dx_kB, du_kB .. du_{kB+B-1}) + c_j,   [A B] = G_B,  b = c_B,
 *     Q = sum_j Z_j' Q_{kB+j} Z_j,   g = sum_j Z_j' (g_{kB+j} + Q_{kB+j} (c_j, 0)),
 *     Z_j = [G_j; selection of du_{kB+j}].
 * Controls beyond the horizon are padding with Hessian 1, no gradient and no bounds, so that they remain 0. Data that a
 * QP solver on stages reads: stage_S = [A B], stage_b, stage_g, stage_Q, stage_Q_N (lower triangles), gradients and
 * constants of rows, and the tables stage_first, stage_of_row, stage_state. */

static void qp_init(solver_t *s);
static status_t qp_factorize(solver_t *s);
static void qp_gradient(solver_t *s);
static status_t qp_solve(solver_t *s);
static real_t qp_multiplier(const solver_t *s, int m);

static inline real_t (*stage_S(solver_t *s, int k))[NZS]
{
    return s->block[k].S;
}

static inline real_t *stage_b(solver_t *s, int k)
{
    return s->block[k].b;
}

static inline real_t *stage_g(solver_t *s, int k)
{
    return (k < NS) ? s->block[k].g : s->blocks.g_N;
}

static inline real_t (*stage_Q(solver_t *s, int k))[NZS]
{
    return s->block[k].Q;
}

/* The Hessian of the last stage, lower triangle. */
static inline real_t (*stage_Q_N(solver_t *s))[NXS]
{
    return s->blocks.Q_N;
}

/* Gradient of row m, which is no bound of a control, in the variables of its stage. */
static inline const real_t *stage_row(const solver_t *s, int m)
{
    return s->blocks.J[m];
}

/* Constant part of row m in the variables of its stage. */
static inline real_t stage_row_value(const solver_t *s, int m)
{
    return s->blocks.v[m];
}

static void condense_init(solver_t *s)
{
    int k, j;
    for (k = N * NU; k < NV; k++) {
        j = NXS + k - (NS - 1) * NUS;
        s->block[NS - 1].Q[j][j] = R(1);
    }
    for (k = 0; k < NS; k++) {
        for (j = NX; j < NXS; j++) {
            s->block[k].S[j][j] = R(1);
        }
    }
    for (k = 0; k < N; k += BLOCK) {
        for (j = 0; j < NX; j++) {
            s->blocks.G[k][j][j] = R(1);
        }
    }
    qp_init(s);
    for (k = N * NU; k < NV; k++) {
        s->qp.lower[k] = -INF;
        s->qp.upper[k] = INF;
    }
}

#include "condensing/embed_stages.c"

/* G_{j+1} = [A G_j, B at du_j]; the columns of later controls remain 0. */
static void condense_forward(const node_t *node, real_t (*G)[NZS], real_t (*next)[NZS], int j)
{
    const int width = NXS + j * NU;
    int i, l, c;
    for (i = 0; i < NX; i++) {
        for (c = 0; c < width; c++) {
            next[i][c] = R(0);
        }
        for (l = 0; l < NX; l++) {
            const real_t a = node->S[i][l];
            for (c = 0; c < width; c++) {
                next[i][c] += a * G[l][c];
            }
        }
        for (c = 0; c < NU; c++) {
            next[i][width + c] = node->S[i][NX + c];
        }
        for (c = width + NU; c < NZS; c++) {
            next[i][c] = R(0);
        }
    }
}

/* Q += Z_j' Q_k Z_j, lower triangle, with T = Q_k Z_j on the nonzero columns. */
static void condense_hessian(solver_t *s, block_t *block, real_t (*Q)[NZ], int node, int j)
{
    const int width = NXS + (j + 1) * NU;
    real_t(*Z)[NZS] = s->blocks.Z;
    real_t T[NZS];
    int i, l, c, r;
    (void)memcpy(Z, s->blocks.G[node], sizeof s->blocks.G[node]);
    (void)memset(Z[NX], 0, sizeof Z[0] * NU);
    for (i = 0; i < NU; i++) {
        Z[NX + i][NXS + j * NU + i] = R(1);
    }
    for (i = 0; i < NZ; i++) {
        (void)memset(T, 0, sizeof T);
        for (l = 0; l < NZ; l++) {
            const real_t q = (l <= i) ? Q[i][l] : Q[l][i];
            for (c = 0; c < width; c++) {
                T[c] += q * Z[l][c];
            }
        }
        for (r = 0; r < width; r++) {
            const real_t z = Z[i][r];
            for (c = 0; c <= r; c++) {
                block->Q[r][c] += z * T[c];
            }
        }
    }
}

/* Gradients of the rows of a node in the variables of its block: J_x G_j, and J_u at du_j; J_x at the terminal node. */
static void condense_block_rows(solver_t *s, int node)
{
    const int j = node - node / BLOCK * BLOCK; /* index of the node in its block */
    int i, c;
    for (int m = row_first[node]; m < row_first[node + 1]; m++) {
        real_t J[NZ];
        real_t *row = s->blocks.J[m];
        copy_row_gradient(s, m, J);
        (void)memset(row, 0, sizeof s->blocks.J[m]);
        if (node == N) {
            (void)memcpy(row, J, sizeof row[0] * NX);
            if (row_is_coupled(m)) {
                /* the stages have copies of what is free at the start: z = (dx, copies, du) */
                for (int l = NX; l < NXS; l++) {
                    row[l] = s->coupled.J_0[row_index(m)][copied_state[l - NX]];
                }
            }
            continue;
        }
        for (i = 0; i < NX; i++) {
            for (c = 0; c < NXS + j * NU; c++) {
                row[c] += J[i] * s->blocks.G[node][i][c];
            }
        }
        for (i = 0; i < NU; i++) {
            row[NXS + j * NU + i] = J[NX + i];
        }
    }
}

/* Values of the rows: their values at the nodes plus J_x c_j. */
static void condense_row_values(solver_t *s)
{
    int i;
    for (int m = 0; m < NG; m++) {
        real_t J[NZ];
        real_t value = row_constant(s, m);
        copy_row_gradient(s, m, J);
        if (row_node(m) < N) {
            const real_t *c = s->blocks.c[row_node(m)];
            for (i = 0; i < NX; i++) {
                value += J[i] * c[i];
            }
        }
        s->blocks.v[m] = value;
    }
}

/* All blocks: [A B] and Hessian. */
static void condense_matrices(solver_t *s)
{
    int k, j, r;
    for (k = 0; k < NS; k++) {
        block_t *block = &s->block[k];
        const int n = (k < NS - 1) ? BLOCK : N - k * BLOCK;
        for (r = 0; r < NXS + n * NU; r++) {
            (void)memset(block->Q[r], 0, sizeof block->Q[r]);
        }
        for (j = 0; j < n; j++) {
            const int node = k * BLOCK + j;
            if (CURVED) {
                condense_hessian(s, block, s->curved.in_solve ? s->curved.Q[node] : HESSIAN(s, node), node, j);
            } else {
                condense_hessian(s, block, HESSIAN(s, node), node, j);
            }
            condense_forward(&s->node[node], s->blocks.G[node], (j + 1 < n) ? s->blocks.G[node + 1] : block->S, j);
        }
    }
    for (r = 0; r < NX; r++) {
        if (CURVED) {
            (void)memcpy(
                s->blocks.Q_N[r], s->curved.in_solve ? s->curved.Q_N[r] : s->hessian.Q_N[r], sizeof s->hessian.Q_N[0]);
        } else {
            (void)memcpy(s->blocks.Q_N[r], s->hessian.Q_N[r], sizeof s->hessian.Q_N[0]);
        }
    }
}

/* Gaps and gradients: c_0 = 0, c_{j+1} = A c_j + b;  w = 0 at the end of a block;
 * g of du_j = r + B' w, w <- q + Q (c_j, 0) + A' w. */
static void condense_vectors(solver_t *s)
{
    const real_t none[NU] = {0};
    real_t w[NZ];
    int k, j, i;
    for (k = 0; k < NS; k++) {
        block_t *block = &s->block[k];
        const int n = (k < NS - 1) ? BLOCK : N - k * BLOCK;
        for (j = 0; j < n; j++) {
            real_t *next = (j + 1 < n) ? s->blocks.c[k * BLOCK + j + 1] : block->b;
            STATE_STEP(&s->node[k * BLOCK + j], s->blocks.c[k * BLOCK + j], none, next);
        }
        (void)memset(w, 0, sizeof w);
        for (j = n - 1; j >= 0; j--) {
            const int node = k * BLOCK + j;
            ADJOINT_STEP(&s->node[node], HESSIAN(s, node), s->blocks.c[node], none, w);
            if (CURVED) {
                if (s->curved.in_solve) {
                    add_curvature(s, node, s->blocks.c[node], none, w);
                }
            }
            for (i = 0; i < NU; i++) {
                block->g[NXS + j * NU + i] = w[NX + i];
            }
        }
        (void)memcpy(block->g, w, sizeof w[0] * NX);
    }
    (void)memcpy(s->blocks.g_N, s->terminal.g, sizeof s->terminal.g);
    condense_row_values(s);
}

static status_t condense_prepare(solver_t *s)
{
    condense_matrices(s);
    for (int k = 0; k <= N; ++k) {
        condense_block_rows(s, k);
    }
    condense_vectors(s);
    (void)memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return qp_factorize(s);
}

static void condense_gradient(solver_t *s)
{
    condense_vectors(s);
    qp_gradient(s);
}

static void condense_rows(solver_t *s)
{
    condense_vectors(s);
    qp_gradient(s);
}

static void condense_expand(solver_t *s)
{
    int k;
    (void)memcpy(s->step.du, s->qp.z, sizeof s->step.du);
    (void)memcpy(s->step.mult_u, s->qp.mult, sizeof s->step.mult_u);
    for (int m = 0; m < NG; m++) {
        s->step.mult[m] = qp_multiplier(s, m);
    }
    (void)memcpy(s->step.dx[0], s->qp.x[0], sizeof s->step.dx[0]);
    for (k = 0; k < N; k++) {
        STATE_STEP(&s->node[k], s->step.dx[k], s->step.du[k], s->step.dx[k + 1]);
    }
}

#include "condensing/solve_stages.c"

static void qp_shift_controls(solver_t *s, int n);
static void qp_shift_rows(solver_t *s, const int *source);

#include "condensing/shift_stages.c"
