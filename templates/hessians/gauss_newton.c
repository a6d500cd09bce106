/* Component "hessian". Contract:
 *   expand_node(s, k, x_next)   s->node[k].S and g, and x_next = Phi; called from the last node to the first, after the
 *                               terminal gradient has been evaluated
 *   hessian(s)                  called next: the blocks of s->hessian, lower triangles, z = (x, u)
 *   condense_factorize(s)       qp_factorize(), and treatment of a condensed Hessian that is not positive definite
 * Here: Gauss-Newton, Q = J' W J; one block for all nodes if it depends only on the weight. */

#include "hessians/first_order.c"

#include "hessians/convex_rows.c"

#include "hessians/start.c"

static void hessian(solver_t *s)
{
    for (int k = 0; k < NQ; k++) {
        PATH_HESSIAN(s, k, s->hessian.Q[k]);
    }
    if (HAS_START_HESSIAN) {
        add_start_hessian(s);
    }
    TERMINAL_HESSIAN(s, s->hessian.Q_N);
    if (HAS_PATH_CURVATURE || HAS_TERMINAL_CURVATURE) {
        add_rows(s);
    }
}
