/* Rows of the QP besides the control bounds, sorted by node: state bounds, general rows h and, at the end, coupled rows
 * r(x_0, x_N). */

#if STATE_ROWS + GENERAL_ROWS + (NE > 0) > 1
enum { ROW_STATE = 0, ROW_GENERAL = 1, ROW_COUPLED = 2 }; /* row_kind */

#endif
static real_t clip(real_t value, real_t lower, real_t upper)
{
    if (value < lower) {
        return lower;
    }
    return (value > upper) ? upper : value;
}

static int all_finite(const real_t *v, int n)
{
    for (int i = 0; i < n; i++) {
        if (!isfinite(v[i])) {
            return 0;
        }
    }
    return 1;
}

#if NG
/* Values of all rows at the iterate. */
static void evaluate_rows(const solver_t *s, real_t *value)
{
#if GENERAL_ROWS
    real_t h[NH + NH_N], J[(NH + NH_N) * NZ];
#endif
#if NE
    real_t r[NE], J_0[NE * NX], J_N[NE * NX];
    COUPLED_ROWS(s, r, J_0, J_N);
#endif
    for (int k = 0; k <= N; k++) {
#if NH
        if (k < N) {
            PATH_ROWS(s, k, h, J);
        }
#endif
#if NH_N
        if (k == N) {
            TERMINAL_ROWS(s, h, J);
        }
#endif
        for (int m = row_first[k]; m < row_first[k + 1]; m++) {
            value[m] = ROW_VALUE(s, m, h, r);
        }
    }
}

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
