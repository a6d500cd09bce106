/* This part checks the solution of a QP with eliminated states before the status becomes OK. The solution must satisfy
 * the hard rows of the QP with all states, and stationarity. Rounding errors of the elimination appear in these
 * conditions. */

/* Stores in size[] the largest magnitude of every component of (dx, du) over the horizon; that of a state includes its
 * gaps. size[] is 0 on entry. Returns 1 if the step is finite. */
static int step_sizes(const solver_t *s, real_t *size)
{
    widen(size, s->step.dx[N], NX);
    for (int k = 0; k < N; k++) {
        widen(size, s->step.dx[k], NX);
        widen(size, s->node[k].b, NX);
        widen(size + NX, s->step.du[k], NU);
    }
    return all_finite(size, NZ);
}

/* Returns 1 if all hard rows hold after the step up to rounding of their terms, and rows with a multiplier are at its
 * bound. Control bounds are bounds of the QP. */
static int rows_hold(const solver_t *s, const real_t *size)
{
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m)) {
            continue;
        }
        const real_t excess = FABS(row_excess(s, m, s->step.mult[m]));
        const real_t rounding = TOL_ROUNDING * row_magnitude[row_id(m)];
        if (!(excess <= rounding) && !(excess <= TOL_STEP * row_terms(s, m, size) + rounding)) {
            return 0;
        }
    }
    return 1;
}

/* Returns 1 if the plan may take the step of the QP. */
static int step_holds(const solver_t *s, status_t status)
{
    real_t size[NZ] = {0};
    if (!step_sizes(s, size)) {
        return 0;
    }
    if (NG > 0 && status == OK && !rows_hold(s, size)) {
        return 0;
    }
    return 1;
}

/* Returns the sum of the magnitudes of the terms of the cost of the step, at least the rounding error of a cost at its
 * scale. */
static real_t cost_terms(const solver_t *s)
{
    real_t sum = least_cost();
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t z = FABS(i < NX ? s->step.dx[k][i] : s->step.du[k][i - NX]);
            sum += (FABS(s->node[k].g[i]) + FABS(curvature_at(s, k, i)) * z) * z;
        }
    }
    return sum;
}

/* Returns 1 if the gradient with respect to the controls of node k vanishes, where w holds that of cost and dynamics.
 * It vanishes relative to its terms and its scale, or because it changes the cost by less than `least` squared, as its
 * terms may all be rounding errors of others. *least = 0: not computed yet. If a term is not finite, `over` is not,
 * either. */
static int controls_hold(const solver_t *s, int k, const real_t *w, real_t *least)
{
    const node_t *node = &s->node[k];
    for (int j = 0; j < NU; j++) {
        if (NHELD > 0) {
            if (condense_variable(k, j) < 0) {
                continue;
            }
        }
        const real_t mult = s->mu_u[k][j];
        const int i = NX + j;
        real_t sum = w[i] + mult, size = FABS(node->g[i]) + FABS(mult);
        for (int l = 0; l < NX; l++) {
            size += FABS(node->S[l][i] * s->lam[k + 1][l]);
        }
        for (int m = row_first[k]; m < row_first[k + 1]; m++) {
            if (!row_is_state(m)) {
                const real_t force = row_gradient(s, m)[i] * s->mult[m];
                sum += force;
                size += FABS(force);
            }
        }
        const real_t rounding = TOL_STEP_GRADIENT * size + TOL_ROUNDING * force_size[i];
        const real_t over = (FABS(sum) - rounding) * s->qp.inverse[condense_variable(k, j)];
        if (over > R(0) && *least <= R(0)) {
            *least = FACTOR_STEP_GRADIENT_COST * TOL_STEP_GRADIENT * SQRT(cost_terms(s));
        }
        if (!(over <= *least)) {
            return 0;
        }
    }
    return 1;
}
