/* w += gradient of the general [if NE > 0: and coupled] rows of node k with respect to its state, times their
 * multipliers. */
static void add_row_forces(const solver_t *s, int k, real_t *w)
{
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NE && (k == 0 || k == N); j++) {
            w[i] += ((k == N) ? s->coupled.J_N[j][i] : s->coupled.J_0[j][i]) * s->eta[j];
        }
        for (int j = 0; j < NH && k < N; j++) {
            w[i] += s->node[k].J[j][i] * s->mu[k][j];
        }
        for (int j = 0; j < NH_N && k == N; j++) {
            w[i] += s->terminal.J[j][i] * s->mu_N[j];
        }
    }
}

/* lam_N = q_N + Q_N dx_N + (rows)_N,  lam_k = q_k + Q_k dx_k + S_k' du_k + A_k' lam_{k+1} + (rows)_k. Returns 0 if the
 * gradient with respect to the controls is known not to vanish. */
static int recover_multipliers(solver_t *s)
{
    int held = 1;
    real_t w[NZ];
    real_t least = R(0);
    TERMINAL_ADJOINT(&s->terminal, s->hessian.Q_N, s->step.dx[N], w);
    if (CURVED && s->curved.in_solve) {
        add_terminal_curvature(s, s->step.dx[N], w);
    }
    for (int k = N; k >= 0; k--) {
        if (NE + NH + NH_N > 0) {
            add_row_forces(s, k, w);
        }
        for (int i = 0; i < NX; i++) {
            w[i] += s->mu_x[k][i];
            s->lam[k][i] = w[i];
        }
        if (k == 0) {
            break;
        }
        ADJOINT_STEP(&s->node[k - 1], HESSIAN(s, k - 1), s->step.dx[k - 1], s->step.du[k - 1], w);
        if (CURVED && s->curved.in_solve) {
            add_curvature(s, k - 1, s->step.dx[k - 1], s->step.du[k - 1], w);
        }
        if (CHECK_GRADIENT) {
            held &= controls_hold(s, k - 1, w, &least);
        }
    }
    if (CHECK_GRADIENT && REGULARIZE_REDUCED) {
        held |= s->condensed.regularized;
    }
    for (int f = 0; f < NF; f++) {
        s->lam[0][free_state[f]] = R(0);
    }
    return held;
}
