/* Solves L D L'y = y for the free controls; the entries of fixed controls are 0 and remain 0. */
static inline void riccati_solve_controls(const riccati_t *r, int k, real_t *y)
{
    for (int j = 1; j < NU; j++) {
        for (int i = 0; i < j; i++) {
            y[j] -= r->L[k][j][i] * y[i];
        }
    }
    for (int j = NU - 1; j >= 0; j--) {
        y[j] *= r->L[k][j][j];
        for (int i = j + 1; i < NU; i++) {
            y[j] -= r->L[k][i][j] * y[i];
        }
    }
}

/* Returns entry (i, j) of the control block of M_k, from its lower triangle. */
static inline real_t riccati_control_entry(const riccati_t *r, int k, int i, int j)
{
    const int row = (i < j) ? j : i, column = (i < j) ? i : j;
    return r->M[k][row][NX + column];
}

/* w += M_f du_f, where f are the fixed controls. */
static inline void riccati_add_fixed(const riccati_t *r, int k, real_t *w)
{
    for (int j = 0; j < NU; j++) {
        if (r->fixed[k * NU + j]) {
            const real_t du = r->du[k * NU + j];
            riccati_combine(w, &du, r->M[k][j], LDZ, 1, NX);
            for (int i = 0; i < NU; i++) {
                w[NX + i] += du * riccati_control_entry(r, k, i, j);
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
    real_t v[LDX], w[NZ], y[NU];
    int gaps = 0;
    (void)memcpy(v, r->p[k + 1], sizeof v);
    for (int i = 0; i < NX; i++) {
        gaps |= r->b[k][i] < R(0) || !(r->b[k][i] <= R(0));
    }
    if (gaps) {
        riccati_combine(v, r->b[k], r->P[k + 1][0], LDX, NX, LDX);
    }
    (void)memcpy(w, r->work.vectors.rhs.g[k], sizeof w);
    riccati_combine(w, v, stage_S(s, k)[0], NZ, NX, NZ);
    (void)memcpy(r->h[k], w + NX, sizeof r->h[k]);
    riccati_add_fixed(r, k, w);
    for (int j = 0; j < NU; j++) {
        y[j] = r->fixed[k * NU + j] ? R(0) : w[NX + j];
    }
    (void)memcpy(r->p[k], w, sizeof w[0] * NX);
    riccati_combine(r->p[k], y, r->K[k][0], LDX, NU, LDX);
    riccati_solve_controls(r, k, y);
    for (int j = 0; j < NU; j++) {
        r->feed[k][j] = r->fixed[k * NU + j] ? r->du[k * NU + j] : -y[j];
    }
}

#else
static void riccati_backward_stage(solver_t *s, int k);

#endif
/* Computes p, feed and h of the stages last .. 0; last = N: all stages and p_N. */
static void riccati_backward(solver_t *s, int last)
{
    riccati_t *r = &s->riccati;
    if (last == N) {
        (void)memcpy(r->p[N], r->work.vectors.rhs.g[N], sizeof r->p[0][0] * NX);
    }
    for (int k = last < N ? last : N - 1; k >= 0; k--) {
        riccati_backward_stage(s, k);
    }
}

/* Solves for the free components f of x_0: P_ff x_f = -(p_f + P_fm x_m), where m are the other components. */
static void riccati_solve_free(const riccati_t *r, real_t *x)
{
    real_t y[NX];
    for (int f = 0; f < NF; f++) {
        x[free_state[f]] = R(0);
    }
    for (int f = 0; f < NF; f++) {
        y[f] = -r->p[0][free_state[f]] - riccati_dot(r->P[0][free_state[f]], x, NX);
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
}

#if TILES
#include "riccati/substitute_lanes.c"
#else
/* u_k = feed_k + K_k x_k,  x_{k+1} = S_k (x_k, u_k) + b_k. */
static void riccati_forward(solver_t *s, real_t (*x)[NX], real_t *u)
{
    const riccati_t *r = &s->riccati;
    real_t z[LDZ] = {0};
    riccati_solve_free(r, x[0]);
    (void)memcpy(z, x[0], sizeof x[0]);
    for (int k = 0; k < N; k++) {
        real_t(*S)[NZ] = stage_S(s, k);
        for (int j = 0; j < NU; j++) {
            z[NX + j] = r->feed[k][j] + riccati_dot(r->K[k][j], z, LDX);
            u[k * NU + j] = z[NX + j];
        }
        for (int i = 0; i < NX; i++) {
            x[k + 1][i] = r->b[k][i] + riccati_dot(S[i], z, NZ);
        }
        (void)memcpy(z, x[k + 1], sizeof x[0]);
    }
}

#endif
static void riccati_init(solver_t *s)
{
    (void)memset(&s->riccati, 0, sizeof s->riccati);
}
