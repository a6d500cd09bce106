/* Component "condensing". Contract:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: all computations that depend neither on xhat nor on the final bounds, including the
 *                      factorisation of the QP
 *   condense_gradient  called when only gradients of the nodes have changed
 *   condense_rows      called if gaps b and values of the rows have changed, but no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_shift     shifts the predicted working set of the controls by one interval
 *   condense_shift_rows  row m takes the predicted side of row source[m]
 * Here: dx_k = G_k (dx_0, du_0, ..., du_{N-1}) + c_k. All states but dx_0 are eliminated in O(N^2), COLUMNS columns at
 * a time, in memory of the QP solver: qp.work.columns, which qp_factorize overwrites. The variables of the QP are du_0
 * .. du_{N-1}, then entries of dx_0 that are free, then violations of rows that are variables. */

#include "generated/product_columns.c"

static void qp_init(qp_t *q);
static status_t qp_factorize(qp_t *q);
static status_t qp_solve(qp_t *q);

static void condense_init(solver_t *s)
{
    qp_init(&s->qp);
}

/* sum + a'x. */
static inline real_t condense_sum(real_t sum, const real_t *a, const real_t *x)
{
    for (int i = 0; i < NX; ++i) {
        sum += a[i] * x[i];
    }
    return sum;
}

/* Returns the index of control j of node k among the variables of the QP; -1 if no block begins there. */
static inline int condense_variable(int k, int j)
{
    if (NHELD > 0) {
        return control_variable[k * NU + j];
    }
    return k * NU + j;
}

/* Returns the first node k at which a column in a panel of G_k is nonzero: 0 for dx_0, k + 1 for du_k. */
static inline int condense_first_node(int column)
{
    if (NHELD > 0) {
        return (column < NXC) ? 0 : (column < NXC + NVU) ? variable_node[column - NXC] + 1 : N + 1;
    }
    return (column < NXC) ? 0 : (column - NXC) / NU + 1;
}

/* Sets a panel of G_k or W to zero. */
static inline void condense_clear(real_t (*columns)[COLUMNS])
{
    for (int i = 0; i < NX; ++i) {
        for (int l = 0; l < COLUMNS; ++l) {
            columns[i][l] = R(0);
        }
    }
}

/* Copies B_k to the columns of du_k in G_{k+1}. */
static inline void condense_enter(columns_t *p, const node_t *node, int k, int column)
{
    if (NHELD > 0) {
        for (int j = 0; j < NU; ++j) {
            const int at = NXC + condense_variable(k, j) - column;
            for (int i = 0; i < NX && at >= 0 && at < COLUMNS && condense_variable(k, j) >= 0; ++i) {
                p->G[k + 1][i][at] = node->S[i][NX + j];
            }
        }
        return;
    }
    const int entering = NXC + k * NU - column;
    for (int j = (entering < 0) ? -entering : 0; j < NU && entering + j < COLUMNS; ++j) {
        for (int i = 0; i < NX; ++i) {
            p->G[k + 1][i][entering + j] = node->S[i][NX + j];
        }
    }
}

/* Computes a panel of G_k from its first node on: G_0 = [I 0], G_{k+1} = [A_k G_k, B_k at du_k]. The panel is zero at
 * node k. */
static void condense_propagate(solver_t *s, int column)
{
    columns_t *p = &s->qp.work.columns;
    const int first = condense_first_node(column), last = condense_first_node(column + COLUMNS - 1);
    condense_clear(p->G[first]);
    for (int i = column; i < NXC && i < column + COLUMNS; ++i) {
        p->G[0][i][i - column] = R(1);
    }
    if (first > 0) {
        condense_clear(p->G[first - 1]);
        condense_enter(p, &s->node[first - 1], first - 1, column);
    }
    for (int k = first; k < N; ++k) {
        CONDENSE_FORWARD_PANEL(p, &s->node[k], k);
        if (k < last) {
            condense_enter(p, &s->node[k], k, column);
        }
    }
}

