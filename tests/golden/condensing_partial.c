/* ==== condensing: partial ================================================================================= */

/* Seam "condensing", contract: see the functions condense_init, _prepare, _gradient, _rows, _solve, _shift:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: everything that needs neither xhat nor the final bounds, the QP's factorisation included
 *   condense_gradient  gradients of the nodes have changed, nothing else
 *   condense_rows      gaps b and values of the rows have changed, no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_shift     the predicted working set moves by one interval (its own template: for plans that do)
 * Here: blocks of BLOCK intervals become one stage: all states but the first of a block are eliminated,
 *     dx_{kB+j} = G_j (dx_kB, du_kB .. du_{kB+B-1}) + c_j,   [A B] = G_B,  b = c_B,
 *     Q = sum_j Z_j' Q_{kB+j} Z_j,   g = sum_j Z_j' (g_{kB+j} + Q_{kB+j} (c_j, 0)),   Z_j = [G_j; selection of du_{kB+j}].
 * Where there are coupled rows, the free components of x_0 are states of the stages besides dx, as copies that do not move:
 * z = (dx, copies, du).
 * Controls beyond the horizon are padded: Hessian 1, no gradient, no bounds, so they stay 0.
 * What a QP solver on stages reads: stage_S = [A B], stage_b, stage_g, stage_Q, stage_Q_N (lower triangles), stage_row (gradient
 * of a general row), tables stage_first, stage_of_row, stage_state. */

static void qp_init(golden_solver_t *s);
static golden_status_t qp_factorize(golden_solver_t *s);
static void qp_gradient(golden_solver_t *s);
static golden_status_t qp_solve(golden_solver_t *s);

static inline golden_real (*stage_S(golden_solver_t *s, int k))[GOLDEN_NZS]
{
    return s->block[k].S;
}

static inline golden_real *stage_b(golden_solver_t *s, int k)
{
    return s->block[k].b;
}

static inline golden_real *stage_g(golden_solver_t *s, int k)
{
    return (k < GOLDEN_NS) ? s->block[k].g : s->blocks.g_N;
}

static inline golden_real (*stage_Q(golden_solver_t *s, int k))[GOLDEN_NZS]
{
    return s->block[k].Q;
}

/* The Hessian of the last stage, lower triangle. */
static inline golden_real (*stage_Q_N(golden_solver_t *s))[GOLDEN_NXS]
{
    return s->blocks.Q_N;
}

/* Gradient of the general or coupled row m in the variables of its stage. */
static inline const golden_real *stage_row(const golden_solver_t *s, int m)
{
    return s->blocks.J[m];
}

/* Constant part of row m in the variables of its stage. */
static inline golden_real stage_row_value(const golden_solver_t *s, int m)
{
    return s->blocks.v[m];
}

static void condense_init(golden_solver_t *s)
{
    int k, j;
    for (k = GOLDEN_N * GOLDEN_NU; k < GOLDEN_NV; k++) {
        j = GOLDEN_NXS + k - (GOLDEN_NS - 1) * GOLDEN_NUS;
        s->block[GOLDEN_NS - 1].Q[j][j] = 1.0;
    }
    for (k = 0; k < GOLDEN_NS; k++) {
        for (j = GOLDEN_NX; j < GOLDEN_NXS; j++) {
            s->block[k].S[j][j] = 1.0;
        }
    }
    for (k = 0; k < GOLDEN_N; k += GOLDEN_BLOCK) {
        for (j = 0; j < GOLDEN_NX; j++) {
            s->blocks.G[k][j][j] = 1.0;
        }
    }
    qp_init(s);
    for (k = GOLDEN_N * GOLDEN_NU; k < GOLDEN_NV; k++) {
        s->qp.lower[k] = -(golden_real)INFINITY;
        s->qp.upper[k] = (golden_real)INFINITY;
    }
}

/* Bounds of the controls and rows relative to the present iterate, penalties; of J_0 dx_0 of a coupled row what is known. */
static void condense_embed(golden_solver_t *s)
{
    int k, j, m;
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            s->qp.lower[k * GOLDEN_NU + j] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[k * GOLDEN_NU + j] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        golden_real value = stage_row_value(s, m);
        for (j = 0; row_kind[m] == 2 && j < GOLDEN_NX; j++) {
            value += is_free[j] ? 0.0 : s->coupled.J_0[row_index[m]][j] * s->step.dx[0][j];
        }
        s->qp.lower[GOLDEN_NV + m] = row_lower(s, m) - value;
        s->qp.upper[GOLDEN_NV + m] = row_upper(s, m) - value;
        s->qp.penalty[m] = row_penalty(s, m);
        s->qp.curvature[m] = row_curvature(m);
    }
}

