/* ==== hessian: gauss_newton =============================================================================== */

/* Seam "hessian", contract: hessian() fills s->hessian.Q (GOLDEN_NQ blocks) and Q_N, lower triangles, z = (x, u). */
/* Here: Gauss-Newton, Q = J' W J; one block for all nodes where it depends on the weight alone (NQ = 1). */

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