/* Columns of dx_0 in a panel that also contains du_0, and columns of H in the last panel. */
enum { BORDER = NXC % COLUMNS, LAST = (LDH + NXC < LDG) ? LDH + NXC + COLUMNS - LDG : COLUMNS };

/* Stores a panel of a row of (Hx, H) or (Ax, A). Entries of H beyond its diagonal are not read. */
static inline void condense_store(const real_t *panel, int column, real_t *dx0, real_t *du)
{
    if (column + COLUMNS <= NXC) {
        (void)memcpy(dx0 + column, panel, COLUMNS * sizeof *panel);
    } else if (column < NXC) {
        (void)memcpy(dx0 + column, panel, BORDER * sizeof *panel);
        (void)memcpy(du, panel + BORDER, (COLUMNS - BORDER < LDH ? COLUMNS - BORDER : LDH) * sizeof *panel);
    } else if (column + COLUMNS < LDG) {
        (void)memcpy(du + column - NXC, panel, COLUMNS * sizeof *panel);
    } else {
        (void)memcpy(du + column - NXC, panel, LAST * sizeof *panel);
    }
}

/* Stores a panel T of block row k in the condensed Hessian and in its coupling to dx_0. */
static void condense_store_rows(solver_t *s, int k, int column)
{
    columns_t *p = &s->qp.work.columns;
    for (int j = 0; j < NU; ++j) {
        const int row = condense_variable(k, j);
        if (NHELD > 0) {
            if (row < 0) {
                continue;
            }
        }
        condense_store(p->T[j], column, s->condensed.Hx[row], s->qp.H[row]);
    }
}

/* Adds the coupling of du_k to the controls of the previous node in dx_0; these act on node 0 only. */
static void condense_couple_band(solver_t *s, int k, real_t (*Q)[NZ])
{
    for (int j = 0; j < NU; ++j) {
        for (int i = NXC; i < NX; ++i) {
            s->condensed.Hx[k * NU + j][i] = (k == 0) ? Q[NX + j][i] : R(0);
        }
    }
}

/* Adds the contribution of controls of node k - 1 to the condensed Hessian: products of those of one node, and products
 * with the controls of node k. */
static void condense_add_band(solver_t *s, int k, real_t (*Q)[NZ])
{
    for (int i = 0; k > 0 && i < NBAND; ++i) {
        const int before = (k - 1) * NU + remembered[i];
        for (int j = 0; j < NU; ++j) {
            s->qp.H[k * NU + j][before] += Q[NX + j][NXC + i];
        }
        for (int l = 0; l <= i; ++l) {
            s->qp.H[before][(k - 1) * NU + remembered[l]] += Q[NXC + i][NXC + l];
        }
    }
}

/* Adds the contribution of controls of node N - 1 to the condensed Hessian. */
static void condense_add_last_band(solver_t *s, real_t (*Q)[NX])
{
    const int last = (N - 1) * NU;
    for (int i = 0; i < NBAND; ++i) {
        for (int l = 0; l <= i; ++l) {
            s->qp.H[last + remembered[i]][last + remembered[l]] += Q[NXC + i][NXC + l];
        }
    }
}

/* Adds R_k, lower triangle, to the condensed Hessian at (du_k, du_k). */
static void condense_add_curvature(solver_t *s)
{
    for (int k = 0; k < N; ++k) {
        real_t(*Q)[NZ] = HESSIAN(s, k);
        if (CURVED && s->curved.in_solve) {
            Q = s->curved.Q[k];
        }
        for (int j = 0; j < NU; ++j) {
            for (int i = 0; i <= j; ++i) {
                if (NHELD > 0) {
                    if (condense_variable(k, j) < 0 || condense_variable(k, i) < 0) {
                        continue;
                    }
                }
                s->qp.H[condense_variable(k, j)][condense_variable(k, i)] += Q[NX + j][NX + i];
            }
        }
    }
}