/* G_{j+1} = A G_j, B at du_j; the columns of later controls stay 0. */
static void condense_forward(const golden_node_t *node, golden_real (*G)[GOLDEN_NZS], golden_real (*next)[GOLDEN_NZS], int j)
{
    const int width = GOLDEN_NXS + j * GOLDEN_NU;
    int i, l, c;
    for (i = 0; i < GOLDEN_NX; i++) {
        for (c = 0; c < width; c++) {
            next[i][c] = 0.0;
        }
        for (l = 0; l < GOLDEN_NX; l++) {
            const golden_real a = node->S[i][l];
            for (c = 0; c < width; c++) {
                next[i][c] += a * G[l][c];
            }
        }
        for (c = 0; c < GOLDEN_NU; c++) {
            next[i][width + c] = node->S[i][GOLDEN_NX + c];
        }
        for (c = width + GOLDEN_NU; c < GOLDEN_NZS; c++) {
            next[i][c] = 0.0;
        }
    }
}

/* Q += Z_j' Q_k Z_j, lower triangle; T = Q_k Z_j on the columns that are not 0. */
static void condense_hessian(golden_solver_t *s, golden_block_t *block, golden_real (*Q)[GOLDEN_NZ], int node, int j)
{
    const int width = GOLDEN_NXS + (j + 1) * GOLDEN_NU;
    golden_real (*Z)[GOLDEN_NZS] = s->blocks.Z;
    golden_real T[GOLDEN_NZS];
    int i, l, c, r;
    memcpy(Z, s->blocks.G[node], sizeof s->blocks.G[node]);
    memset(Z[GOLDEN_NX], 0, sizeof Z[0] * GOLDEN_NU);
    for (i = 0; i < GOLDEN_NU; i++) {
        Z[GOLDEN_NX + i][GOLDEN_NXS + j * GOLDEN_NU + i] = 1.0;
    }
    for (i = 0; i < GOLDEN_NZ; i++) {
        memset(T, 0, sizeof T);
        for (l = 0; l < GOLDEN_NZ; l++) {
            const golden_real q = (l <= i) ? Q[i][l] : Q[l][i];
            for (c = 0; c < width; c++) {
                T[c] += q * Z[l][c];
            }
        }
        for (r = 0; r < width; r++) {
            const golden_real z = Z[i][r];
            for (c = 0; c <= r; c++) {
                block->Q[r][c] += z * T[c];
            }
        }
    }
}

/* Gradients of the rows of a node in the variables of its block: J_x G_j, and J_u at du_j; a bound of the first state of a
 * block, or of the last one of the horizon, needs none. */
static void condense_block_rows(golden_solver_t *s, int node)
{
    const int j = node % GOLDEN_BLOCK;
    int m, i, c;
    for (m = row_first[node]; m < row_first[node + 1]; m++) {
        golden_real J[GOLDEN_NZ];
        golden_real *row = s->blocks.J[m];
        (void)row_gradient(s, m, J);
        memset(row, 0, sizeof s->blocks.J[m]);
        if (node == GOLDEN_N) {
            memcpy(row, J, sizeof row[0] * GOLDEN_NX);
            for (i = GOLDEN_NX; row_kind[m] == 2 && i < GOLDEN_NXS; i++) {
                row[i] = s->coupled.J_0[row_index[m]][copied_state[i - GOLDEN_NX]];
            }
            continue;
        }
        for (i = 0; i < GOLDEN_NX; i++) {
            for (c = 0; c < GOLDEN_NXS + j * GOLDEN_NU; c++) {
                row[c] += J[i] * s->blocks.G[node][i][c];
            }
        }
        for (i = 0; i < GOLDEN_NU; i++) {
            row[GOLDEN_NXS + j * GOLDEN_NU + i] = J[GOLDEN_NX + i];
        }
    }
}

/* Values of the rows: those of their nodes plus J_x c_j. */
static void condense_row_values(golden_solver_t *s)
{
    int m, i;
    for (m = 0; m < GOLDEN_NG; m++) {
        golden_real J[GOLDEN_NZ];
        golden_real value = row_gradient(s, m, J);
        for (i = 0; row_node[m] < GOLDEN_N && i < GOLDEN_NX; i++) {
            value += J[i] * s->blocks.c[row_node[m]][i];
        }
        s->blocks.v[m] = value;
    }
}

