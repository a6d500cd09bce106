/* ==== hessian: gauss_newton =============================================================================== */

/* Seam "hessian", contract: hessian() fills s->hessian.Q (GOLDEN_NQ blocks) and Q_N, lower triangles, z = (x, u). */
/* Here: Gauss-Newton, Q = J' W J; one block for all nodes where it depends on the weight alone (NQ = 1). */

static void hessian(golden_solver_t *s)
{
    int k;
    for (k = 0; k < GOLDEN_NQ; k++) {
        path_hessian(s->x[k], s->u[k], s->p[k], &interval_length[k], s->W, &s->hessian.Q[k][0][0]);
    }
    terminal_hessian(s->x[GOLDEN_N], s->p[GOLDEN_N], s->W_N, &s->hessian.Q_N[0][0]);
}
