/* Contract of this part: riccati_stage() in register tiles. P_k is read and written in its lower triangle. */

#define STAGE_WIDTH PACKED(NZ)
#define STATE_WIDTH PACKED(NX)

/* Rows per tile of n rows: equal heights up to one row. */
#define TILE_HEIGHT(n) (((n) + ((n) + TILE_ROWS - 1) / TILE_ROWS - 1) / (((n) + TILE_ROWS - 1) / TILE_ROWS))

/* One stage: T = P_{k+1}S_k, below it M_u and later V = L^{-1}M_ux; W = -D^{-1}V, later K. */
typedef struct {
    real_t T[NZ][STAGE_WIDTH] PACK_ALIGNED;
    real_t W[NU][STATE_WIDTH] PACK_ALIGNED;
} tiled_stage_t;

/* Rows i .. i + rows - 1 and columns j .. j + width - 1 of P S. */
PACK_INLINE void riccati_propagate_tile(
    real_t (*T)[STAGE_WIDTH], real_t (*P)[LDX], real_t (*S)[NZ], int i, int rows, int j, int width)
{
    const int end = i + rows;
    tile_t c;
    tile_clear(&c);
    tile_accumulate(&c, &P[i][0], 1, LDX, &S[0][j], NZ, i, rows, width);
    tile_symmetric(&c, &P[i][i], LDX, &S[i][j], NZ, rows, width);
    if (end < NX) {
        tile_accumulate(&c, &P[end][i], LDX, 1, &S[end][j], NZ, NX - end, rows, width);
    }
    tile_store(&T[i][j], STAGE_WIDTH, &c, rows, PACKED(width));
}

PACK_INLINE void riccati_propagate_columns(
    real_t (*T)[STAGE_WIDTH], real_t (*P)[LDX], real_t (*S)[NZ], int j, int width)
{
    const int height = TILE_HEIGHT(NX), rest = NX % height;
    for (int i = 0; i + height <= NX; i += height) {
        riccati_propagate_tile(T, P, S, i, height, j, width);
    }
    if (rest) {
        riccati_propagate_tile(T, P, S, NX - rest, rest, j, width);
    }
}

/* T = P S */
static void riccati_propagate(real_t (*T)[STAGE_WIDTH], real_t (*P)[LDX], real_t (*S)[NZ])
{
    for (int j = 0; j + TILE_WIDTH <= NZ; j += TILE_WIDTH) {
        riccati_propagate_columns(T, P, S, j, TILE_WIDTH);
    }
    if (NZ % TILE_WIDTH) {
        riccati_propagate_columns(T, P, S, NZ / TILE_WIDTH * TILE_WIDTH, NZ % TILE_WIDTH);
    }
}

/* Rows i .. of M_u and of T + NX: columns j .. of `from` + B'T. */
PACK_INLINE void riccati_control_tile(
    real_t (*M)[LDZ], tiled_stage_t *t, const real_t *from, int ld, real_t (*S)[NZ], int i, int rows, int j, int width)
{
    const real_t *start = from + i * ld;
    tile_t c;
    tile_load(&c, start + j, ld, rows, width);
    tile_accumulate(&c, &S[0][NX + i], NZ, 1, &t->T[0][j], STAGE_WIDTH, NX, rows, PACKED(width));
    tile_store(&t->T[NX + i][j], STAGE_WIDTH, &c, rows, PACKED(width));
    tile_store(&M[i][j], LDZ, &c, rows, width);
}

PACK_INLINE void riccati_control_columns(
    real_t (*M)[LDZ], tiled_stage_t *t, const real_t *from, int ld, real_t (*S)[NZ], int j, int width)
{
    const int height = TILE_HEIGHT(NU), rest = NU % height;
    for (int i = 0; i + height <= NU; i += height) {
        riccati_control_tile(M, t, from, ld, S, i, height, j, width);
    }
    if (rest) {
        riccati_control_tile(M, t, from, ld, S, NU - rest, rest, j, width);
    }
}

