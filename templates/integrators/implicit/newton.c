/* Stages of implicit Runge-Kutta schemes. GROUP stages are solved together, with their algebraic variables z if the
 * model has equations g. With increments D_i,
 *
 *     base_i = x + sum_j increment_a[i][j] D_j over the groups before, X_i = base_i + D_i,
 *     D_i = h sum_j a_ij f(X_j, u, p) over its own group,   0 = g(X_i, z_i, u, p),
 *     x_next = x + sum_i increment_b[i] D_i.
 *
 * No number is divided by h, and M^-1 damps the rounding errors of f; M is the derivative of X - base - h a f, and of
 * -g. An explicit first stage (a_ii = 0) has X_i = base_i and D_i = h f. */

/* A group of stages that are solved together: their points (x, z), the derivatives J there with respect to (x, z, u),
 * and the factors of M with the order of their rows. */
typedef struct {
    real_t X[NB], J[GROUP][NXA][NXAU], M[NB][NB];
    int order[NB];
} stage_t;

/* Y = M^-1 B for n columns. */
static inline void solve_stage_columns(const stage_t *t, const real_t *B, real_t *Y, int n)
{
    lu_solve(t->M[0], t->order, NB, B, Y, n);
}

/* Y = M'^-1 B for n <= NZ columns. */
static inline void solve_stage_transposed(const stage_t *t, const real_t *B, real_t *Y, int n)
{
    real_t W[NB * NZ];
    lu_solve_transposed(t->M[0], t->order, NB, B, W, Y, n);
}

/* X -= d = M^-1 (X - base - h A f; -g), for slopes and equations f = (f; g) at X; ha: h A of these stages. */
static void correct_point(stage_t *t, const real_t *base, const real_t *ha, const real_t *f, real_t *d)
{
    real_t rest[NB];
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX; r++) {
            rest[i * NXA + r] = t->X[i * NXA + r] - base[i * NX + r];
        }
        for (int j = 0; j < GROUP; j++) {
            for (int r = 0; r < NX; r++) {
                rest[i * NXA + r] -= ha[i * GROUP + j] * f[j * NXA + r];
            }
        }
        for (int r = NX; r < NXA; r++) {
            rest[i * NXA + r] = -f[i * NXA + r];
        }
    }
    solve_stage_columns(t, rest, d, 1);
    for (int i = 0; i < NB; i++) {
        t->X[i] -= d[i];
    }
}

/* Sets points and factors of stages that cannot be solved to NaN, so that all results are NaN. Returns the reason. */
static int fail_stage(stage_t *t, int reason)
{
    for (int i = 0; i < NB; i++) {
        t->X[i] = (real_t)NAN;
        t->order[i] = i;
        for (int j = 0; j < NB; j++) {
            t->M[i][j] = (real_t)NAN;
        }
    }
    return reason;
}

/* Computes the rows of M that belong to stage i. */
static void form_rows(stage_t *t, const real_t *ha, int i)
{
    for (int j = 0; j < GROUP; j++) {
        for (int r = 0; r < NX; r++) {
            for (int c = 0; c < NXA; c++) {
                const real_t unit = (i == j && r == c) ? R(1) : R(0);
                t->M[i * NXA + r][j * NXA + c] = unit - ha[i * GROUP + j] * t->J[j][r][c];
            }
        }
        for (int r = NX; r < NXA; r++) {
            for (int c = 0; c < NXA; c++) {
                t->M[i * NXA + r][j * NXA + c] = (i == j) ? -t->J[i][r][c] : R(0);
            }
        }
    }
}

/* Computes the derivatives at the points, and the factors of M. Returns -1 on success, or the index of a variable whose
 * column has no pivot. */
static int factorize_at_point(stage_t *t, const real_t *u, const real_t *p, const real_t *ha, real_t *f)
{
    for (int i = 0; i < GROUP; i++) {
        STAGE_SLOPES(&t->X[i * NXA], u, p, &f[i * NXA], t->J[i]);
    }
    for (int i = 0; i < GROUP; i++) {
        form_rows(t, ha, i);
    }
    return lu_factorize(t->M[0], t->order, state_unit, NB);
}

/* Returns NXA plus the index of the first number that is not finite, or -1 if all are finite. */
static int first_not_finite(const real_t *values)
{
    for (int i = 0; i < NB; i++) {
        if (!isfinite(values[i])) {
            return NXA + i % NXA;
        }
    }
    return -1;
}

/* Takes one Newton step. Returns -1 on success, the index of a variable whose column of M has no pivot, or NXA plus the
 * index of a variable whose slope is not finite. */
static int newton_step(stage_t *t, const real_t *base, const real_t *u, const real_t *p, const real_t *ha, real_t *d)
{
    real_t f[NB];
    const int singular = factorize_at_point(t, u, p, ha, f), undefined = first_not_finite(f);
    if (undefined >= 0 || singular >= 0) {
        return (undefined >= 0) ? undefined : singular % NXA;
    }
    correct_point(t, base, ha, f, d);
    return -1;
}

/* Takes Newton steps from the points in X until the steps are at rounding level. Returns -1 on success, the index of a
 * variable whose column of M has no pivot, or NXA plus the index of a variable that does not converge. */
static int iterate_stage(stage_t *t, const real_t *base, const real_t *u, const real_t *p, const real_t *ha)
{
    real_t d[NB], size = INF;
    int worst = 0;
    for (int n = 0; n < NEWTON_LIMIT; n++) {
        const real_t before = size;
        const int reason = newton_step(t, base, u, p, ha, d);
        if (reason >= 0) {
            return reason;
        }
        size = size_of_correction(d, t->X, state_unit, NB, &worst);
        if (size <= ((size >= R(0.5) * before) ? TOL_NEWTON_STALLED : TOL_NEWTON)) {
            return -1;
        }
    }
    return NXA + worst % NXA;
}

/* Takes `newton` Newton steps from the points in X. Returns -1 on success, the index of a variable whose column of M
 * has no pivot, or NXA plus the index of a variable whose slope is not finite. */
static int sample_stage(stage_t *t, const real_t *base, const real_t *u, const real_t *p, const real_t *ha, int newton)
{
    real_t d[NB];
    for (int n = 0; n < newton; n++) {
        const int reason = newton_step(t, base, u, p, ha, d);
        if (reason >= 0) {
            return reason;
        }
    }
    return -1;
}

/* Solves implicit stages from the points in X by `newton` Newton steps, or to rounding level if `newton` is
 * NEWTON_LIMIT. One more step with the last factors measures the residual, which is added to `left`. Returns -1 on
 * success, or the reason of the failure. */
static int solve_stage(
    stage_t *t, const real_t *base, const real_t *u, const real_t *p, const real_t *ha, int newton, real_t *left)
{
    real_t f[NB], d[NB];
    (void)memset(t->J, 0, sizeof t->J);
    int reason = (newton < NEWTON_LIMIT) ? sample_stage(t, base, u, p, ha, newton) : iterate_stage(t, base, u, p, ha);
    if (reason >= 0) {
        return fail_stage(t, reason);
    }
    for (int i = 0; i < GROUP; i++) {
        STAGE_SLOPE(&t->X[i * NXA], u, p, &f[i * NXA]);
    }
    correct_point(t, base, ha, f, d);
    reason = first_not_finite(t->X);
    if (reason >= 0) {
        return fail_stage(t, reason);
    }
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX; r++) {
            left[r] += FABS(d[i * NXA + r]);
        }
    }
    return -1;
}
