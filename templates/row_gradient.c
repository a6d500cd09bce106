#if NG
/* Gradient J = (d row / dx, d row / du) and value of row m in the linearisation; of a coupled row J = d row / dx_N. */
static real_t row_gradient(const solver_t *s, int m, real_t *J)
{
    const int i = row_index[m];
    memset(J, 0, NZ * sizeof *J);
#if STATE_ROWS && (GENERAL_ROWS || NE)
    if (row_kind[m] == ROW_STATE) {
        J[i] = R(1);
    }
#elif STATE_ROWS
    J[i] = R(1);
#endif
#if NH
    if (IS_GENERAL(m) && row_node[m] < N) {
        memcpy(J, s->node[row_node[m]].J[i], NZ * sizeof *J);
    }
#endif
#if NH_N
    if (IS_GENERAL(m) && row_node[m] == N) {
        memcpy(J, s->terminal.J[i], NX * sizeof *J);
    }
#endif
#if NE
    if (IS_COUPLED(m)) {
        memcpy(J, s->coupled.J_N[i], NX * sizeof *J);
    }
#endif
    return ROW_CONSTANT(s, m);
}
#endif