/* Adds the rows of W of controls of the previous node to those controls, for a dense Hessian: T += later. */
static void condense_pull_back(columns_t *p, real_t (*later)[COLUMNS])
{
    for (int i = 0; i < NBAND; ++i) {
        for (int l = 0; l < COLUMNS; ++l) {
            p->T[remembered[i]][l] += later[i][l];
            p->W[NXC + i][l] = R(0);
        }
    }
}

/* Computes W of node k where controls follow those v of the previous node. The term c^2/2 (u - v)^2 vanishes, as du =
 * dv. */
static void condense_follow(solver_t *s, int k)
{
    columns_t *p = &s->qp.work.columns;
    real_t(*Q)[NZ] = HESSIAN(s, k);
    if (CURVED && s->curved.in_solve) {
        Q = s->curved.Q[k];
    }
    for (int i = 0; i < NMEM; ++i) {
        const int v = NX - NMEM + i, j = remembered[i];
        if (condense_variable(k, j) < 0) {
            for (int l = 0; l < COLUMNS; ++l) {
                p->W[v][l] += Q[NX + j][v] * p->G[k][v][l];
            }
        }
    }
}

/* Computes a panel of the condensed Hessian without R_k: its block rows T from the last to the first. */
static void condense_hessian(solver_t *s, int column)
{
    columns_t *p = &s->qp.work.columns;
    const int first = condense_first_node(column);
    const int curved = s->curved.in_solve;
    real_t later[NBAND][COLUMNS]; /* rows of W of controls of the previous node */
    if (TERMINAL_BLOCK) {
        CONDENSE_TERMINAL_PANEL(p, s->hessian.Q_N); /* W_N = Q_N G_N */
    } else {
        condense_clear(p->W);
    }
    if (CURVED) {
        if (curved) {
            add_curved_panel(p->W, s->curved.Q_N[0], NX, NX, p->G[N]);
        }
    }
    for (int k = N - 1; k >= 0 && k >= first - 1; --k) {
        if (NBAND > 0 && CURVED) {
            if (curved) {
                (void)memcpy(later, p->W[NXC], NBAND * sizeof later[0]);
            }
        }
        CONDENSE_BACKWARD_PANEL(p, &s->node[k], HESSIAN(s, k), k);
        if (CURVED) {
            if (curved) {
                if (NBAND) {
                    condense_pull_back(p, later);
                }
                add_curved_panel(p->W, s->curved.Q[k][0], NZ, NX, p->G[k]);
                add_curved_panel(p->T, s->curved.Q[k][NX], NZ, NU, p->G[k]);
            }
        }
        if (NHELD > 0) {
            condense_follow(s, k);
        }
        condense_store_rows(s, k, column);
    }
    for (int f = 0; f < NF; ++f) {
        for (int i = column; i < NXC && i < column + COLUMNS; ++i) {
            s->condensed.Hx[NVU + f][i] = p->W[free_state[f]][i - column];
        }
    }
}

/* Copies the Hessian rows of the free components of dx_0 from the coupling to dx_0. */
static void condense_store_free(solver_t *s)
{
    for (int f = 0; f < NF; ++f) {
        const int row = NVU + f;
        for (int i = 0; i < NVU; ++i) {
            s->qp.H[row][i] = s->condensed.Hx[i][free_state[f]];
        }
        for (int e = 0; e <= f; ++e) {
            s->qp.H[row][NVU + e] = s->condensed.Hx[row][free_state[e]];
        }
    }
}

