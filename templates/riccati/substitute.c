/* Solves L D L'y = y for the free controls; the entries of fixed controls are 0 and remain 0. */
static inline void riccati_solve_controls(const riccati_t *r, int k, real_t *y)
{
    for (int j = 1; j < NUS; j++) {
        for (int i = 0; i < j; i++) {
            y[j] -= r->L[k][j][i] * y[i];
        }
    }
    for (int j = NUS - 1; j >= 0; j--) {
        y[j] *= r->L[k][j][j];
        for (int i = j + 1; i < NUS; i++) {
            y[j] -= r->L[k][i][j] * y[i];
        }
    }
}

/* Entry (i, j) of the control block of M_k, from its lower triangle. */
static inline real_t riccati_control_entry(const riccati_t *r, int k, int i, int j)
{
    const int row = (i < j) ? j : i, column = (i < j) ? i : j;
    return r->M[k][row][NXS + column];
}

/* w += M_f du_f, where f are the fixed controls. */
static inline void riccati_add_fixed(const riccati_t *r, int k, real_t *w)
{
    for (int j = 0; j < NUS; j++) {
        if (r->fixed[k * NUS + j]) {
            const real_t du = r->du[k * NUS + j];
            riccati_combine(w, &du, r->M[k][j], LDZ, 1, NXS);
            for (int i = 0; i < NUS; i++) {
                w[NXS + i] += du * riccati_control_entry(r, k, i, j);
            }
        }
    }
}

#if !TILES
/* w = g_k + S_k'(p_{k+1} + P_{k+1} b_k) is the gradient at z = 0. With f the fixed controls:
 *     feed = -M_uu^{-1} (w_u + M_uf du_f),   p_k = w_x + M_xf du_f + K'(w_u + M_uf du_f) */
static void riccati_backward_stage(solver_t *s, int k)
{
    riccati_t *r = &s->riccati;
    real_t v[LDX], w[NZS], y[NUS];
    int gaps = 0;
    (void)memcpy(v, r->p[k + 1], sizeof v);
    for (int i = 0; i < NXS; i++) {
        gaps |= r->b[k][i] < R(0) || !(r->b[k][i] <= R(0));
    }
    if (gaps) {
        riccati_combine(v, r->b[k], r->P[k + 1][0], LDX, NXS, LDX);
    }
    (void)memcpy(w, r->work.vectors.rhs.g[k], sizeof w);
    riccati_combine(w, v, stage_S(s, k)[0], NZS, NXS, NZS);
    (void)memcpy(r->h[k], w + NXS, sizeof r->h[k]);
    riccati_add_fixed(r, k, w);
    for (int j = 0; j < NUS; j++) {
        y[j] = r->fixed[k * NUS + j] ? R(0) : w[NXS + j];
    }
    (void)memcpy(r->p[k], w, sizeof w[0] * NXS);
    riccati_combine(r->p[k], y, r->K[k][0], LDX, NUS, LDX);
    riccati_solve_controls(r, k, y);
    for (int j = 0; j < NUS; j++) {
        r->feed[k][j] = r->fixed[k * NUS + j] ? r->du[k * NUS + j] : -y[j];
    }
}

#else
static void riccati_backward_stage(solver_t *s, int k);

#endif
/* p, feed and h of the stages last .. 0; last = NS: all stages and p_NS. */
static void riccati_backward(solver_t *s, int last)
{
    riccati_t *r = &s->riccati;
    if (last == NS) {
        (void)memcpy(r->p[NS], r->work.vectors.rhs.g[NS], sizeof r->p[0][0] * NXS);
    }
    for (int k = last < NS ? last : NS - 1; k >= 0; k--) {
        riccati_backward_stage(s, k);
    }
    for (int c = 0; c < NXS - NX; c++) {
        r->p[0][copied_state[c]] += r->p[0][NX + c];
        r->p[0][NX + c] = R(0);
    }
}

/* Free components f of x_0 and their copies: P_ff x_f = -(p_f + P_fm x_m), where m are the other components. */
static void riccati_solve_free(const riccati_t *r, real_t *x)
{
    real_t y[NXS];
    for (int f = 0; f < NF; f++) {
        x[free_state[f]] = R(0);
    }
    for (int i = NX; i < NXS; i++) {
        x[i] = R(0);
    }
    for (int f = 0; f < NF; f++) {
        y[f] = -r->p[0][free_state[f]] - riccati_dot(r->P[0][free_state[f]], x, NXS);
        for (int i = 0; i < f; i++) {
            y[f] -= r->F[f][i] * y[i];
        }
    }
    for (int f = NF - 1; f >= 0; f--) {
        y[f] /= r->F[f][f];
        for (int i = f + 1; i < NF; i++) {
            y[f] -= r->F[i][f] * y[i];
        }
    }
    for (int f = 0; f < NF; f++) {
        x[free_state[f]] = y[f];
    }
    for (int c = 0; c < NXS - NX; c++) {
        x[NX + c] = x[copied_state[c]];
    }
}

#if TILES
#include "riccati/substitute_lanes.c"
#else
/* u_k = feed_k + K_k x_k,  x_{k+1} = S_k (x_k, u_k) + b_k. */
static void riccati_forward(solver_t *s, real_t (*x)[NXS], real_t *u)
{
    const riccati_t *r = &s->riccati;
    real_t z[LDZ] = {0};
    riccati_solve_free(r, x[0]);
    (void)memcpy(z, x[0], sizeof x[0]);
    for (int k = 0; k < NS; k++) {
        real_t(*S)[NZS] = stage_S(s, k);
        for (int j = 0; j < NUS; j++) {
            z[NXS + j] = r->feed[k][j] + riccati_dot(r->K[k][j], z, LDX);
            u[k * NUS + j] = z[NXS + j];
        }
        for (int i = 0; i < NXS; i++) {
            x[k + 1][i] = r->b[k][i] + riccati_dot(S[i], z, NZS);
        }
        (void)memcpy(z, x[k + 1], sizeof x[0]);
    }
}

#endif
static void riccati_init(solver_t *s)
{
    (void)memset(&s->riccati, 0, sizeof s->riccati);
}
