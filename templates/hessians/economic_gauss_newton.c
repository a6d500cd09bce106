/* Component "hessian". Contract:
 *   expand_node(s, k, x_next)   s->node[k].S and g, and x_next = Phi; called from the last node to the first, after the
 *                               terminal gradient has been evaluated
 *   hessian(s)                  called next: the blocks of s->hessian, lower triangles, z = (x, u)
 *   condense_factorize(s)       qp_factorize(), and treatment of a condensed Hessian that is not positive definite
 * Here: Q = M at every node and Q_N = M_f, constants. */

#include "hessians/first_order.c"

#include "hessians/start.c"

#if TUNED
#include "hessians/stale.c"
#endif

static void hessian(solver_t *s)
{
    for (int k = 0; k < NQ; k++) {
        PATH_HESSIAN(s, k, s->hessian.Q[k]);
    }
    if (HAS_START_HESSIAN) {
        add_start_hessian(s);
    }
    TERMINAL_HESSIAN(s, s->hessian.Q_N);
    if (TUNED) {
        if (s->hessian.new_data) {
            s->hessian.new_data = 0;
            s->stats.stale_hessian = data_differ(s);
        }
    }
}