/* M_u = from + B'T, also stored below T. */
static void riccati_form_controls(real_t (*M)[LDZ], tiled_stage_t *t, const real_t *from, int ld, real_t (*S)[NZ])
{
    for (int j = 0; j + TILE_WIDTH <= NZ; j += TILE_WIDTH) {
        riccati_control_columns(M, t, from, ld, S, j, TILE_WIDTH);
    }
    if (NZ % TILE_WIDTH) {
        riccati_control_columns(M, t, from, ld, S, NZ / TILE_WIDTH * TILE_WIDTH, NZ % TILE_WIDTH);
    }
}

/* Rows i .. and columns j .. of P = from + A'T_x + W'V. */
PACK_INLINE void riccati_state_tile(real_t (*P)[LDX], const tiled_stage_t *t, const real_t *from, int ld,
    real_t (*S)[NZ], int i, int rows, int j, int width)
{
    const real_t *start = from + i * ld;
    tile_t c;
    tile_load(&c, start + j, ld, rows, width);
    tile_accumulate(&c, &S[0][i], NZ, 1, &t->T[0][j], STAGE_WIDTH, NX, rows, PACKED(width));
    tile_accumulate(&c, &t->W[0][i], STATE_WIDTH, 1, &t->T[NX][j], STAGE_WIDTH, NU, rows, PACKED(width));
    tile_store(&P[i][j], LDX, &c, rows, width);
}

/* The same for the packs of the lower triangle among `width` columns. */
PACK_INLINE void riccati_state_strip(real_t (*P)[LDX], const tiled_stage_t *t, const real_t *from, int ld,
    real_t (*S)[NZ], int i, int rows, int j, int width)
{
    const int needed = i + rows - j; /* columns of the lower triangle */
    if (needed <= 0) {
        return;
    }
    if (width > PACK_WIDTH && needed <= PACK_WIDTH) {
        riccati_state_tile(P, t, from, ld, S, i, rows, j, PACK_WIDTH);
    } else if (width > 2 * PACK_WIDTH && needed <= 2 * PACK_WIDTH) {
        riccati_state_tile(P, t, from, ld, S, i, rows, j, 2 * PACK_WIDTH);
    } else {
        riccati_state_tile(P, t, from, ld, S, i, rows, j, width);
    }
}

PACK_INLINE void riccati_state_columns(
    real_t (*P)[LDX], const tiled_stage_t *t, const real_t *from, int ld, real_t (*S)[NZ], int j, int width)
{
    const int height = TILE_HEIGHT(NX), rest = NX % height;
    for (int i = 0; i + height <= NX; i += height) {
        riccati_state_strip(P, t, from, ld, S, i, height, j, width);
    }
    if (rest) {
        riccati_state_strip(P, t, from, ld, S, NX - rest, rest, j, width);
    }
}

/* P = from + A'T_x + W'V, lower triangle. */
static void riccati_form_states(real_t (*P)[LDX], const tiled_stage_t *t, const real_t *from, int ld, real_t (*S)[NZ])
{
    for (int j = 0; j + TILE_WIDTH <= NX; j += TILE_WIDTH) {
        riccati_state_columns(P, t, from, ld, S, j, TILE_WIDTH);
    }
    if (NX % TILE_WIDTH) {
        riccati_state_columns(P, t, from, ld, S, NX / TILE_WIDTH * TILE_WIDTH, NX % TILE_WIDTH);
    }
}

/* y += a x, whole packs. */
PACK_INLINE void riccati_add_packs(real_t *y, real_t a, const real_t *x)
{
#pragma GCC unroll 4
    for (int i = 0; i < STATE_WIDTH; i += PACK_WIDTH) {
        *(pack_t *)(y + i) += a * *(const pack_t *)(x + i);
    }
}

/* M_uu of the free controls in L (lower triangle), with rows of the identity for the fixed ones, whose V is 0. */
PACK_INLINE void riccati_load_controls(riccati_t *r, int k, real_t (*V)[STAGE_WIDTH])
{
    const int32_t *fixed = &r->fixed[k * NU];
#pragma GCC unroll 4
    for (int j = 0; j < NU; j++) {
        const real_t *M = r->M[k][j];
#pragma GCC unroll 4
        for (int l = 0; l < j; l++) {
            r->L[k][j][l] = (fixed[j] || fixed[l]) ? R(0) : M[NX + l];
        }
        r->L[k][j][j] = fixed[j] ? R(1) : M[NX + j];
        if (fixed[j]) {
            (void)memset(V[j], 0, sizeof V[0]);
        }
    }
}

