/* Stages and steps, and their derivatives along n columns of directions (V, U) = d(x, u). */

/* Computes base_i of the stages of group b. */
static void stage_base(const real_t *x, int b, real_t (*D)[NX], real_t *base)
{
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX; r++) {
            base[i * NX + r] = x[r];
        }
        for (int j = 0; j < b * GROUP; j++) {
            for (int r = 0; r < NX; r++) {
                base[i * NX + r] += increment_a[(b * GROUP + i) * STAGES + j] * D[j][r];
            }
        }
    }
}

/* Computes h A of the stages of group b. */
static inline void stage_lengths(real_t h, int b, real_t *ha)
{
    for (int i = 0; i < GROUP * GROUP; i++) {
        ha[i] = h * stage_a[b * GROUP * GROUP + i];
    }
}

/* Computes points, increments and derivatives of the stages of group b of a step from x. Newton's method starts at
 * `point`, the last point before, where fast states have settled; extrapolation by their slopes would diverge. The last
 * one of these stages replaces it. Returns the reason of a failure, or -1. */
static int run_stage(stage_t *t, real_t *point, real_t (*D)[NX], int b, const real_t *x, const real_t *u,
    const real_t *p, real_t h, int newton, real_t *left)
{
    real_t base[GROUP * NX];
    int failed = -1;
    stage_base(x, b, D, base);
    if (EXPLICIT_FIRST && b == 0) {
        real_t f[NX];
        (void)memcpy(t->X, base, sizeof base);
        (void)memset(t->J, 0, sizeof t->J);
        STAGE_SLOPES(t->X, u, p, f, t->J[0]);
        for (int r = 0; r < NX; r++) {
            D[b][r] = h * f[r];
        }
    } else {
        real_t ha[GROUP * GROUP];
        stage_lengths(h, b, ha);
        for (int i = 0; i < GROUP; i++) {
            for (int r = 0; r < NXA; r++) {
                t->X[i * NXA + r] = point[r];
            }
        }
        failed = solve_stage(t, base, u, p, ha, newton, left);
        for (int i = 0; i < GROUP; i++) {
            for (int r = 0; r < NX; r++) {
                D[b * GROUP + i][r] = t->X[i * NXA + r] - base[i * NX + r];
            }
        }
    }
    (void)memcpy(point, &t->X[(GROUP - 1) * NXA], NXA * sizeof *point);
    return failed;
}

/* x += sum_i increment_b[i] D_i; the state of `point` becomes x. */
static void end_step(real_t *x, real_t (*D)[NX], real_t *point)
{
    for (int i = 0; i < STAGES; i++) {
        for (int r = 0; r < NX; r++) {
            x[r] += increment_b[i] * D[i][r];
        }
    }
    (void)memcpy(point, x, NX * sizeof *x);
}

/* Sets the point at the start of an interval: x, and the known values of z. */
static inline void start_point(real_t *point, const real_t *x, const real_t *z)
{
    (void)memcpy(point, x, NX * sizeof *x);
    for (int r = 0; r < NALG; r++) {
        point[NX + r] = z[r];
    }
}

/* Takes one step of length h in place. Returns the reason why the group of stages `failing` fails, or -1. */
static int step_in_place(
    real_t *x, real_t *point, const real_t *u, const real_t *p, real_t h, int newton, int *failing, real_t *left)
{
    stage_t stage;
    real_t D[STAGES][NX];
    for (int b = 0; b < GROUPS; b++) {
        const int reason = run_stage(&stage, point, D, b, x, u, p, h, newton, left);
        if (reason >= 0) {
            for (int r = 0; r < NX; r++) {
                x[r] = (real_t)NAN;
            }
            *failing = b;
            return reason;
        }
    }
    end_step(x, D, point);
    return -1;
}

/* x_next = one step of length h from x. */
static void implicit_step(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *h, int newton, real_t *x_next)
{
    real_t end[NX], left[NX] = {R(0)}, point[NXA];
    int failing;
    (void)memcpy(end, x, sizeof end);
    start_point(point, x, z);
    (void)step_in_place(end, point, u, p, *h, newton, &failing, left);
    (void)memcpy(x_next, end, sizeof end);
}

