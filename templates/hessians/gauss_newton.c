/* Seam "hessian", contract:
 *   expand_node(s, k, x_next)   nodes from the last to the first, terminal gradient known: s->node[k].S and g, x_next = Phi
 *   hessian(s)                  then: s->hessian.Q (NQ blocks) and Q_N, lower triangles, z = (x, u)
 * and, for full condensing,
 *   condense_factorize(s)       qp_factorize(), and what becomes of a condensed Hessian that is not positive definite */
/* Here: Gauss-Newton, Q = J' W J; one block for all nodes where it depends on the weight alone (NQ = 1). */

#include "hessians/first_order.c"

#if CONVEX_ROWS
#include "hessians/convex_rows.c"
#else
#include "hessians/flat_rows.c"
#endif

static void hessian(solver_t *s)
{
    int k;
    for (k = 0; k < NQ; k++) {
        path_hessian(s->x[k], s->u[k], PARAM(s, k), &interval_length[k], WEIGHT(s, k), &s->hessian.Q[k][0][0]);
    }
    terminal_hessian(s->x[N], PARAM_N(s), WEIGHT_N(s), &s->hessian.Q_N[0][0]);
    add_rows(s);
}