/* Adds the panel of J_x G_k + J_u at du_k for row m, which is no bound. */
static void condense_add_row(const solver_t *s, int m, int column, real_t *sum)
{
    const int k = row_node(m), entering = NXC + k * NU - column;
    const real_t *J = row_gradient(s, m);
    const int last = (k + 1 >= condense_first_node(column)) ? NX : 0;
    if (row_is_coupled(m)) {
        /* The row also contains J_0 dx_0. */
        for (int i = column; i < NXC && i < column + COLUMNS; ++i) {
            sum[i - column] = s->coupled.J_0[row_index(m)][i];
        }
    }
    for (int i = 0; i < last; ++i) {
        if (J[i] != R(0)) { /* a row depends on few states; its other entries are exactly 0 */
            for (int l = 0; l < COLUMNS; ++l) {
                sum[l] += J[i] * s->qp.work.columns.G[k][i][l];
            }
        }
    }
    if (NHELD > 0) {
        for (int j = 0; k < N && j < NU; ++j) {
            const int at = NXC + condense_variable(k, j) - column;
            if (at >= 0 && at < COLUMNS && condense_variable(k, j) >= 0) {
                sum[at] = J[NX + j];
            }
        }
        return;
    }
    for (int j = (entering < 0) ? -entering : 0; k < N && j < NU && entering + j < COLUMNS; ++j) {
        sum[entering + j] = J[NX + j];
    }
}

/* Returns the panel of the state row m, which is a row of G_k; zero before its first node. */
static inline const real_t *condense_state_row(const solver_t *s, int m, int column)
{
    static const real_t zero[COLUMNS] = {R(0)};
    const int reached = row_node(m) + 1 >= condense_first_node(column);
    return reached ? s->qp.work.columns.G[row_node(m)][row_index(m)] : zero;
}

/* Computes the panel of row m of the QP: A = J_x G_k + J_u at du_k; a bound of a state has J_x = e_i. */
static void condense_row(solver_t *s, int m, int column)
{
    real_t sum[COLUMNS] = {R(0)};
    if (row_is_state(m)) {
        condense_store(condense_state_row(s, m, column), column, s->condensed.Ax[m], s->qp.A[m]);
        for (int i = NXC; i < NX; ++i) {
            s->condensed.Ax[m][i] = R(0);
        }
        return;
    }
    condense_add_row(s, m, column, sum);
    condense_store(sum, column, s->condensed.Ax[m], s->qp.A[m]);
    for (int i = NXC; i < NX; ++i) {
        s->condensed.Ax[m][i] = (row_node(m) == 0) ? row_gradient(s, m)[i] : R(0);
    }
}

/* Copies the entries of the rows at the free components of dx_0. */
static void condense_store_others(solver_t *s)
{
    for (int m = 0; m < NG; ++m) {
        for (int f = 0; f < NF; ++f) {
            s->qp.A[m][NVU + f] = s->condensed.Ax[m][free_state[f]];
        }
    }
}

/* Adds the bands of all nodes. */
static void condense_add_bands(solver_t *s)
{
    for (int k = 0; k < N; ++k) {
        if (CURVED) {
            if (s->curved.in_solve) { /* the panels contain all products except those with dx_0 */
                condense_couple_band(s, k, s->curved.Q[k]);
                continue;
            }
        }
        condense_couple_band(s, k, HESSIAN(s, k));
        condense_add_band(s, k, HESSIAN(s, k));
    }
    if (CURVED) {
        if (s->curved.in_solve) {
            return;
        }
    }
    if (TERMINAL_BLOCK) {
        condense_add_last_band(s, s->hessian.Q_N);
    }
}

/* Computes Hessian and rows of the QP, panel by panel. */
static void condense_matrices(solver_t *s)
{
    for (int column = 0; column < LDG; column += COLUMNS) {
        condense_propagate(s, column);
        condense_hessian(s, column);
        for (int m = 0; m < NG; ++m) {
            condense_row(s, m, column);
        }
    }
    condense_add_curvature(s);
    if (NBAND) {
        condense_add_bands(s);
    }
    condense_store_free(s);
    condense_store_others(s);
}

/* c_0 = 0,  c_{k+1} = A_k c_k + b_k;   w_N = q_N + Q_N c_N,  g_k = r_k + S_k c_k + B_k' w_{k+1},
 * w_k = q_k + Q_k c_k + A_k' w_{k+1}. */
