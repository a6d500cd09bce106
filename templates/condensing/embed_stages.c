/* Bounds of the rows relative to the present iterate, and the costs of their violation. */
static void condense_embed_rows(solver_t *s)
{
    for (int m = 0; m < NG; ++m) {
        real_t value = stage_row_value(s, m);
        if (row_is_coupled(m)) {
            /* the known part of J_0 dx_0 */
            for (int i = 0; i < NX; ++i) {
                value += is_free[i] ? R(0.0) : s->coupled.J_0[row_index(m)][i] * s->step.dx[0][i];
            }
        }
        s->qp.lower[NV + m] = row_lower(s, m) - value;
        s->qp.upper[NV + m] = row_upper(s, m) - value;
        s->qp.penalty[m] = row_penalty(s, m);
        s->qp.curvature[m] = row_l2(s, m);
    }
}

/* Bounds of the controls and rows relative to the present iterate. */
static void condense_embed(solver_t *s)
{
    for (int k = 0; k < N; ++k) {
        for (int j = 0; j < NU; ++j) {
            s->qp.lower[k * NU + j] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[k * NU + j] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    condense_embed_rows(s);
}
