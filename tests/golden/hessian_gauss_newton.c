/* ==== hessian: gauss_newton =============================================================================== */

/* Seam "hessian", contract:
 *   expand_node(s, k, x_next)   nodes from the last to the first, terminal gradient known: s->node[k].S and g, x_next = Phi
 *   hessian(s)                  then: s->hessian.Q (GOLDEN_NQ blocks) and Q_N, lower triangles, z = (x, u)
 * and, for full condensing,
 *   condense_factorize(s)       qp_factorize(), and what becomes of a condensed Hessian that is not positive definite */
/* Here: Gauss-Newton, Q = J' W J; one block for all nodes where it depends on the weight alone (NQ = 1). */

/* Node k into s->node[k]: x_next = Phi(x_k, u_k), S = [A_k B_k], gradient g. */
static void expand_node(golden_solver_t *s, int k, golden_real *x_next)
{
    golden_node_t *node = &s->node[k];
    integrator_interval(s->x[k], s->u[k], s->p[k], &interval_length[k], x_next, &node->S[0][0]);
    path_gradient(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W[0], node->g);
}

/* The curvature of the rows is left out. */
static void add_rows(golden_solver_t *s)
{
    (void)s;
}

static void hessian(golden_solver_t *s)
{
    int k;
    for (k = 0; k < GOLDEN_NQ; k++) {
        path_hessian(s->x[k], s->u[k], s->p[k], &interval_length[k], s->W[0], &s->hessian.Q[k][0][0]);
    }
    terminal_hessian(s->x[GOLDEN_N], s->p[GOLDEN_N], s->W_N, &s->hessian.Q_N[0][0]);
    add_rows(s);
}
