/* Computes the gap b_k = Phi(x_k, u_k) - x_{k+1} of node k, and its rows. */
static void complete_node(const solver_t *s, int k, const real_t *x_next, node_t *node)
{
    for (int i = 0; i < NX; i++) {
        node->b[i] = x_next[i] - s->x[k + 1][i];
    }
    PATH_ROWS(s, k, node->h, node->J);
}

#if LANE_NODES
#include "lanes/linearize.c"
#endif

/* q_0 += gradient of the cost of x_0. */
static void add_start_gradient(const solver_t *s, real_t *q)
{
    real_t slope[NX] = {R(0)};
    START_GRADIENT(s, slope);
    for (int i = 0; i < NX; i++) {
        q[i] += slope[i];
    }
}

/* Linearises all nodes, from the last to the first. The same evaluations give the data that the Hessian needs. */
static void linearize(solver_t *s)
{
    real_t x_next[NX];
    if (NALG) {
        follow_algebraic(s);
    }
    TERMINAL_GRADIENT(s, s->terminal.g);
    TERMINAL_ROWS(s, s->terminal.h, s->terminal.J);
    COUPLED_ROWS(s, s->coupled.r, s->coupled.J_0, s->coupled.J_N);
    if (LANE_NODES) {
        linearize_lanes(s);
    } else {
        for (int k = N - 1; k >= 0; k--) {
            expand_node(s, k, x_next);
            complete_node(s, k, x_next, &s->node[k]);
        }
    }
    if (HAS_START_GRADIENT) {
        add_start_gradient(s, s->node[0].g);
    }
}
