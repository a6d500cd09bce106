/* Component "hessian". Contract: expand_node() and hessian() as in gauss_newton.c.
 * Here: Q = I at every node. */

#include "hessians/first_order.c"

static void hessian(solver_t *s)
{
    for (int k = 0; k < NQ; k++) {
        PATH_HESSIAN(s, k, &s->hessian.Q[k][0][0]);
    }
    TERMINAL_HESSIAN(s, &s->hessian.Q_N[0][0]);
}
