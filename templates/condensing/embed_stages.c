#if NG
/* Bounds of the rows relative to the present iterate, and the costs of their violation. The known part of J_0 dx_0 of a
 * coupled row is included. */
static void condense_embed_rows(solver_t *s)
{
    for (int m = 0; m < NG; ++m) {
        real_t value = stage_row_value(s, m);
#if NE
        for (int i = 0; IS_COUPLED(m) && i < NX; ++i) {
            value += is_free[i] ? R(0.0) : s->coupled.J_0[row_index[m]][i] * s->step.dx[0][i];
        }
#endif
        s->qp.lower[NV + m] = ROW_LOWER(s, m) - value;
        s->qp.upper[NV + m] = ROW_UPPER(s, m) - value;
        s->qp.penalty[m] = ROW_PENALTY(s, m);
        s->qp.curvature[m] = ROW_CURVATURE(m);
    }
}

#endif
/* Bounds of the controls and rows relative to the present iterate, and penalties. */
static void condense_embed(solver_t *s)
{
    for (int k = 0; k < N; ++k) {
        for (int j = 0; j < NU; ++j) {
            s->qp.lower[k * NU + j] = CONTROL_LOWER(s, k, j) - s->u[k][j];
            s->qp.upper[k * NU + j] = CONTROL_UPPER(s, k, j) - s->u[k][j];
        }
    }
#if NG
    condense_embed_rows(s);
#endif
}
