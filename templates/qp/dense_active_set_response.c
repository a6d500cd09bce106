/* z_j of the minimiser on the working set as a function of gradient and active bounds: m = C^{-1} e_j = Q'd + v gives
 *
 *     z_j = m'y = v'y0 + d'R^{-T} t,   h = -dz_j / dg = C^{-T} v,   e = dz_j / dt = R^{-1} d.
 *
 * feed is its value for the present data. Returns 0 for a semidefinite Hessian, where one minimiser is not enough. */
static int qp_response(qp_t *q, int j, real_t *h, real_t *e, real_t *feed)
{
    real_t vv, sum;
    if (!q->factorized || q->semidefinite) {
        return 0;
    }
    clear(e);
    vv = qp_normal(q, j);
    vv = qp_project(q, vv);
    if (q->nw > 0) {
        copy(e, q->work.basis.d);
        qp_solve_triangle(q, e);
    }
    qp_backward(q, q->work.basis.v, h);
    qp_set_origin(q);
    sum = dot(q->work.basis.v, q->y0, LDV);
    for (int k = 0; k < q->nw; ++k) {
        sum += e[k] * qp_bound(q, q->row[k]);
    }
    *feed = sum;
    return isfinite(vv);
}
