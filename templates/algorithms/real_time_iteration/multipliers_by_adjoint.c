/* w += gradient of the rows of node k with respect to its state, times their multipliers in the QP. */
static void add_row_forces(const solver_t *s, int k, real_t *w)
{
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (row_is_state(m)) {
            w[row_index(m)] += s->step.mult[m];
            continue;
        }
        for (int i = 0; i < NX; i++) {
            w[i] += row_gradient(s, m)[i] * s->step.mult[m];
        }
    }
    for (int j = 0; j < NE && k == 0; j++) {
        for (int i = 0; i < NX; i++) {
            w[i] += s->coupled.J_0[j][i] * s->step.mult[NG - NE + j];
        }
    }
}

/* Computes the multipliers of the dynamics in the QP: lam_N = q_N + Q_N dx_N + (rows)_N,  lam_k = q_k + Q_k dx_k + S_k'
 * du_k + A_k' lam_{k+1} + (rows)_k. Returns 0 if `checked` is set and the gradient with respect to the controls does
 * not vanish. */
static int multipliers_of_qp(solver_t *s, real_t (*lam)[NX], int checked)
{
    int held = 1;
    real_t w[NZ];
    real_t least = R(0);
    TERMINAL_ADJOINT(&s->terminal, s->hessian.Q_N, s->step.dx[N], w);
    if (CURVED && s->curved.in_solve) {
        add_terminal_curvature(s, s->step.dx[N], w);
    }
    for (int k = N; k >= 0; k--) {
        add_row_forces(s, k, w);
        (void)memcpy(lam[k], w, sizeof lam[k]);
        if (k == 0) {
            break;
        }
        ADJOINT_STEP(&s->node[k - 1], HESSIAN(s, k - 1), s->step.dx[k - 1], s->step.du[k - 1], w);
        if (CURVED && s->curved.in_solve) {
            add_curvature(s, k - 1, s->step.dx[k - 1], s->step.du[k - 1], w);
        }
        if (CHECK_STEP && checked) {
            held &= controls_hold(s, k - 1, w, &least);
        }
    }
    if (CHECK_STEP && REGULARIZE_REDUCED) {
        held |= s->condensed.regularized;
    }
    for (int f = 0; f < NF; f++) {
        lam[0][free_state[f]] = R(0);
    }
    return held;
}
