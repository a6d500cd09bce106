/* Seam "hessian", contract: expand_node() and hessian() as in gauss_newton.c.
 * Here: Q = I at every node. */

#include "hessians/first_order.c"

static void hessian(solver_t *s)
{
    int k;
    for (k = 0; k < NQ; k++) {
        path_hessian(&s->hessian.Q[k][0][0]);
    }
    terminal_hessian(&s->hessian.Q_N[0][0]);
}
