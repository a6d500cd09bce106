/* Component "algorithm". Contract: algorithm_reset, API(step).
 * Here: single shooting by projected gradients, for problems whose only rows are bounds of the controls. It calls only
 * the integrator and the cost of the nodes. */

/* States of the plan from x_0 and the controls, and the cost. */
static real_t simulate_plan(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
    return nodal_cost(s);
}

static void algorithm_reset(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = clip(reference_of_control(s, k, j), control_lower(s, k, j), control_upper(s, k, j));
        }
    }
    memcpy(s->x[0], initial_state, sizeof initial_state);
    (void)simulate_plan(s);
    s->length = R(1);
    s->status = (int32_t)OK;
}

/* slope_k = r_k + B_k' lam_{k+1},  lam_k = q_k + A_k' lam_{k+1},  lam_N = q_N. */
static void differentiate(solver_t *s)
{
    real_t lam[NX] = {R(0)};
#if HAS_TERMINAL_GRADIENT
    TERMINAL_GRADIENT(s, lam);
#endif
    for (int k = N - 1; k >= 0; k--) {
        real_t S[NX][NZ], x_next[NX], g[NZ] = {R(0)};
        memset(S, 0, sizeof S);
        INTEGRATOR_INTERVAL(s, k, x_next, &S[0][0]);
#if HAS_PATH_GRADIENT
        PATH_GRADIENT(s, k, g);
#endif
        for (int i = 0; i < NZ; i++) {
            for (int r = 0; r < NX; r++) {
                g[i] += S[r][i] * lam[r];
            }
        }
        memcpy(lam, g, sizeof lam);
        memcpy(s->slope[k], &g[NX], sizeof s->slope[k]);
    }
}

/* u = clip(before - length slope), and its cost. */
static real_t try_step(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = s->before[k][j] - s->length * s->slope[k][j];
            s->u[k][j] = clip(u, control_lower(s, k, j), control_upper(s, k, j));
        }
    }
    return simulate_plan(s);
}

/* One projected gradient step whose length is halved until the cost decreases. Returns 0 if it does not decrease. */
static int descend(solver_t *s, real_t *cost)
{
    differentiate(s);
    memcpy(s->before, s->u, sizeof s->before);
    s->length *= R(2);
    for (int trial = 0; trial < MAX_HALVINGS; trial++) {
        const real_t found = try_step(s);
        if (found < *cost) {
            *cost = found;
            return 1;
        }
        s->length *= R(0.5);
    }
    memcpy(s->u, s->before, sizeof s->before);
    (void)simulate_plan(s);
    s->length = R(1);
    return 0;
}

status_t API(step)(solver_t *s, const real_t xhat[NX], real_t u0[NU])
{
    real_t cost;
    if (s->magic != MAGIC) {
        memcpy(u0, default_control, sizeof default_control);
        return NOT_INITIALIZED;
    }
    s->status = (int32_t)NOT_FINITE;
    if (all_finite(xhat, NX)) {
        memcpy(s->x[0], xhat, sizeof s->x[0]);
        cost = simulate_plan(s);
        for (int n = 0; n < MAX_STEPS && descend(s, &cost); n++) {
            s->steps++;
        }
        s->status = (int32_t)OK;
    }
    memcpy(u0, s->u[0], sizeof s->u[0]);
    return (status_t)s->status;
}
