
/* Xi with every block multiplied out from its own factors, C_n A_{n-1} ... A_{k+1} B_k: O(N^3), for comparison only. */
status_t API(impulse_response_structure_ignored)(const data_t *d, linearization_t *m, real_t (*Xi)[N][NU])
{
    real_t phi[NX][NU];
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    output_jacobians(d, &m->nodes);
    clear_matrix(Xi, N * NOUT);
    for (int n = 0; n < N; n++) {
        set_diagonal_block(&m->nodes, n, Xi);
        for (int k = 0; k < n; k++) {
            start_columns(m, k, phi);
            for (int i = k + 1; i < n; i++) {
                advance_columns(m, i, phi);
            }
            add_block(&m->nodes, n, k, &phi[0][0], Xi);
        }
    }
    return finite_or(&Xi[0][0][0], N * NOUT * N * NU);
}