/* x_next = STEPS steps over dt from x; `left` is the residual of Newton's method in the stages. */
static void implicit_value(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, real_t *x_next, real_t *left)
{
    real_t end[NX], point[NXA];
    int reason = -1, failing;
    (void)memcpy(end, x, sizeof end);
    start_point(point, x, z);
    (void)memset(left, 0, NX * sizeof *left);
    for (int step = 0; step < STEPS && reason < 0; step++) {
        reason = step_in_place(end, point, u, p, *dt / (real_t)STEPS, newton, &failing, left);
    }
    (void)memcpy(x_next, end, sizeof end);
}

/* Finds the first stages of STEPS steps that cannot be solved: reason, step, group of stages; reason -1 if there are
 * none. */
static void implicit_failure(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *failure)
{
    real_t end[NX], left[NX] = {R(0)}, point[NXA];
    int reason = -1, failing = 0;
    (void)memcpy(end, x, sizeof end);
    start_point(point, x, z);
    failure[1] = R(0);
    for (int step = 0; step < STEPS && reason < 0; step++) {
        reason = step_in_place(end, point, u, p, *dt / (real_t)STEPS, newton, &failing, left);
        failure[1] = (real_t)step;
    }
    failure[0] = (real_t)reason;
    failure[2] = (real_t)failing;
}

/* y += factor f_u U of stage i of the group, for the first or the other rows of f. */
static inline void add_forcing(
    const stage_t *t, int i, int first, int last, real_t factor, const real_t *U, int n, real_t *y)
{
    for (int r = first; r < last; r++) {
        for (int j = 0; j < NU; j++) {
            const real_t slope = factor * t->J[i][r][NXA + j];
            for (int c = 0; c < n; c++) {
                y[r * n + c] += slope * U[j * n + c];
            }
        }
    }
}

/* Computes the columns of an explicit stage: Z = base, DV = h (f_x Z + f_u U). */
static inline void explicit_columns(
    const stage_t *t, real_t h, const real_t *V, const real_t *U, int n, real_t *DV, real_t *Z)
{
    for (int r = 0; r < NX; r++) {
        for (int c = 0; c < n; c++) {
            Z[r * n + c] = V[r * n + c];
            DV[r * n + c] = R(0);
        }
    }
    for (int r = 0; r < NX; r++) {
        for (int j = 0; j < NX; j++) {
            const real_t slope = h * t->J[0][r][j];
            for (int c = 0; c < n; c++) {
                DV[r * n + c] += slope * V[j * n + c];
            }
        }
    }
    add_forcing(t, 0, 0, NX, h, U, n, DV);
}

/* Computes the derivatives of the bases of group b along n columns. */
static inline void base_columns(const real_t *V, int b, int n, real_t (*DV)[NX * NZ], real_t *base)
{
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX * n; r++) {
            base[i * NX * n + r] = V[r];
        }
        for (int j = 0; j < b * GROUP; j++) {
            for (int r = 0; r < NX * n; r++) {
                base[i * NX * n + r] += increment_a[(b * GROUP + i) * STAGES + j] * DV[j][r];
            }
        }
    }
}

/* Computes the derivatives of the points of group b, Z, and of their increments, DV, along n <= NZ columns: Z = M^-1
 * (base + h A f_u U; g_u U), DV = Z - base. */
static inline void stage_columns(
    const stage_t *t, int b, real_t h, const real_t *V, const real_t *U, int n, real_t (*DV)[NX * NZ], real_t *Z)
{
    if (EXPLICIT_FIRST && b == 0) {
        explicit_columns(t, h, V, U, n, DV[0], Z);
        return;
    }
    real_t base[GROUP * NX * NZ], rest[NB * NZ], ha[GROUP * GROUP];
    base_columns(V, b, n, DV, base);
    stage_lengths(h, b, ha);
    for (int i = 0; i < GROUP; i++) {
        real_t *own = &rest[i * NXA * n];
        for (int r = 0; r < NX * n; r++) {
            own[r] = base[i * NX * n + r];
        }
        for (int r = NX * n; r < NXA * n; r++) {
            own[r] = R(0);
        }
        for (int j = 0; j < GROUP; j++) {
            add_forcing(t, j, 0, NX, ha[i * GROUP + j], U, n, own);
        }
        add_forcing(t, i, NX, NXA, R(1), U, n, own);
    }
    solve_stage_columns(t, rest, Z, n);
    for (int i = 0; i < GROUP; i++) {
        for (int r = 0; r < NX * n; r++) {
            DV[b * GROUP + i][r] = Z[i * NXA * n + r] - base[i * NX * n + r];
        }
    }
}

