/* Stages and steps, and their derivatives along n columns of directions (V, U) = d(x, u). */

/* base_i */
static void stage_base(const real_t *x, int i, real_t (*D)[NX], real_t *base)
{
    for (int r = 0; r < NX; r++) {
        base[r] = x[r];
    }
    for (int j = 0; j < i; j++) {
        for (int r = 0; r < NX; r++) {
            base[r] += increment_a[i * STAGES + j] * D[j][r];
        }
    }
}

/* Point, increment and derivatives of stage i of a step from x. Newton's method starts at `before`, the point of
 * the stage before or x: fast states have settled there, while their slopes lead away. Returns why it fails, or -1. */
static int run_stage(stage_t *t, const real_t *before, real_t (*D)[NX], int i, const real_t *x, const real_t *u,
    const real_t *p, real_t h, int newton, real_t *left)
{
    real_t base[NX];
    int failed = -1;
    stage_base(x, i, D, base);
    if (EXPLICIT_FIRST && i == 0) {
        real_t f[NX];
        memcpy(t->X, base, sizeof base);
        memset(t->J, 0, sizeof t->J);
        STAGE_SLOPES(t->X, u, p, f, t->J);
        for (int r = 0; r < NX; r++) {
            D[i][r] = h * f[r];
        }
    } else {
        for (int r = 0; r < NX; r++) {
            t->X[r] = before[r];
        }
        failed = solve_stage(t, base, u, p, h * stage_a[i], newton, left);
        for (int r = 0; r < NX; r++) {
            D[i][r] = t->X[r] - base[r];
        }
    }
    return failed;
}

/* x += sum_i increment_b[i] D_i */
static void end_step(real_t *x, real_t (*D)[NX])
{
    for (int i = 0; i < STAGES; i++) {
        for (int r = 0; r < NX; r++) {
            x[r] += increment_b[i] * D[i][r];
        }
    }
}

/* One step of length h in place. Returns why `stage` fails, or -1. */
static int step_in_place(real_t *x, const real_t *u, const real_t *p, real_t h, int newton, int *failing, real_t *left)
{
    stage_t stage;
    real_t D[STAGES][NX];
    for (int i = 0; i < STAGES; i++) {
        const int reason = run_stage(&stage, (i > 0) ? stage.X : x, D, i, x, u, p, h, newton, left);
        if (reason >= 0) {
            for (int r = 0; r < NX; r++) {
                x[r] = (real_t)NAN;
            }
            *failing = i;
            return reason;
        }
    }
    end_step(x, D);
    return -1;
}

/* x_next = one step of length h from x. */
static void implicit_step(
    const real_t *x, const real_t *u, const real_t *p, const real_t *h, int newton, real_t *x_next)
{
    real_t end[NX], left[NX] = {R(0)};
    int failing;
    memcpy(end, x, sizeof end);
    (void)step_in_place(end, u, p, *h, newton, &failing, left);
    memcpy(x_next, end, sizeof end);
}

/* x_next = STEPS steps over dt from x, and what Newton's method leaves of the stages. */
static void implicit_value(
    const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *x_next, real_t *left)
{
    real_t end[NX];
    int reason = -1, failing;
    memcpy(end, x, sizeof end);
    memset(left, 0, NX * sizeof *left);
    for (int step = 0; step < STEPS && reason < 0; step++) {
        reason = step_in_place(end, u, p, *dt / (real_t)STEPS, newton, &failing, left);
    }
    memcpy(x_next, end, sizeof end);
}

/* The first stage of STEPS steps that cannot be solved: reason, step, stage; reason -1: there is none. */
static void implicit_failure(
    const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *failure)
{
    real_t end[NX], left[NX] = {R(0)};
    int reason = -1, failing = 0;
    memcpy(end, x, sizeof end);
    failure[1] = R(0);
    for (int step = 0; step < STEPS && reason < 0; step++) {
        reason = step_in_place(end, u, p, *dt / (real_t)STEPS, newton, &failing, left);
        failure[1] = (real_t)step;
    }
    failure[0] = (real_t)reason;
    failure[2] = (real_t)failing;
}

/* y += f_u U */
static inline void add_forcing(const stage_t *t, real_t factor, const real_t *U, int n, real_t *y)
{
    for (int r = 0; r < NX; r++) {
        for (int j = 0; j < NU; j++) {
            const real_t slope = factor * t->J[r][NX + j];
            for (int c = 0; c < n; c++) {
                y[r * n + c] += slope * U[j * n + c];
            }
        }
    }
}

/* Derivatives Z of the point and DV of the increment of stage i along n <= NZ columns:
 * Z = M^-1 (base + h a_ii f_u U), DV = Z - base; of an explicit stage Z = base, DV = h (f_x Z + f_u U). */
