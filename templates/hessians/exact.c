/* Component "hessian". Contract:
 *   expand_node(s, k, x_next)   s->node[k].S and g, and x_next = Phi; called from the last node to the first, after the
 *                               terminal gradient has been evaluated
 *   hessian(s)                  called next: the blocks of s->hessian, lower triangles, z = (x, u)
 *   condense_factorize(s)       qp_factorize(), and treatment of a condensed Hessian that is not positive definite
 * Here: the exact Hessian of the Lagrangian, Q_k = d2 (l_k + lam_{k+1}' Phi_k + mu_k' h_k), with the multipliers of the
 * last QP. If all lam are zero, as after reset, an adjoint sweep over the nodes provides them:
 * lam_k = q_k + A_k' lam_{k+1}. */

#include "hessians/first_order.c"

#include "hessians/first_multipliers.c"

/* Prepares the first node: decides whether multipliers are computed, and clears what a regularisation has written to
 * Q. */
static inline void start_expansion(solver_t *s)
{
    s->hessian.adjoint = !has_multipliers(s);
    if (s->hessian.adjoint) {
        (void)memcpy(s->lam[N], s->terminal.g, sizeof s->terminal.g);
    }
    if (s->hessian.changed) {
        (void)memset(s->hessian.Q, 0, sizeof s->hessian.Q);
        s->hessian.changed = 0;
    }
}

/* Evaluates node k in one sweep: x_next, S and g in s->node[k], and the second derivatives in Q_k. */
static void expand_node(solver_t *s, int k, real_t *x_next)
{
    node_t *node = &s->node[k];
    real_t mu[NH];
    if (k == N - 1) {
        start_expansion(s);
    }
    if (NH > 0) {
        path_multipliers(s, k, mu);
    }
    PATH_EXACT(s, k, mu, x_next, node->S, node->g, s->hessian.Q[k], node->left);
    if (s->hessian.adjoint) {
        adjoint_node(s, k);
    }
}

#if REGULARIZE_STAGES
#include "hessians/jacobi.c"

#include "hessians/regularize_stage.c"
#endif

#include "hessians/start.c"

/* Completes the Hessian after expand_node(): initial and terminal terms, and the regularisation. */
static void hessian(solver_t *s)
{
    if (HAS_START_HESSIAN) {
        add_start_hessian(s);
    }
    INITIAL_HESSIAN(s, s->hessian.Q[0]);
    TERMINAL_HESSIAN(s, END_MULTIPLIERS(s), s->hessian.Q_N);
    if (REGULARIZE_STAGES) {
        regularize_stages(s);
    }
}
