/* Component "integrator". Contract:
 *   interval_value   only x_next of interval k, of which a kernel also gives the derivatives
 *   integrate_plan   x_next = x(dt) from x under the control u_k, any dt >= 0
 *   plan_steps       the number of steps for that; its kernel INTEGRATOR_STEP makes one
 *   API(integrate)   x(dt) from x for any control and any dt >= 0; NaN if the solver is not initialised
 * Here: explicit Runge-Kutta with equal steps, none longer than the longest step of the controller. */

static void interval_value(const solver_t *s, int k, real_t *x_next)
{
    const real_t h = interval_length[k] / (real_t)STEPS;
    INTEGRATOR_STEP(s, k, s->x[k], s->u[k], &h, x_next);
    for (int n = 1; n < STEPS; n++) {
        INTEGRATOR_STEP(s, k, x_next, s->u[k], &h, x_next);
    }
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, k, s->x[k], s->u[k], x_next);
    }
}

/* Number of integration steps for the time dt. */
static int steps_for(real_t dt)
{
    const real_t count = CEIL(dt / step_length[0] - TOL_STEP_COUNT);
    return (count >= R(1)) ? ((count < (real_t)MANY) ? (int)count : MANY) : 1;
}

/* The same for a part of the plan. */
static inline int plan_steps(real_t dt)
{
    const int wanted = steps_for(dt);
    return (wanted < PLAN_STEPS) ? wanted : PLAN_STEPS;
}

static void integrate_plan(const solver_t *s, int k, const real_t *x, real_t dt, real_t *x_next)
{
    const int steps = plan_steps(dt);
    const real_t h = dt / (real_t)steps;
    for (int i = 0; i < NX; i++) {
        x_next[i] = x[i];
    }
    for (int n = 0; n < steps; n++) { /* at most PLAN_STEPS passes */
        INTEGRATOR_STEP(s, k, x_next, s->u[k], &h, x_next);
    }
}

#if INNER || HAS_INTEGRATOR_JUMP
void API(integrate)(const solver_t *s, const real_t x[NXHAT], const real_t u[NU], real_t dt, real_t x_next[NXHAT])
{
    const int steps = steps_for(dt);
    const real_t h = dt / (real_t)steps;
    real_t start[NX], end[NX];
    for (int i = 0; i < NXHAT; i++) {
        start[i] = (s->magic == MAGIC) ? x[i] : (real_t)NAN;
    }
    if (INNER) {
        recall_inner(s, start);
    }
    memcpy(end, start, sizeof end);
    for (int n = 0; n < steps; n++) {
        INTEGRATOR_STEP(s, 0, end, u, &h, end);
    }
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, 0, start, u, end);
    }
    memcpy(x_next, end, NXHAT * sizeof *end);
}
#else
void API(integrate)(const solver_t *s, const real_t x[NX], const real_t u[NU], real_t dt, real_t x_next[NX])
{
    const int steps = steps_for(dt);
    const real_t h = dt / (real_t)steps;
    for (int i = 0; i < NX; i++) {
        x_next[i] = (s->magic == MAGIC) ? x[i] : (real_t)NAN;
    }
    for (int n = 0; n < steps; n++) {
        INTEGRATOR_STEP(s, 0, x_next, u, &h, x_next);
    }
}
#endif
