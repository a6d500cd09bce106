/* lam = P_k x + p_k. */
static void riccati_adjoint(const riccati_t *r, int k, const real_t *x, real_t *lam)
{
    (void)memcpy(lam, r->p[k], sizeof lam[0] * NX);
    if (TILES) {
        riccati_add_symmetric(lam, r->P[k][0], LDX, x, NX);
    } else {
        riccati_combine(lam, x, r->P[k][0], LDX, NX, NX);
    }
}

/* Returns h_j + M_j z at stage k, where M_j is the row of control j. */
static real_t riccati_control_gradient(const riccati_t *r, int k, int j, const real_t *x, const real_t *u)
{
    real_t sum = r->h[k][j] + riccati_dot(r->M[k][j], x, NX);
    for (int i = 0; i < NU; i++) {
        sum += u[i] * riccati_control_entry(r, k, i, j);
    }
    return sum;
}
