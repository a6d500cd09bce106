#include "algorithms/shared/safe_value.c"

static void forget_multipliers(solver_t *s)
{
    (void)memset(s->lam, 0, sizeof s->lam);
    (void)memset(s->mu_u, 0, sizeof s->mu_u);
    (void)memset(s->mult, 0, sizeof s->mult);
}

/* Restarts the plan: sets every state to x, replaces controls that are not finite by their references, sets all
 * multipliers to 0 and empties the working set. */
static void start_at(solver_t *s, const real_t *x)
{
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->x[k][i] = x[i];
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->u[k][j] = safe_value(s, k, j);
        }
    }
    if (AUGMENTED) {
        follow_augmented(s);
    }
    forget_multipliers(s);
    if (HAS_QP) {
        condense_init(s);
    }
    s->row_residual = R(0);
}

static void start_at_measured(solver_t *s)
{
    start_at(s, all_finite(s->xhat, NX) ? s->xhat : initial_state);
}

/* Sets the controls of the plan to their references, and states that are free at its start to declared values. */
static void forget_plan(solver_t *s)
{
    refer_controls(s);
    if (NALG) {
        forget_algebraic(s);
    }
    for (int f = 0; f < NF; f++) {
        s->xhat[free_state[f]] = initial_state[free_state[f]];
    }
}

/* Restarts the whole plan. */
static void start_anew(solver_t *s)
{
    forget_plan(s);
    start_at_measured(s);
}

/* Sets controls of the plan with two bounds to the middle between them. */
static void center_controls(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t middle = R(0.5) * control_lower(s, k, j) + R(0.5) * control_upper(s, k, j);
            s->u[k][j] = isfinite(middle) ? middle : s->u[k][j];
        }
    }
}

static int plan_is_finite(const solver_t *s)
{
    return all_finite(s->x[0], (N + 1) * NX) && all_finite(s->u[0], N * NU);
}

/* Copies x_0 of the plan to xhat, as if it had been measured; `measured` keeps the measured state. */
static void measure_plan(solver_t *s, real_t *measured)
{
    (void)memcpy(measured, s->xhat, sizeof s->xhat);
    (void)memcpy(s->xhat, s->x[0], sizeof s->xhat);
}
