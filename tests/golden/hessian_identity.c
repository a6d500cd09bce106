/* ==== hessian: identity =================================================================================== */

/* Seam "hessian", contract: expand_node() and hessian() as in gauss_newton.c.jinja.
 * Here: Q = I at every node. */

/* Node k into s->node[k]: x_next = Phi(x_k, u_k), S = [A_k B_k], gradient g. */
static void expand_node(golden_solver_t *s, int k, golden_real *x_next)
{
    golden_node_t *node = &s->node[k];
    integrator_interval(s->x[k], s->u[k], s->p[k], &interval_length[k], x_next, &node->S[0][0]);
    path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W[0], node->g);
}

static void hessian(golden_solver_t *s)
{
    int k;
    for (k = 0; k < GOLDEN_NQ; k++) {
        path_hessian(&s->hessian.Q[k][0][0]);
    }
    terminal_hessian(&s->hessian.Q_N[0][0]);
}