/* All blocks: [A B], Hessian. */
static void condense_matrices(golden_solver_t *s)
{
    int k, j, r;
    for (k = 0; k < GOLDEN_NS; k++) {
        golden_block_t *block = &s->block[k];
        const int n = (k < GOLDEN_NS - 1) ? GOLDEN_BLOCK : GOLDEN_N - k * GOLDEN_BLOCK;
        for (r = 0; r < GOLDEN_NXS + n * GOLDEN_NU; r++) {
            memset(block->Q[r], 0, sizeof block->Q[r]);
        }
        for (j = 0; j < n; j++) {
            const int node = k * GOLDEN_BLOCK + j;
            condense_hessian(s, block, s->hessian.Q[GOLDEN_NQ == 1 ? 0 : node], node, j);
            condense_forward(&s->node[node], s->blocks.G[node], (j + 1 < n) ? s->blocks.G[node + 1] : block->S, j);
        }
    }
    for (r = 0; r < GOLDEN_NX; r++) {
        memcpy(s->blocks.Q_N[r], s->hessian.Q_N[r], sizeof s->hessian.Q_N[0]);
    }
}

/* Gaps and gradients: c_0 = 0, c_{j+1} = A c_j + b;  w = q of the end;  g of du_j = r + B' w, w <- q + Q (c_j, 0) + A' w. */
static void condense_vectors(golden_solver_t *s)
{
    const golden_real none[GOLDEN_NU] = {0};
    golden_real w[GOLDEN_NZ];
    int k, j, i;
    for (k = 0; k < GOLDEN_NS; k++) {
        golden_block_t *block = &s->block[k];
        const int n = (k < GOLDEN_NS - 1) ? GOLDEN_BLOCK : GOLDEN_N - k * GOLDEN_BLOCK;
        for (j = 0; j < n; j++) {
            golden_real *next = (j + 1 < n) ? s->blocks.c[k * GOLDEN_BLOCK + j + 1] : block->b;
            state_step(&s->node[k * GOLDEN_BLOCK + j], s->blocks.c[k * GOLDEN_BLOCK + j], none, next);
        }
        memset(w, 0, sizeof w);
        for (j = n - 1; j >= 0; j--) {
            const int node = k * GOLDEN_BLOCK + j;
            adjoint_step(&s->node[node], s->hessian.Q[GOLDEN_NQ == 1 ? 0 : node], s->blocks.c[node], none, w);
            for (i = 0; i < GOLDEN_NU; i++) {
                block->g[GOLDEN_NXS + j * GOLDEN_NU + i] = w[GOLDEN_NX + i];
            }
        }
        memcpy(block->g, w, sizeof w[0] * GOLDEN_NX);
    }
    memcpy(s->blocks.g_N, s->terminal.g, sizeof s->terminal.g);
    condense_row_values(s);
}

static golden_status_t condense_prepare(golden_solver_t *s)
{
    int k;
    condense_matrices(s);
    for (k = 0; k <= GOLDEN_N; k++) {
        condense_block_rows(s, k);
    }
    condense_vectors(s);
    memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return qp_factorize(s);
}

static void condense_gradient(golden_solver_t *s)
{
    condense_vectors(s);
    qp_gradient(s);
}

static void condense_rows(golden_solver_t *s)
{
    condense_vectors(s);
    qp_gradient(s);
}

static void condense_expand(golden_solver_t *s)
{
    int k;
    memcpy(s->step.du, s->qp.z, sizeof s->step.du);
    memcpy(s->step.mult_u, s->qp.mult, sizeof s->step.mult_u);
    memcpy(s->step.mult, s->qp.mult + GOLDEN_NV, sizeof s->step.mult[0] * GOLDEN_NG);
    memcpy(s->step.dx[0], s->qp.x[0], sizeof s->step.dx[0]);
    for (k = 0; k < GOLDEN_N; k++) {
        state_step(&s->node[k], s->step.dx[k], s->step.du[k], s->step.dx[k + 1]);
    }
}

static golden_status_t condense_solve(golden_solver_t *s)
{
    golden_status_t status;
    condense_embed(s);
    status = qp_solve(s);
    condense_expand(s);
    return status;
}