static void condense_gradient(solver_t *s)
{
    condensed_t *d = &s->condensed;
    const real_t du[NU] = {0};
    real_t w[NZ];
    for (int k = 0; k < N; ++k) {
        STATE_STEP(&s->node[k], d->c[k], du, d->c[k + 1]);
    }
    TERMINAL_ADJOINT(&s->terminal, s->hessian.Q_N, d->c[N], w);
    if (CURVED) {
        if (s->curved.in_solve) {
            add_terminal_curvature(s, d->c[N], w);
        }
    }
    for (int k = N - 1; k >= 0; --k) {
        ADJOINT_STEP(&s->node[k], HESSIAN(s, k), d->c[k], du, w);
        if (CURVED) {
            if (s->curved.in_solve) {
                add_curvature(s, k, d->c[k], du, w);
            }
        }
        for (int j = 0; j < NU; ++j) {
            if (NHELD > 0) {
                if (condense_variable(k, j) < 0) {
                    continue;
                }
            }
            d->g[condense_variable(k, j)] = w[NX + j];
        }
    }
    for (int f = 0; f < NF; ++f) {
        d->g[NVU + f] = w[free_state[f]];
    }
}

/* Sets gradient and bounds of the free components of dx_0, which are zero in dx0. */
static void condense_embed_free(solver_t *s, const real_t *dx0)
{
    for (int row = NVU; row < NVU + NF; ++row) {
        s->qp.g[row] = condense_sum(s->condensed.g[row], s->condensed.Hx[row], dx0);
        s->qp.lower[row] = -INF;
        s->qp.upper[row] = INF;
    }
}

/* Sets gradient, bounds, curvatures and penalties of the slacks. A row with a quadratic penalty has a slack sigma, a
 * variable of the QP: lower <= row - sigma <= upper, cost l2/2 sigma^2, and sigma = 0 as an elastic bound with penalty
 * l1. The QP solver knows where slacks occur; neither the Hessian nor the rows have entries for them. */
static void condense_embed_slacks(solver_t *s)
{
    for (int m = 0; m < NG; ++m) {
        const int slack = row_slack[m];
        if (slack >= NV - NSL) {
            s->qp.g[slack] = R(0);
            s->qp.lower[slack] = R(0);
            s->qp.upper[slack] = R(0);
            s->qp.curvature[slack - (NV - NSL)] = row_l2(s, m);
            s->qp.penalty[slack] = row_penalty(s, m);
            s->qp.penalty[NV + m] = INF;
        }
    }
}

/* Sets the bounds of the rows relative to their values at du = 0, and the costs of their violation. The sum of the
 * magnitudes has a loop of its own: GCC 12 compiles both sums in one wrongly at -O3 for AVX-512. */
static void condense_embed_rows(solver_t *s, const real_t *dx0)
{
    for (int m = 0; m < NG; ++m) {
        const real_t value = condense_sum(s->condensed.v[m], s->condensed.Ax[m], dx0);
        real_t terms = s->condensed.terms[m];
        for (int i = 0; i < NX; ++i) {
            terms += FABS(s->condensed.Ax[m][i] * dx0[i]);
        }
        s->qp.terms[m] = terms;
        s->qp.lower[NV + m] = row_lower(s, m) - value;
        s->qp.upper[NV + m] = row_upper(s, m) - value;
        s->qp.penalty[NV + m] = row_penalty(s, m);
    }
}

