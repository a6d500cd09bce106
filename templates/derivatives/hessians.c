/* Second derivatives of every interval along the simulation: H_k = d2 (lam_k' Phi(x_k, u_k, p_k)) / d(x, u)^2 with
 * lam_k = lam[k * NX]. A sweep gives the lower triangle of H_k, [A B] and the next state. */

/* Clears what sweeps do not write and sets x_0. Returns 0 if a number is not finite. */
static int start_hessians(const data_t *d, const real_t *lam, hessians_t *h)
{
    if (!data_finite(d) || !all_finite(lam, N * NX)) {
        return 0;
    }
    copy_state(h->x[0], d->x0);
    clear(&h->S[0][0][0], N * NX * (NX + NU));
    clear(&h->H[0][0][0], N * (NX + NU) * (NX + NU));
    return 1;
}

/* Copies the lower triangles above the diagonal, and checks the results. */
static status_t mirror_hessians(hessians_t *h)
{
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NX + NU; i++) {
            for (int j = 0; j < i; j++) {
                h->H[k][j][i] = h->H[k][i][j];
            }
        }
    }
    if (!all_finite(&h->S[0][0][0], N * NX * (NX + NU)) || !all_finite(&h->x[0][0], (N + 1) * NX)) {
        return NOT_FINITE;
    }
    return finite_or(&h->H[0][0][0], N * (NX + NU) * (NX + NU));
}

/* Forward, backward, and forward with a symmetric recursion: no matrix of NX + NU columns is stored per stage. */
status_t API(hessians_symmetric)(const data_t *d, const real_t lam[N * NX], hessians_t *h)
{
    real_t g[NX + NU], left[NX];
    if (!start_hessians(d, lam, h)) {
        return NOT_FINITE;
    }
    for (int k = 0; k < N; k++) {
        INTERVAL_SYMMETRIC(d, k, h->x[k], d->u[k], &lam[k * NX], h->x[k + 1], h->S[k], g, h->H[k], left);
    }
    return mirror_hessians(h);
}

/* Forward mode over the adjoint: the sensitivities of all stages are stored. */
status_t API(hessians_forward_over_adjoint)(const data_t *d, const real_t lam[N * NX], hessians_t *h)
{
    real_t g[NX + NU], left[NX];
    if (!start_hessians(d, lam, h)) {
        return NOT_FINITE;
    }
    for (int k = 0; k < N; k++) {
        INTERVAL_FORWARD_OVER_ADJOINT(d, k, h->x[k], d->u[k], &lam[k * NX], h->x[k + 1], h->S[k], g, h->H[k], left);
    }
    return mirror_hessians(h);
}
