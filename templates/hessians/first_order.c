/* Evaluates node k: x_next = Phi(x_k, u_k), S = [A_k B_k] and the gradient g. */
static inline void evaluate_node(const solver_t *s, int k, node_t *node, real_t *x_next)
{
    INTEGRATOR_INTERVAL(s, k, x_next, node->S, node->left);
    PATH_GRADIENT(s, k, node->g);
}

#if !LANE_NODES && !LAGRANGIAN
static void expand_node(solver_t *s, int k, real_t *x_next)
{
    evaluate_node(s, k, &s->node[k], x_next);
}
#endif

#if CURVED
#include "hessians/curved.c"
#endif