/* g = g(0) + Hx dx_0; bounds of du and of the rows relative to the present iterate. */
static void condense_embed(solver_t *s)
{
    real_t dx0[NX];
    (void)memcpy(dx0, s->step.dx[0], sizeof dx0);
    for (int f = 0; f < NF; ++f) {
        dx0[free_state[f]] = R(0);
    }
    for (int k = 0; k < N; ++k) {
        for (int j = 0; j < NU; ++j) {
            const int row = condense_variable(k, j);
            if (NHELD > 0) {
                if (row < 0) {
                    continue;
                }
            }
            s->qp.g[row] = condense_sum(s->condensed.g[row], s->condensed.Hx[row], dx0);
            s->qp.lower[row] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[row] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    condense_embed_rows(s, dx0);
    condense_embed_free(s, dx0);
    if (NSL) {
        condense_embed_slacks(s);
    }
}

/* Computes the value of row m at du = 0, dx_0 = 0, v = row + J_x c_k, and the magnitude of its terms. A state counts
 * with its largest magnitude, because its rounding errors travel along the horizon; the sum is at least a fraction of
 * the scale of the row. */
static void condense_value(solver_t *s, int m, const real_t *size)
{
    const real_t *c = s->condensed.c[row_node(m)];
    s->condensed.terms[m] = row_terms(s, m, size) + FACTOR_CONDENSED_LEAST_TERMS * row_magnitude[row_id(m)];
    if (row_is_state(m)) {
        s->condensed.v[m] = row_constant(s, m) + c[row_index(m)];
        return;
    }
    s->condensed.v[m] = row_constant(s, m) + condense_sum(R(0), row_gradient(s, m), c);
}

/* Computes the gradients, and the values of the rows at du = 0, dx_0 = 0. */
static void condense_rows(solver_t *s)
{
    condense_gradient(s);
    if (NG) {
        real_t size[NZ] = {0}; /* largest magnitude of every component of c_0, c_1, ..., c_N; 0 for the controls */
        for (int k = 1; k <= N; ++k) {
            widen(size, s->condensed.c[k], NX);
        }
        for (int m = 0; m < NG; ++m) {
            condense_value(s, m, size);
        }
    }
}

#if REGULARIZE_REDUCED
#include "hessians/regularize_reduced.c"
#else
#include "hessians/regularize_nothing.c"
#endif

static status_t condense_prepare(solver_t *s)
{
    condense_matrices(s);
    condense_rows(s);
    (void)memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return condense_factorize(s);
}

/* Copies du of controls that begin no block from the previous node. */
static void condense_expand_held(step_t *d, int k)
{
    for (int i = 0; i < NMEM; ++i) {
        if (condense_variable(k, remembered[i]) < 0) {
            d->du[k][remembered[i]] = d->dx[k][NX - NMEM + i];
        }
    }
}

/* Copies du and the multipliers from the QP; dx_{k+1} = A_k dx_k + B_k du_k + b_k. */
static void condense_expand(solver_t *s)
{
    step_t *d = &s->step;
    for (int f = 0; f < NF; ++f) {
        d->dx[0][free_state[f]] = s->qp.z[NVU + f];
    }
    for (int k = 0; k < N; ++k) {
        for (int j = 0; j < NU; ++j) {
            if (NHELD > 0) {
                if (condense_variable(k, j) < 0) {
                    d->mult_u[k][j] = R(0);
                    continue;
                }
            }
            d->du[k][j] = s->qp.z[condense_variable(k, j)];
            d->mult_u[k][j] = s->qp.mult[condense_variable(k, j)];
        }
        if (NHELD > 0) {
            condense_expand_held(d, k);
        }
        STATE_STEP(&s->node[k], d->dx[k], d->du[k], d->dx[k + 1]);
    }
    for (int m = 0; m < NG; ++m) {
        if (REGULARIZE_REDUCED) {
            d->mult[m] = released_multiplier(s, m);
        } else {
            d->mult[m] = s->qp.mult[NV + m];
        }
    }
}

static status_t condense_solve(solver_t *s)
{
    status_t status;
    condense_embed(s);
    status = qp_solve(&s->qp);
    condense_expand(s);
    return status;
}

static void qp_shift_controls(qp_t *q, int n);
static void qp_shift_rows(qp_t *q, const int *source);

#include "condensing/shift_condensed.c"
