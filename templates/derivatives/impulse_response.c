/* Impulse response matrix Xi[n * NOUT + i][k][j] = dz_n[i] / du_k[j]: D_n on the block diagonal,
 * C_n A_{n-1} ... A_{k+1} B_k below it, 0 above it; G_n = [C_n D_n]. */

/* Computes G_n of all nodes. */
static void output_jacobians(const data_t *d, nodes_t *nodes)
{
    for (int n = 0; n < N; n++) {
        OUTPUT_JACOBIAN(d, n, nodes->x[n], d->u[n], &nodes->G[n][0][0]);
    }
}

/* Writes block (k, k) of Xi, D_k. */
static void set_diagonal_block(const nodes_t *nodes, int k, real_t (*Xi)[N][NU])
{
    for (int i = 0; i < NOUT; i++) {
        for (int j = 0; j < NU; j++) {
            Xi[k * NOUT + i][k][j] = nodes->G[k][i][NX + j];
        }
    }
}

/* Adds C_n S to block (n, k) of Xi. */
static void add_block(const nodes_t *nodes, int n, int k, const real_t *S, real_t (*Xi)[N][NU])
{
    for (int i = 0; i < NOUT; i++) {
        add_columns(nodes->G[n][i], S, Xi[n * NOUT + i][k]);
    }
}

/* Algorithm 6.4: simulates the outputs with one control changed, from its node on. */
status_t API(impulse_response_finite_differences)(const data_t *d, real_t step, trajectory_t *t, real_t (*Xi)[N][NU])
{
    real_t u[NU], x[NX], z[NOUT];
    if (!(step >= TOL_UNIT) || !isfinite(step)) {
        return BAD_ARGUMENT;
    }
    if (API(simulate)(d, t) != OK) {
        return NOT_FINITE;
    }
    clear(&Xi[0][0][0], N * NOUT * N * NU);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t h = perturb_control(d, k, j, step, u);
            copy_state(x, t->x[k]);
            for (int n = k; n < N; n++) {
                const real_t *control = (n == k) ? u : d->u[n];
                OUTPUT(d, n, x, control, z);
                for (int i = 0; i < NOUT; i++) {
                    Xi[n * NOUT + i][k][j] = (z[i] - t->z[n][i]) / h;
                }
                if (n < N - 1) {
                    INTEGRATOR_VALUE(d, n, x, control, x);
                }
            }
        }
    }
    return finite_or(&Xi[0][0][0], N * NOUT * N * NU);
}

/* Algorithm 6.5: column by column, phi = A_{n-1} ... A_{k+1} B_k; m holds the result of sensitivities. */
status_t API(impulse_response_forward)(const data_t *d, linearization_t *m, real_t (*Xi)[N][NU])
{
    real_t phi[NX][NU];
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    output_jacobians(d, &m->nodes);
    clear(&Xi[0][0][0], N * NOUT * N * NU);
    for (int k = 0; k < N; k++) {
        set_diagonal_block(&m->nodes, k, Xi);
        start_columns(m, k, phi);
        for (int n = k + 1; n < N; n++) {
            add_block(&m->nodes, n, k, &phi[0][0], Xi);
            if (n < N - 1) {
                advance_columns(m, n, phi);
            }
        }
    }
    return finite_or(&Xi[0][0][0], N * NOUT * N * NU);
}

/* Returns 1 if n_rows >= 0 and every row is a number n * NOUT + i with n < N, i < NOUT. */
static int rows_exist(const int *rows, int n_rows)
{
    if (n_rows < 0) {
        return 0;
    }
    for (int i = 0; i < n_rows; i++) {
        if (rows[i] < 0 || rows[i] >= N * NOUT) {
            return 0;
        }
    }
    return 1;
}

/* Writes the last block of a row, D_n, and the start of its adjoint, lam = C_n. */
static int start_row(const nodes_t *nodes, int row, real_t *lam, real_t (*xi)[NU])
{
    const int n = row / NOUT, i = row % NOUT;
    for (int j = 0; j < NU; j++) {
        xi[n][j] = nodes->G[n][i][NX + j];
    }
    copy_state(lam, nodes->G[n][i]);
    return n;
}

/* Algorithm 6.6, for the given rows: xi_n = D_n, lam = C_n; xi_k = lam B_k, lam = lam A_k, k = n - 1, ..., 0; m holds
 * the result of sensitivities. */
status_t API(impulse_response_adjoint_matrices)(
    const data_t *d, const int *rows, int n_rows, linearization_t *m, real_t (*Xi)[N][NU])
{
    real_t lam[NX];
    if (!rows_exist(rows, n_rows)) {
        return BAD_INDEX;
    }
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    output_jacobians(d, &m->nodes);
    clear(&Xi[0][0][0], n_rows * N * NU);
    for (int row = 0; row < n_rows; row++) {
        real_t(*xi)[NU] = Xi[row];
        for (int k = start_row(&m->nodes, rows[row], lam, xi) - 1; k >= 0; k--) {
            adjoint_product(m, k, lam, lam, xi[k]);
        }
    }
    return finite_or(&Xi[0][0][0], n_rows * N * NU);
}

/* Algorithm 6.6 with products lam A_k and lam B_k instead of the matrices. */
status_t API(impulse_response_adjoint)(
    const data_t *d, const int *rows, int n_rows, nodes_t *nodes, real_t (*Xi)[N][NU])
{
    real_t lam[NX], lam_x[NX];
    if (!rows_exist(rows, n_rows)) {
        return BAD_INDEX;
    }
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    roll_out(d, N - 1, nodes->x);
    output_jacobians(d, nodes);
    clear(&Xi[0][0][0], n_rows * N * NU);
    for (int row = 0; row < n_rows; row++) {
        real_t(*xi)[NU] = Xi[row];
        for (int k = start_row(nodes, rows[row], lam, xi) - 1; k >= 0; k--) {
            INTEGRATOR_ADJOINT(d, k, nodes->x[k], d->u[k], lam, lam_x, xi[k]);
            copy_state(lam, lam_x);
        }
    }
    return finite_or(&Xi[0][0][0], n_rows * N * NU);
}

/* Algorithms 6.8 and 6.10: block (n, k) is C_n S_n. The first pass, k = 0, yields all states. */
status_t API(impulse_response_alternative)(const data_t *d, response_t *s, real_t (*Xi)[N][NU])
{
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    copy_state(s->nodes.x[0], d->x0);
    clear(&Xi[0][0][0], N * NOUT * N * NU);
    for (int k = 0; k < N; k++) {
        if (k < N - 1) {
            respond(d, k, N - 1, s);
        }
        if (k == 0) {
            output_jacobians(d, &s->nodes);
        }
        set_diagonal_block(&s->nodes, k, Xi);
        for (int n = k + 1; n < N; n++) {
            add_block(&s->nodes, n, k, &s->S[n][0][0], Xi);
        }
    }
    return finite_or(&Xi[0][0][0], N * NOUT * N * NU);
}
