/* Contract of this part: riccati_backward_stage() and riccati_forward() on packs. Vectors between their steps have
 * whole packs and are stored and loaded as such: a load that spans several earlier stores would wait for all of
 * them. */

/* y = x, n numbers, the rest of the last pack 0. */
PACK_INLINE void packs_fill(real_t *y, const real_t *x, int n)
{
    const int done = n / PACK_WIDTH * PACK_WIDTH;
    for (int i = 0; i < done; i += PACK_WIDTH) {
        *(pack_t *)(y + i) = pack_load(x + i, PACK_WIDTH);
    }
    if (n > done) {
        *(pack_t *)(y + done) = pack_load(x + done, n - done);
    }
}

/* y = x, n numbers, where x has whole packs. */
PACK_INLINE void packs_take(real_t *y, const real_t *x, int n)
{
    const int done = n / PACK_WIDTH * PACK_WIDTH;
    for (int i = 0; i < done; i += PACK_WIDTH) {
        pack_store(y + i, *(const pack_t *)(x + i), PACK_WIDTH);
    }
    if (n > done) {
        pack_store(y + done, *(const pack_t *)(x + done), n - done);
    }
}

/* w = g_k + S_k'(p_{k+1} + P_{k+1} b_k) is the gradient at z = 0. With f the fixed controls:
 *     feed = -M_uu^{-1} (w_u + M_uf du_f),   p_k = w_x + M_xf du_f + K'(w_u + M_uf du_f) */
static void riccati_backward_stage(solver_t *s, int k)
{
    riccati_t *r = &s->riccati;
    real_t v[STATE_WIDTH] PACK_ALIGNED, w[STAGE_WIDTH] PACK_ALIGNED;
    real_t y[NU];
    int any = 0;
    packs_fill(v, r->p[k + 1], NX);
    riccati_add_symmetric(v, r->P[k + 1][0], LDX, r->b[k], NX);
    packs_fill(w, r->work.vectors.rhs.g[k], NZ);
    riccati_combine(w, v, stage_S(s, k)[0], NZ, NX, NZ);
    for (int j = 0; j < NU; j++) {
        r->h[k][j] = w[NX + j];
        any |= r->fixed[k * NU + j];
    }
    if (any) {
        riccati_add_fixed(r, k, w);
    }
    for (int j = 0; j < NU; j++) {
        y[j] = r->fixed[k * NU + j] ? R(0) : w[NX + j];
    }
    riccati_combine(w, y, r->K[k][0], LDX, NU, NX);
    packs_take(r->p[k], w, NX);
    riccati_solve_controls(r, k, y);
    for (int j = 0; j < NU; j++) {
        r->feed[k][j] = r->fixed[k * NU + j] ? r->du[k * NU + j] : -y[j];
    }
}

#if NU <= PACK_WIDTH
/* Lanes of zeros and of the controls u for the pack of z that holds u_0, and for the next one. */
#define CONTROL_START (NX % PACK_WIDTH)
#define CONTROL_LANE(i) (((i) < CONTROL_START) ? (i) : PACK_WIDTH + (i)-CONTROL_START)
#define CONTROL_REST(i) (((i) < CONTROL_START) ? 2 * PACK_WIDTH + (i)-CONTROL_START : 0)

/* Adds u, whose last lanes are 0, to z = (x, 0). */
PACK_INLINE void riccati_append_controls(real_t *z, pack_t u)
{
    const pack_t zero = {0};
    pack_t *first = (pack_t *)(z + NX / PACK_WIDTH * PACK_WIDTH);
#if PACK_WIDTH == 8
    const pack_t start = __builtin_shufflevector(zero, u, CONTROL_LANE(0), CONTROL_LANE(1), CONTROL_LANE(2),
        CONTROL_LANE(3), CONTROL_LANE(4), CONTROL_LANE(5), CONTROL_LANE(6), CONTROL_LANE(7));
    const pack_t rest = __builtin_shufflevector(zero, u, CONTROL_REST(0), CONTROL_REST(1), CONTROL_REST(2),
        CONTROL_REST(3), CONTROL_REST(4), CONTROL_REST(5), CONTROL_REST(6), CONTROL_REST(7));
#else
    const pack_t start =
        __builtin_shufflevector(zero, u, CONTROL_LANE(0), CONTROL_LANE(1), CONTROL_LANE(2), CONTROL_LANE(3));
    const pack_t rest =
        __builtin_shufflevector(zero, u, CONTROL_REST(0), CONTROL_REST(1), CONTROL_REST(2), CONTROL_REST(3));
#endif
    first[0] = (CONTROL_START == 0) ? start : first[0] + start;
    if (CONTROL_START + NU > PACK_WIDTH) {
        first[1] = rest;
    }
}

#endif
/* z = (x, u),  u = feed_k + K_k x,  where z holds x and zeros. */
PACK_INLINE void riccati_choose_controls(const riccati_t *r, int k, real_t *z, real_t *u)
{
    if (NU <= PACK_WIDTH) {
        const pack_t sums = pack_load(r->feed[k], NU) + riccati_row_products(r->K[k][0], LDX, z, NU, NX);
        pack_store(u, sums, NU);
        riccati_append_controls(z, sums);
    } else {
        for (int j = 0; j < NU; j++) {
            u[j] = r->feed[k][j] + riccati_dot(r->K[k][j], z, NX);
        }
        for (int j = 0; j < NU; j++) {
            z[NX + j] = u[j];
        }
    }
}

/* u_k = feed_k + K_k x_k,  x_{k+1} = S_k (x_k, u_k) + b_k. */
static void riccati_forward(solver_t *s, real_t (*x)[NX], real_t *u)
{
    const int done = NX / PACK_WIDTH * PACK_WIDTH;
    const riccati_t *r = &s->riccati;
    real_t z[2][STAGE_WIDTH] PACK_ALIGNED = {{0}};
    if (NF > 0) {
        riccati_solve_free(r, x[0]);
    }
    packs_fill(z[0], x[0], NX);
    for (int k = 0; k < N; k++) {
        const real_t *S = stage_S(s, k)[0];
        real_t *from = z[k % 2], *to = z[1 - k % 2];
        riccati_choose_controls(r, k, from, u + k * NU);
        for (int i = 0; i < done; i += PACK_WIDTH) {
            const pack_t next = pack_load(r->b[k] + i, PACK_WIDTH);
            *(pack_t *)(to + i) = next + riccati_row_products(S + i * NZ, NZ, from, PACK_WIDTH, NZ);
        }
        if (NX > done) {
            const pack_t next = pack_load(r->b[k] + done, NX - done);
            *(pack_t *)(to + done) = next + riccati_row_products(S + done * NZ, NZ, from, NX - done, NZ);
        }
        packs_take(x[k + 1], to, NX);
    }
}
