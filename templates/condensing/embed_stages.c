/* Bounds of the controls and rows relative to the present iterate, penalties; of J_0 dx_0 of a coupled row what is known. */
static void condense_embed(solver_t *s)
{
    int k, j, m;
    for (k = 0; k < N; k++) {
        for (j = 0; j < NU; j++) {
            s->qp.lower[k * NU + j] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[k * NU + j] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    for (m = 0; m < NG; m++) {
        real_t value = stage_row_value(s, m);
        for (j = 0; row_kind[m] == 2 && j < NX; j++) {
            value += is_free[j] ? R(0) : s->coupled.J_0[row_index[m]][j] * s->step.dx[0][j];
        }
        s->qp.lower[NV + m] = row_lower(s, m) - value;
        s->qp.upper[NV + m] = row_upper(s, m) - value;
        s->qp.penalty[m] = row_penalty(s, m);
        s->qp.curvature[m] = row_curvature(m);
    }
}
