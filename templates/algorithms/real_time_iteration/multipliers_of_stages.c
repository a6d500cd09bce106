/* Copies lam_k from the QP, which has the stages of the problem. */
static void multiplier_of_qp(const solver_t *s, int k, real_t *lam)
{
    (void)memcpy(lam, condense_multiplier(s, k), NX * sizeof *lam);
    for (int m = 0; k == 0 && m < NG; m++) {
        if (row_is_coupled(m)) {
            /* The QP has no x_0 in coupled rows, so their contribution is added. */
            for (int i = 0; i < NX; i++) {
                lam[i] += s->coupled.J_0[row_index(m)][i] * s->step.mult[m];
            }
        }
    }
    for (int f = 0; k == 0 && f < NF; f++) {
        lam[free_state[f]] = R(0);
    }
}

/* Copies the multipliers of the dynamics from the QP, whose solver has checked them. */
static int multipliers_of_qp(solver_t *s, real_t (*lam)[NX], int checked)
{
    for (int k = 0; k <= N; k++) {
        multiplier_of_qp(s, k, lam[k]);
    }
    return 1;
}
