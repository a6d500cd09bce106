/* Returns 1 if a multiplier of the dynamics is nonzero. */
static int has_multipliers(const solver_t *s)
{
    int k, i;
    for (k = 1; k <= N; k++) {
        for (i = 0; i < NX; i++) {
            if (s->lam[k][i] != R(0)) { /* exactly 0 only after reset */
                return 1;
            }
        }
    }
    return 0;
}

/* lam_k = q_k + A_k' lam_{k+1}. */
static void adjoint_node(solver_t *s, int k)
{
    const node_t *node = &s->node[k];
    for (int i = 0; i < NX; i++) {
        real_t sum = node->g[i];
        for (int j = 0; j < NX; j++) {
            sum += node->S[j][i] * s->lam[k + 1][j];
        }
        s->lam[k][i] = sum;
    }
    for (int f = 0; k == 0 && f < NF; f++) {
        s->lam[0][free_state[f]] = R(0); /* no initial condition fixes it */
    }
}
