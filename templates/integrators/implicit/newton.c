/* Stages of implicit Runge-Kutta schemes whose coefficients a are lower triangular. With the increment D_i = h a_ii K_i
 * of an implicit stage (a_ii > 0) or D_i = h K_i of an explicit one (a_ii = 0),
 *
 *     base_i = x + sum_{j<i} increment_a[i][j] D_j,   X_i = base_i + D_i (explicit: base_i),   K_i = f(X_i, u, p),
 *     x_next = x + sum_i increment_b[i] D_i.
 *
 * No number is divided by h, and M^-1 damps the rounding errors of f, M = I - h a_ii f_x. */

/* A stage: its point, the derivatives J = [f_x f_u] there, the factors of M with the order of their rows. */
typedef struct {
    real_t X[NX], J[NX][NZ], M[NX][NX];
    int order[NX];
} stage_t;

/* M = P' L U with row exchanges; pivots are compared in the scales of their states, and the diagonal of U is stored as
 * its inverse. Returns the state whose column has no pivot above rounding errors, or -1. */
static int factorize_stage(real_t (*M)[NX], int *order)
{
    for (int i = 0; i < NX; i++) {
        order[i] = i;
    }
    for (int j = 0; j < NX; j++) {
        int best = j;
        for (int i = j + 1; i < NX; i++) {
            if (FABS(M[i][j]) * z_scale[order[best]] > FABS(M[best][j]) * z_scale[order[i]]) {
                best = i;
            }
        }
        const int row = order[best];
        order[best] = order[j];
        order[j] = row;
        for (int c = 0; c < NX; c++) {
            const real_t moved = M[best][c];
            M[best][c] = M[j][c];
            M[j][c] = moved;
        }
        if (!(FABS(M[j][j]) * z_scale[j] > TOL_UNIT * z_scale[order[j]]) || !isfinite(M[j][j])) {
            return j;
        }
        M[j][j] = R(1) / M[j][j];
        for (int i = j + 1; i < NX; i++) {
            M[i][j] *= M[j][j];
            for (int c = j + 1; c < NX; c++) {
                M[i][c] -= M[i][j] * M[j][c];
            }
        }
    }
    return -1;
}

/* Y = M^-1 B for n columns. */
static inline void solve_stage_columns(const stage_t *t, const real_t *B, real_t *Y, int n)
{
    for (int i = 0; i < NX; i++) {
        for (int c = 0; c < n; c++) {
            Y[i * n + c] = B[t->order[i] * n + c];
        }
        for (int j = 0; j < i; j++) {
            for (int c = 0; c < n; c++) {
                Y[i * n + c] -= t->M[i][j] * Y[j * n + c];
            }
        }
    }
    for (int i = NX - 1; i >= 0; i--) {
        for (int j = i + 1; j < NX; j++) {
            for (int c = 0; c < n; c++) {
                Y[i * n + c] -= t->M[i][j] * Y[j * n + c];
            }
        }
        for (int c = 0; c < n; c++) {
            Y[i * n + c] *= t->M[i][i];
        }
    }
}

/* Y = M'^-1 B for n <= NZ columns. */
static inline void solve_stage_transposed(const stage_t *t, const real_t *B, real_t *Y, int n)
{
    real_t W[NX * NZ];
    for (int i = 0; i < NX; i++) {
        for (int c = 0; c < n; c++) {
            W[i * n + c] = B[i * n + c];
        }
        for (int j = 0; j < i; j++) {
            for (int c = 0; c < n; c++) {
                W[i * n + c] -= t->M[j][i] * W[j * n + c];
            }
        }
        for (int c = 0; c < n; c++) {
            W[i * n + c] *= t->M[i][i];
        }
    }
    for (int i = NX - 1; i >= 0; i--) {
        for (int j = i + 1; j < NX; j++) {
            for (int c = 0; c < n; c++) {
                W[i * n + c] -= t->M[j][i] * W[j * n + c];
            }
        }
        for (int c = 0; c < n; c++) {
            Y[t->order[i] * n + c] = W[i * n + c];
        }
    }
}

/* Largest entry of a step d of the point X, in the size of its state; `worst` is its state. */
static real_t size_of_correction(const real_t *d, const real_t *X, int *worst)
{
    real_t most = R(0);
    *worst = 0;
    for (int i = 0; i < NX; i++) {
        const real_t size = FABS(d[i]) / (FABS(X[i]) + z_scale[i]);
        if (!(size <= most)) { /* NaN, too */
            most = size;
            *worst = i;
        }
    }
    return most;
}

/* X -= M^-1 (X - base - ha f), for slopes f at X. Returns the size of this step. */
static real_t correct_point(stage_t *t, const real_t *base, real_t ha, const real_t *f, real_t *d, int *worst)
{
    real_t rest[NX];
    for (int i = 0; i < NX; i++) {
        rest[i] = t->X[i] - base[i] - ha * f[i];
    }
    solve_stage_columns(t, rest, d, 1);
    const real_t size = size_of_correction(d, t->X, worst);
    for (int i = 0; i < NX; i++) {
        t->X[i] -= d[i];
    }
    return size;
}

/* A stage that cannot be solved: its point is NaN, so that the end of the interval is. Returns the reason. */
static int fail_stage(stage_t *t, int reason)
{
    for (int i = 0; i < NX; i++) {
        t->X[i] = (real_t)NAN;
        t->order[i] = i;
        for (int j = 0; j < NX; j++) {
            t->M[i][j] = R(0);
        }
    }
    return reason;
}

/* Derivatives at the point, and the factors of M. */
static int factorize_at_point(stage_t *t, const real_t *u, const real_t *p, real_t ha, real_t *f)
{
    STAGE_SLOPES(t->X, u, p, f, t->J);
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < NX; j++) {
            t->M[i][j] = ((i == j) ? R(1) : R(0)) - ha * t->J[i][j];
        }
    }
    return factorize_stage(t->M, t->order);
}

/* An implicit stage, from the point in X: `newton` Newton steps, or as many as rounding errors allow if there are
 * NEWTON_LIMIT, and one more with the factors of the last, whose magnitude is added to `left`. Returns -1, the
 * state whose column of M has no pivot, or NX plus the state that does not converge. */
static int solve_stage(
    stage_t *t, const real_t *base, const real_t *u, const real_t *p, real_t ha, int newton, real_t *left)
{
    real_t f[NX], d[NX], size = INF;
    int worst = 0;
    memset(t->J, 0, sizeof t->J);
    for (int n = 0; n < newton; n++) {
        const real_t before = size;
        const int singular = factorize_at_point(t, u, p, ha, f);
        if (singular >= 0) {
            return fail_stage(t, singular);
        }
        size = correct_point(t, base, ha, f, d, &worst);
        if (!(size < INF)) {
            return fail_stage(t, NX + worst);
        }
        if (newton == NEWTON_LIMIT && size <= ((size >= R(0.5) * before) ? TOL_NEWTON_STALLED : TOL_NEWTON)) {
            break;
        }
    }
    if (newton == NEWTON_LIMIT && !(size <= TOL_NEWTON_STALLED)) {
        return fail_stage(t, NX + worst);
    }
    STAGE_SLOPE(t->X, u, p, f);
    (void)correct_point(t, base, ha, f, d, &worst);
    for (int i = 0; i < NX; i++) {
        left[i] += FABS(d[i]);
    }
    return -1;
}
