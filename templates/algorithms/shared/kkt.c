/* KKT residuals of the present iterate: the absolute ones, and the largest relative one. A residual is divided by the
 * scale of its variable or row plus the sum of the magnitudes of its terms, so that a tolerance means the same in all
 * units. */

#include "algorithms/shared/kkt_terms.c"

static void kkt_soft_row(const solver_t *s, int m, real_t value, kkt_t *kkt)
{
    const real_t l1 = row_l1(s, m), l2 = row_l2(s, m), mu = s->mult[m];
    const real_t scale = row_magnitude[row_id(m)];
    kkt_soft_side(kkt, value - row_upper(s, m), (mu > R(0)) ? mu : R(0), l1, l2, value, scale);
    kkt_soft_side(kkt, row_lower(s, m) - value, (mu < R(0)) ? -mu : R(0), l1, l2, value, scale);
}

/* Evaluates violation and complementarity of all rows and control bounds. */
static void kkt_rows(const solver_t *s, kkt_t *kkt)
{
    real_t value[NG];
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m)) {
            kkt_soft_row(s, m, value[m], kkt);
            continue;
        }
        const real_t scale = row_magnitude[row_id(m)];
        kkt_row(kkt, value[m], row_lower(s, m), row_upper(s, m), s->mult[m], scale);
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t lower = control_lower(s, k, j), upper = control_upper(s, k, j);
            kkt_row(kkt, s->u[k][j], lower, upper, s->mu_u[k][j], z_scale[NX + j]);
        }
    }
}

/* Adds a term to a sum and to the sum of the magnitudes. */
static inline void kkt_add(real_t *sum, real_t *terms, real_t term)
{
    *sum += term;
    *terms += FABS(term);
}

/* sum += mult of the bounds of the states of node k; terms += the magnitudes. */
static void add_bound_forces(const solver_t *s, int k, real_t *sum, real_t *terms)
{
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (row_is_state(m)) {
            kkt_add(&sum[row_index(m)], &terms[row_index(m)], s->mult[m]);
        }
    }
}

/* sum += J' mult of the coupled rows, J = dr / dx_0 for k = 0 and dr / dx_N for k = N; terms += the magnitudes. */
static void add_coupled_forces(const solver_t *s, int k, real_t *sum, real_t *terms)
{
    real_t r[NE], J_0[NE][NX] = {{0}}, J_N[NE][NX] = {{0}};
    COUPLED_ROWS(s, r, J_0, J_N);
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NE; j++) {
            kkt_add(&sum[i], &terms[i], ((k == 0) ? J_0 : J_N)[j][i] * COUPLED_MULTIPLIERS(s)[j]);
        }
    }
}

/* Evaluates node k: the gradient of the Lagrangian (q, r) + [A B]' lam_{k+1} - (lam_k, 0) + (0, mu_u) + J' mult, and
 * the gap. */
static void kkt_node(const solver_t *s, int k, const node_t *node, kkt_t *kkt)
{
    real_t sum[NZ] = {0}, terms[NZ] = {0}, mu[NH];
    if (k == 0) {
        add_coupled_forces(s, k, sum, terms);
    }
    add_bound_forces(s, k, sum, terms);
    if (NH > 0) {
        path_multipliers(s, k, mu);
    }
    for (int i = 0; i < NZ; i++) {
        kkt_add(&sum[i], &terms[i], node->g[i]);
        for (int j = 0; j < NX; j++) {
            kkt_add(&sum[i], &terms[i], node->S[j][i] * s->lam[k + 1][j]);
        }
        for (int j = 0; j < NH; j++) {
            kkt_add(&sum[i], &terms[i], node->J[j][i] * mu[j]);
        }
        kkt_add(&sum[i], &terms[i], (i < NX) ? -s->lam[k][i] : s->mu_u[k][i - NX]);
        kkt_note(kkt, &kkt->stationarity, sum[i], terms[i], force_size[i]);
        if (i < NX) {
            kkt_note(kkt, &kkt->equality, node->b[i], FABS(s->x[k + 1][i]), z_scale[i]);
        }
    }
}

/* Evaluates the terminal node: the gradient of the Lagrangian, and the residual of the initial condition. */
static void kkt_terminal(const solver_t *s, const terminal_t *terminal, kkt_t *kkt)
{
    real_t sum[NX] = {0}, terms[NX] = {0};
    add_coupled_forces(s, N, sum, terms);
    add_bound_forces(s, N, sum, terms);
    for (int i = 0; i < NX; i++) {
        kkt_add(&sum[i], &terms[i], terminal->g[i]);
        kkt_add(&sum[i], &terms[i], -s->lam[N][i]);
        for (int j = 0; j < NH_N; j++) {
            kkt_add(&sum[i], &terms[i], terminal->J[j][i] * END_MULTIPLIERS(s)[j]);
        }
        kkt_note(kkt, &kkt->stationarity, sum[i], terms[i], force_size[i]);
        if (NF) {
            if (!is_measured[i] && !is_accumulator[i]) {
                continue;
            }
        }
        kkt_note(kkt, &kkt->equality, s->xhat[i] - s->x[0][i], FABS(s->x[0][i]), z_scale[i]);
    }
}

/* Computes the KKT residuals from the present linearisation. Returns 1 if all are at most tol, relative to their
 * terms. */
static int kkt_is_within(solver_t *s, real_t tol)
{
    kkt_t *kkt = &s->kkt;
    (void)memset(kkt, 0, sizeof *kkt);
    for (int k = 0; k < N; k++) {
        kkt_node(s, k, &s->node[k], kkt);
    }
    kkt_terminal(s, &s->terminal, kkt);
    kkt_rows(s, kkt);
    return kkt->relative <= tol;
}

/* Computes the KKT residuals of the present iterate from a new linearisation, one node at a time on the stack. */
void API(kkt)(const solver_t *s, kkt_t *out)
{
    node_t node;
    terminal_t terminal;
    real_t x_next[NX];
    (void)memset(out, 0, sizeof *out);
    if (s->magic != MAGIC) {
        out->relative = INF;
        return;
    }
    (void)memset(&node, 0, sizeof node);
    (void)memset(&terminal, 0, sizeof terminal);
    for (int k = 0; k < N; k++) {
        evaluate_node(s, k, &node, x_next);
        if (HAS_START_GRADIENT) {
            if (k == 0) {
                add_start_gradient(s, node.g);
            }
        }
        complete_node(s, k, x_next, &node);
        kkt_node(s, k, &node, out);
    }
    TERMINAL_GRADIENT(s, terminal.g);
    TERMINAL_ROWS(s, terminal.h, terminal.J);
    kkt_terminal(s, &terminal, out);
    kkt_rows(s, out);
}
