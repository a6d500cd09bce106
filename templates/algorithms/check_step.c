/* Contract of this part: the check before OK of a QP whose states were eliminated. Its solution must satisfy the hard
 * rows of the QP with all states and, if no QP solver on stages has checked it, the stationarity. Rounding errors of the
 * elimination show there. */

/* size[]: largest magnitude of every component of (dx, du) over the horizon, and of the gaps of the states. */
static void step_sizes(const solver_t *s, real_t *size)
{
    memset(size, 0, NZ * sizeof *size);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&size[i], s->step.dx[k][i]);
            enlarge(&size[i], (k < N) ? s->node[k].b[i] : R(0));
        }
        for (int j = 0; k < N && j < NU; j++) {
            enlarge(&size[NX + j], s->step.du[k][j]);
        }
    }
}

#if HARD_ROWS
/* Returns 1 if the hard row m holds up to rounding of its terms. */
static int hard_row_holds(const solver_t *s, int m, const real_t *size)
{
    const real_t excess = FABS(row_excess(s, m));
    real_t J[NZ], terms;
    if (excess == R(0)) {
        return 1;
    }
    terms = FABS(row_gradient(s, m, J));
    for (int i = 0; i < NZ; i++) {
        terms += FABS(J[i]) * size[i];
    }
    return excess <= TOL_STEP * terms;
}
#endif

/* Returns 1 if the step is finite and, if the rows are not relaxed, all control bounds and hard rows hold after it. */
static int step_holds(const solver_t *s, int relaxed)
{
    real_t size[NZ];
    int holds;
    step_sizes(s, size);
    holds = all_finite(size, NZ);
    for (int k = 0; k < N && !relaxed; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = s->u[k][j] + s->step.du[k][j];
            const real_t bound = clip(u, CONTROL_LOWER(s, k, j), CONTROL_UPPER(s, k, j));
            holds &= FABS(u - bound) <= TOL_STEP * (size[NX + j] + FABS(bound));
        }
    }
#if HARD_ROWS
    for (int m = 0; m < NG && !relaxed; m++) {
#if SOFT_ROWS
        if (IS_SOFT(m)) {
            continue;
        }
#endif
        holds &= hard_row_holds(s, m, size);
    }
#endif
    return holds;
}

#if CHECK_GRADIENT
/* The gradient with respect to the controls of node k, where w holds that of the cost and dynamics: rest[] and terms[]
 * become the largest magnitudes over all nodes of its components and of the sums of their terms. */
static void check_controls(solver_t *s, int k, const real_t *w, real_t *rest, real_t *terms)
{
    const node_t *node = &s->node[k];
    real_t(*Q)[NZ] = s->hessian.Q[NQ == 1 ? 0 : k];
    for (int i = NX; i < NZ; i++) {
        const real_t mult = s->mu_u[k][i - NX];
        real_t sum = w[i] + mult, size = FABS(node->g[i]) + FABS(mult) + FABS(Q[i][i] * s->step.du[k][i - NX]);
        for (int l = 0; l < NX; l++) {
            size += FABS(node->S[l][i] * s->lam[k + 1][l]) + FABS(Q[i][l] * s->step.dx[k][l]);
        }
#if NH
        for (int j = 0; j < NH; j++) {
            const real_t force = node->J[j][i] * s->mu[k][j];
            sum += force;
            size += FABS(force);
        }
#endif
        enlarge(&rest[i - NX], sum);
        enlarge(&terms[i - NX], size);
    }
}

/* Returns 1 if the gradient vanishes up to rounding of its terms. */
static int controls_hold(const real_t *rest, const real_t *terms)
{
    int holds = all_finite(terms, NU);
    for (int j = 0; j < NU; j++) {
        holds &= rest[j] <= TOL_STEP_GRADIENT * terms[j];
    }
    return holds;
}
#endif
