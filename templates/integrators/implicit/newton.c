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

static void exchange_rows(real_t (*M)[NX], int *order, int i, int j)
{
    const int row = order[i];
    order[i] = order[j];
    order[j] = row;
    for (int c = 0; c < NX; c++) {
        const real_t moved = M[i][c];
        M[i][c] = M[j][c];
        M[j][c] = moved;
    }
}

/* M = P' L U with row exchanges; pivots are compared in the scales of their states, and the diagonal of U is stored as
 * its inverse. Returns the state whose column has no pivot above rounding errors, or -1. */
static int factorize_stage(real_t (*M)[NX], int *order)
{
    for (int i = 0; i < NX; i++) {
        order[i] = i;
    }
    for (int j = 0; j < NX; j++) {
        int best = j;
        real_t largest = R(0);
        for (int i = j; i < NX; i++) {
            const real_t size = FABS(M[i][j]) * state_unit[order[i]];
            if (size > largest) {
                largest = size;
                best = i;
            }
        }
        if (!(largest > TOL_UNIT * state_unit[j]) || !isfinite(largest)) {
            return j;
        }
        if (best != j) {
            exchange_rows(M, order, best, j);
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
        const real_t size = FABS(d[i]) * state_unit[i] / (FABS(X[i]) * state_unit[i] + R(1));
        if (!(size <= most)) { /* NaN, too */
            most = size;
            *worst = i;
        }
    }
    return most;
}

/* X -= d = M^-1 (X - base - ha f), for slopes f at X. */
static void correct_point(stage_t *t, const real_t *base, real_t ha, const real_t *f, real_t *d)
{
    real_t rest[NX];
    for (int i = 0; i < NX; i++) {
        rest[i] = t->X[i] - base[i] - ha * f[i];
    }
    solve_stage_columns(t, rest, d, 1);
    for (int i = 0; i < NX; i++) {
        t->X[i] -= d[i];
    }
}

/* A stage that cannot be solved: its point and its factors are NaN, so that all results are. Returns the reason. */
static int fail_stage(stage_t *t, int reason)
{
    for (int i = 0; i < NX; i++) {
        t->X[i] = (real_t)NAN;
        t->order[i] = i;
        for (int j = 0; j < NX; j++) {
            t->M[i][j] = (real_t)NAN;
        }
    }
    return reason;
}

/* Derivatives at the point, and the factors of M. Returns the state whose column has no pivot, or -1. */
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

/* NX plus the first state whose number is not finite, or -1. */
static int first_not_finite(const real_t *values)
{
    for (int i = 0; i < NX; i++) {
        if (!isfinite(values[i])) {
            return NX + i;
        }
    }
    return -1;
}

/* One Newton step. Returns -1, the state whose column of M has no pivot, or NX plus one whose slope is not finite. */
static int newton_step(stage_t *t, const real_t *base, const real_t *u, const real_t *p, real_t ha, real_t *d)
{
    real_t f[NX];
    const int singular = factorize_at_point(t, u, p, ha, f), undefined = first_not_finite(f);
    if (undefined >= 0 || singular >= 0) {
        return (undefined >= 0) ? undefined : singular;
    }
    correct_point(t, base, ha, f, d);
    return -1;
}

/* Newton steps from the point in X until they are rounding errors. Returns -1, the state whose column of M has no
 * pivot, or NX plus the state that does not converge. */
static int iterate_stage(stage_t *t, const real_t *base, const real_t *u, const real_t *p, real_t ha)
{
    real_t d[NX], size = INF;
    int worst = 0;
    for (int n = 0; n < NEWTON_LIMIT; n++) {
        const real_t before = size;
        const int reason = newton_step(t, base, u, p, ha, d);
        if (reason >= 0) {
            return reason;
        }
        size = size_of_correction(d, t->X, &worst);
        if (size <= ((size >= R(0.5) * before) ? TOL_NEWTON_STALLED : TOL_NEWTON)) {
            return -1;
        }
    }
    return NX + worst;
}

/* `newton` Newton steps from the point in X. Returns the same. */
static int sample_stage(stage_t *t, const real_t *base, const real_t *u, const real_t *p, real_t ha, int newton)
{
    real_t d[NX];
    for (int n = 0; n < newton; n++) {
        const int reason = newton_step(t, base, u, p, ha, d);
        if (reason >= 0) {
            return reason;
        }
    }
    return -1;
}

/* An implicit stage, from the point in X: `newton` Newton steps, or as many as rounding errors allow if there are
 * NEWTON_LIMIT, and one more with the factors of the last, whose magnitude is added to `left`. Returns why it fails, or
 * -1. */
static int solve_stage(
    stage_t *t, const real_t *base, const real_t *u, const real_t *p, real_t ha, int newton, real_t *left)
{
    real_t f[NX], d[NX];
    memset(t->J, 0, sizeof t->J);
    int reason = (newton < NEWTON_LIMIT) ? sample_stage(t, base, u, p, ha, newton) : iterate_stage(t, base, u, p, ha);
    if (reason >= 0) {
        return fail_stage(t, reason);
    }
    STAGE_SLOPE(t->X, u, p, f);
    correct_point(t, base, ha, f, d);
    reason = first_not_finite(t->X);
    if (reason >= 0) {
        return fail_stage(t, reason);
    }
    for (int i = 0; i < NX; i++) {
        left[i] += FABS(d[i]);
    }
    return -1;
}
