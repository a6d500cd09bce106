#include "hessians/first_multipliers.c"

/* Linearises all nodes, from the last to the first, and writes the exact Hessian to s->curved, lower triangles. */
static void linearize_with_curvature(solver_t *s)
{
    curved_t *c = &s->curved;
    const int adjoint = !has_multipliers(s);
    real_t x_next[NX], mu[NH];
    if (NALG) {
        follow_algebraic(s);
    }
    (void)memset(c->Q, 0, sizeof c->Q);
    (void)memset(c->Q_N, 0, sizeof c->Q_N);
    TERMINAL_GRADIENT(s, s->terminal.g);
    TERMINAL_ROWS(s, s->terminal.h, s->terminal.J);
    COUPLED_ROWS(s, s->coupled.r, s->coupled.J_0, s->coupled.J_N);
    if (adjoint) {
        (void)memcpy(s->lam[N], s->terminal.g, sizeof s->terminal.g);
    }
    for (int k = N - 1; k >= 0; k--) {
        if (NH > 0) {
            path_multipliers(s, k, mu);
        }
        PATH_EXACT(s, k, mu, x_next, s->node[k].S, s->node[k].g, c->Q[k], s->node[k].left);
        if (adjoint) {
            adjoint_node(s, k);
        }
        complete_node(s, k, x_next, &s->node[k]);
    }
    if (HAS_START_GRADIENT) {
        add_start_gradient(s, s->node[0].g);
    }
    if (HAS_START_EXACT) {
        real_t Q[NX][NX] = {{R(0)}};
        START_EXACT(s, Q);
        for (int i = 0; i < NX; i++) {
            for (int j = 0; j <= i; j++) {
                c->Q[0][i][j] += Q[i][j];
            }
        }
    }
    INITIAL_EXACT(s, c->Q[0]);
    TERMINAL_EXACT(s, END_MULTIPLIERS(s), c->Q_N);
}
