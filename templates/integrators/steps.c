/* Returns the number of integration steps for the time dt. */
static int steps_for(real_t dt)
{
    const real_t count = CEIL(dt / step_length[0] - TOL_STEP_COUNT);
    return (count >= R(1)) ? ((count < (real_t)MANY) ? (int)count : MANY) : 1;
}

/* Returns the number of integration steps for a time dt of the plan. */
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
        INTEGRATOR_STEP(s, k, x_next, s->u[k], &h, s->newton, x_next);
    }
}

#if ESTIMATOR
#elif AUGMENTED || HAS_INTEGRATOR_JUMP
void API(integrate)(const solver_t *s, const real_t x[NXHAT], const real_t u[NU], real_t dt, real_t x_next[NXHAT])
{
    const int steps = steps_for(dt);
    const real_t h = dt / (real_t)steps;
    real_t start[NX], end[NX];
    for (int i = 0; i < NXHAT; i++) {
        start[i] = (s->magic == MAGIC && dt >= R(0)) ? x[i] : (real_t)NAN;
    }
    if (AUGMENTED) {
        recall_augmented(s, start);
    }
    (void)memcpy(end, start, sizeof end);
    for (int n = 0; n < steps; n++) {
        INTEGRATOR_STEP(s, 0, end, u, &h, NEWTON_LIMIT, end);
    }
    if (HAS_INTEGRATOR_JUMP) {
        INTEGRATOR_JUMP(s, 0, start, u, end);
    }
    (void)memcpy(x_next, end, NXHAT * sizeof *end);
}
#else
void API(integrate)(const solver_t *s, const real_t x[NX], const real_t u[NU], real_t dt, real_t x_next[NX])
{
    const int steps = steps_for(dt);
    const real_t h = dt / (real_t)steps;
    for (int i = 0; i < NX; i++) {
        x_next[i] = (s->magic == MAGIC && dt >= R(0)) ? x[i] : (real_t)NAN;
    }
    for (int n = 0; n < steps; n++) {
        INTEGRATOR_STEP(s, 0, x_next, u, &h, NEWTON_LIMIT, x_next);
    }
}
#endif