/* V += sum_i increment_b[i] DV_i */
static inline void end_step_of_columns(real_t *V, real_t (*DV)[NX * NZ], int n)
{
    for (int i = 0; i < STAGES; i++) {
        for (int r = 0; r < NX * n; r++) {
            V[r] += increment_b[i] * DV[i][r];
        }
    }
}

/* Takes STEPS steps over dt from x, which becomes their end, and their derivatives along n <= NZ columns (V, U); V
 * becomes the derivatives of the end. The residual of Newton's method is added to `left`. */
static inline void implicit_columns(real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t dt, int newton,
    real_t *V, const real_t *U, int n, real_t *left)
{
    const real_t h = dt / (real_t)STEPS;
    real_t D[STAGES][NX], DV[STAGES][NX * NZ], Z[NB * NZ], point[NXA];
    stage_t stage;
    start_point(point, x, z);
    for (int step = 0; step < STEPS; step++) {
        for (int b = 0; b < GROUPS; b++) {
            (void)run_stage(&stage, point, D, b, x, u, p, h, newton, left);
            stage_columns(&stage, b, h, V, U, n, DV, Z);
        }
        end_step(x, D, point);
        end_step_of_columns(V, DV, n);
    }
}

/* (V, U) = I, NZ columns. */
static void unit_columns(real_t *V, real_t *U)
{
    (void)memset(V, 0, NX * NZ * sizeof *V);
    (void)memset(U, 0, NU * NZ * sizeof *U);
    for (int i = 0; i < NX; i++) {
        V[i * NZ + i] = R(1);
    }
    for (int j = 0; j < NU; j++) {
        U[j * NZ + NX + j] = R(1);
    }
}

/* Computes x_next, S = d x_next / d(x, u), and the residual of Newton's method. */
static void implicit_interval(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, real_t *x_next, real_t *S, real_t *left)
{
    real_t end[NX], U[NU * NZ];
    (void)memcpy(end, x, sizeof end);
    (void)memset(left, 0, NX * sizeof *left);
    unit_columns(S, U);
    implicit_columns(end, z, u, p, *dt, newton, S, U, NZ, left);
    (void)memcpy(x_next, end, sizeof end);
}

/* Computes x_next and S_next = d x_next / du. */
static void implicit_forced(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, real_t *x_next, real_t *S_next)
{
    real_t end[NX], U[NU * NU] = {R(0)}, left[NX] = {R(0)};
    (void)memcpy(end, x, sizeof end);
    for (int j = 0; j < NU; j++) {
        U[j * NU + j] = R(1);
    }
    (void)memset(S_next, 0, NX * NU * sizeof *S_next);
    implicit_columns(end, z, u, p, *dt, newton, S_next, U, NU, left);
    (void)memcpy(x_next, end, sizeof end);
}

/* Computes x_next and S_next = (d x_next / dx) S. */
static void implicit_free(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, const real_t *S, real_t *x_next, real_t *S_next)
{
    real_t end[NX], U[NU * NU] = {R(0)}, left[NX] = {R(0)};
    (void)memcpy(end, x, sizeof end);
    (void)memcpy(S_next, S, NX * NU * sizeof *S_next);
    implicit_columns(end, z, u, p, *dt, newton, S_next, U, NU, left);
    (void)memcpy(x_next, end, sizeof end);
}

/* dx_next = A dx + B du. */
static void implicit_forward(const real_t *x, const real_t *z, const real_t *u, const real_t *p, const real_t *dt,
    int newton, const real_t *dx, const real_t *du, real_t *dx_next)
{
    real_t end[NX], V[NX], left[NX] = {R(0)};
    (void)memcpy(end, x, sizeof end);
    (void)memcpy(V, dx, sizeof V);
    implicit_columns(end, z, u, p, *dt, newton, V, du, 1, left);
    (void)memcpy(dx_next, V, sizeof V);
}