/* M_uu = L D L' with 1 / D stored on the diagonal of L, V = L^{-1} M_ux, W = -D^{-1} V. Returns 0 if a pivot is not
 * positive. */
static int riccati_eliminate_controls(riccati_t *r, int k, tiled_stage_t *t)
{
    real_t(*L)[NU] = r->L[k];
    real_t(*V)[STAGE_WIDTH] = t->T + NX;
    riccati_load_controls(r, k, V);
    r->raised[k] = 0;
#pragma GCC unroll 4
    for (int l = 0; l < NU; l++) {
        real_t *reference = &r->M[k][l][NX + l], added;
        const real_t pivot = riccati_pivot(r, L[l][l], r->fixed[k * NU + l] ? R(0) : *reference, &added);
        if (!(pivot > R(0))) {
            return 0;
        }
        r->raised[k] |= added > R(0);
        *reference += added;
        L[l][l] = R(1) / pivot;
#pragma GCC unroll 4
        for (int j = l + 1; j < NU; j++) {
            const real_t y = L[j][l];
            L[j][l] = y * L[l][l];
#pragma GCC unroll 4
            for (int i = l + 1; i <= j; i++) {
                L[j][i] -= y * L[i][l];
            }
            riccati_add_packs(V[j], -L[j][l], V[l]);
        }
#pragma GCC unroll 4
        for (int i = 0; i < STATE_WIDTH; i += PACK_WIDTH) {
            *(pack_t *)(t->W[l] + i) = -L[l][l] * *(const pack_t *)(V[l] + i);
        }
    }
    return 1;
}

/* L'K = W. */
PACK_INLINE void riccati_gain(riccati_t *r, int k, tiled_stage_t *t)
{
#pragma GCC unroll 4
    for (int j = NU - 1; j >= 0; j--) {
#pragma GCC unroll 4
        for (int l = j + 1; l < NU; l++) {
            riccati_add_packs(t->W[j], -r->L[k][l][j], t->W[l]);
        }
#pragma GCC unroll 4
        for (int i = 0; i < NX; i += PACK_WIDTH) {
            pack_store(r->K[k][j] + i, *(const pack_t *)(t->W[j] + i), NX - i);
        }
    }
}

#if NG
/* Returns 1 if a row of stage k has a weight. */
PACK_INLINE int riccati_has_weights(const riccati_t *r, int k)
{
    int found = 0;
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        found |= riccati_weight(r, m) != R(0);
    }
    return found;
}

#endif
/* P_k = Q_xx + A'P_{k+1}A - V'D^{-1}V. The Hessian is used in place unless something is added to it. */
static int riccati_stage(solver_t *s, int k)
{
    riccati_t *r = &s->riccati;
    real_t(*S)[NZ] = stage_S(s, k);
    const real_t *states = stage_Q(s, k)[0], *controls = stage_Q(s, k)[NX];
    int ld_states = NZ, ld_controls = NZ, added = 0;
    tiled_stage_t t;
    if (NG) {
        added |= riccati_has_weights(r, k);
    }
    if (NF) {
        added |= k == 0;
    }
    if (added) {
        riccati_load_stage(s, k);
        states = r->P[k][0];
        controls = r->M[k][0];
        ld_states = LDX;
        ld_controls = LDZ;
        for (int f = 0; k == 0 && f < NF; f++) {
            r->P[0][free_state[f]][free_state[f]] += r->diagonal_free[f];
        }
        if (NG) {
            riccati_add_weights(s, k);
        }
    }
    riccati_propagate(t.T, r->P[k + 1], S);
    riccati_form_controls(r->M[k], &t, controls, ld_controls, S);
    for (int j = 0; j < NU && !added; j++) {
        r->M[k][j][NX + j] += r->diagonal[k][j];
    }
    if (!riccati_eliminate_controls(r, k, &t)) {
        r->failed = k;
        return 0;
    }
    riccati_form_states(r->P[k], &t, states, ld_states, S);
    riccati_gain(r, k, &t);
    return 1;
}
