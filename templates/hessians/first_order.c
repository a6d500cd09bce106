/* Node k into s->node[k]: x_next = Phi(x_k, u_k), S = [A_k B_k], gradient g. */
static void expand_node(solver_t *s, int k, real_t *x_next)
{
    node_t *node = &s->node[k];
    integrator_interval(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], x_next, &node->S[0][0]);
    path_gradient(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], YREF(s, k), WEIGHT(s, k), node->g);
}
