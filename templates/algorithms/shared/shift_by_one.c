/* Moves to each row of node k the multiplier and, for a QP solver, the predicted side of the same row at node k + 1, if
 * it is imposed there. A row that begins at node k + 1 leaves nothing at node k. */
static void shift_rows(solver_t *s)
{
    int source[NG];
    for (int m = 0; m < NG; m++) {
        source[m] = m;
        for (int n = m + 1; n < NG && row_node(n) <= row_node(m) + 1; n++) {
            if (row_node(n) > row_node(m) && row_id(n) == row_id(m)) {
                source[m] = n;
            }
            if (IDLE_END && row_node(n) == N - 1 && !row_is_state(n)) { /* multiplier of an idle control */
                source[m] = m;
            }
        }
        s->mult[m] = s->mult[source[m]]; /* not yet shifted, as source[m] >= m */
    }
    if (HAS_QP) {
        condense_shift_rows(s, source);
    }
}

/* Moves the data of node k + 1 to node k. The last node and the last interval keep their own. So does the control
 * before an idle one, because the idle control affects only its own terms and is no guess for a control that acts. */
static void shift_by_one(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        int from = (k + 1 < N) ? k + 1 : k;
        if (IDLE_END && k + 2 == N) {
            from = k;
        }
        for (int i = 0; i < NX; i++) {
            s->x[k][i] = s->x[k + 1][i];
            s->lam[k][i] = s->lam[k + 1][i];
        }
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = s->u[from][j];
            s->u[k][j] = safe_value(s, k, j);
            s->mu_u[k][j] = s->mu_u[from][j];
        }
    }
    if (HAS_QP) {
        condense_shift(s);
    }
    if (ROWS_MOVE) {
        shift_rows(s);
    }
}