static inline void stage_columns(
    const stage_t *t, int i, real_t h, const real_t *V, const real_t *U, int n, real_t (*DV)[NX * NZ], real_t *Z)
{
    real_t base[NX * NZ], rest[NX * NZ];
    for (int r = 0; r < NX * n; r++) {
        base[r] = V[r];
    }
    for (int j = 0; j < i; j++) {
        for (int r = 0; r < NX * n; r++) {
            base[r] += increment_a[i * STAGES + j] * DV[j][r];
        }
    }
    if (EXPLICIT_FIRST && i == 0) {
        for (int r = 0; r < NX; r++) {
            for (int c = 0; c < n; c++) {
                Z[r * n + c] = base[r * n + c];
                DV[i][r * n + c] = R(0);
            }
            for (int j = 0; j < NX; j++) {
                const real_t slope = h * t->J[r][j];
                for (int c = 0; c < n; c++) {
                    DV[i][r * n + c] += slope * base[j * n + c];
                }
            }
        }
        add_forcing(t, h, U, n, DV[i]);
    } else {
        for (int r = 0; r < NX * n; r++) {
            rest[r] = base[r];
        }
        add_forcing(t, h * stage_a[i], U, n, rest);
        solve_stage_columns(t, rest, Z, n);
        for (int r = 0; r < NX * n; r++) {
            DV[i][r] = Z[r] - base[r];
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

/* STEPS steps over dt from x, which becomes their end, and along n <= NZ columns (V, U), of which V is followed. What
 * Newton's method leaves of the stages is added to `left`. */
static inline void implicit_columns(
    real_t *x, const real_t *u, const real_t *p, real_t dt, int newton, real_t *V, const real_t *U, int n, real_t *left)
{
    const real_t h = dt / (real_t)STEPS;
    real_t D[STAGES][NX], DV[STAGES][NX * NZ], Z[NX * NZ];
    stage_t stage;
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < STAGES; i++) {
            (void)run_stage(&stage, (i > 0) ? stage.X : x, D, i, x, u, p, h, newton, left);
            stage_columns(&stage, i, h, V, U, n, DV, Z);
        }
        end_step(x, D);
        end_step_of_columns(V, DV, n);
    }
}

/* (V, U) = I, NZ columns. */
static void unit_columns(real_t *V, real_t *U)
{
    memset(V, 0, NX * NZ * sizeof *V);
    memset(U, 0, NU * NZ * sizeof *U);
    for (int i = 0; i < NX; i++) {
        V[i * NZ + i] = R(1);
    }
    for (int j = 0; j < NU; j++) {
        U[j * NZ + NX + j] = R(1);
    }
}

/* x_next, S = d x_next / d(x, u), what Newton's method leaves. */
static void implicit_interval(const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton,
    real_t *x_next, real_t *S, real_t *left)
{
    real_t end[NX], U[NU * NZ];
    memcpy(end, x, sizeof end);
    memset(left, 0, NX * sizeof *left);
    unit_columns(S, U);
    implicit_columns(end, u, p, *dt, newton, S, U, NZ, left);
    memcpy(x_next, end, sizeof end);
}

/* x_next, S_next = d x_next / du. */
static void implicit_forced(
    const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton, real_t *x_next, real_t *S_next)
{
    real_t end[NX], U[NU * NU] = {R(0)}, left[NX] = {R(0)};
    memcpy(end, x, sizeof end);
    for (int j = 0; j < NU; j++) {
        U[j * NU + j] = R(1);
    }
    memset(S_next, 0, NX * NU * sizeof *S_next);
    implicit_columns(end, u, p, *dt, newton, S_next, U, NU, left);
    memcpy(x_next, end, sizeof end);
}

/* x_next, S_next = (d x_next / dx) S. */
static void implicit_free(const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton,
    const real_t *S, real_t *x_next, real_t *S_next)
{
    real_t end[NX], U[NU * NU] = {R(0)}, left[NX] = {R(0)};
    memcpy(end, x, sizeof end);
    memcpy(S_next, S, NX * NU * sizeof *S_next);
    implicit_columns(end, u, p, *dt, newton, S_next, U, NU, left);
    memcpy(x_next, end, sizeof end);
}

/* dx_next = A dx + B du. */
static void implicit_forward(const real_t *x, const real_t *u, const real_t *p, const real_t *dt, int newton,
    const real_t *dx, const real_t *du, real_t *dx_next)
{
    real_t end[NX], V[NX], left[NX] = {R(0)};
    memcpy(end, x, sizeof end);
    memcpy(V, dx, sizeof V);
    implicit_columns(end, u, p, *dt, newton, V, du, 1, left);
    memcpy(dx_next, V, sizeof V);
}
