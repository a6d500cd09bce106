/* This part evaluates the augmented Lagrangian of the present plan,
 *
 *     L = cost + sum (lam_i + rho_i/2 c_i) c_i + sum psi_m(v_m),   c_0 = xhat - x_0,   c_{k+1} = Phi_k - x_{k+1},
 *     psi_m(v) = min_y P_m(y) + mu_m (v - y) + rho_m/2 (v - y)^2,
 *
 * where P_m is 0 between the bounds of row m and, outside, its penalty or infinite. The derivatives of L are those of
 * the Lagrangian with the multipliers lam_i + rho_i c_i and psi_m'(v_m), the first-order estimates. */

/* Evaluates the gaps c_{k+1} and the cost of the nodes. */
static void evaluate_path(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k < N; k++) {
        interval_value(s, k, a->gap[k + 1]);
        for (int i = 0; i < NX; i++) {
            a->gap[k + 1][i] -= s->x[k + 1][i];
        }
    }
    a->cost = nodal_cost(s);
}

/* Evaluates what depends on xhat: the gap c_0 = xhat - x_0 of the measured states, and the rows. */
static void evaluate_ends(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int i = 0; i < NX; i++) {
        a->gap[0][i] = s->xhat[i] - s->x[0][i];
    }
    for (int f = 0; f < NF; f++) {
        a->gap[0][free_state[f]] = R(0);
    }
    evaluate_rows(s, a->value);
}

/* Returns rho_i, the penalty of component i of the gap at a node. */
static inline real_t gap_weight(const solver_t *s, int i)
{
    return s->auglag.penalty * variable_weight[i];
}

/* Returns psi_m(v) with its first and second derivative. */
static real_t row_term(const solver_t *s, int m, real_t v, real_t *slope, real_t *curvature)
{
    const real_t lower = row_lower(s, m), upper = row_upper(s, m);
    const real_t weight = s->auglag.penalty * row_weight[m], mu = s->auglag.row[m], moved = v + mu / weight;
    real_t y = clip(moved, lower, upper), penalty = R(0);
    *slope = mu + weight * (v - y);
    *curvature = (moved > lower && moved < upper) ? R(0) : weight;
    if (moved > lower && moved < upper) {
        *slope = R(0);
    }
    if (SOFT_ROWS) {
        const real_t l1 = row_l1(s, m), l2 = row_l2(s, m);
        if (FABS(*slope) > l1) {
            const real_t side = (*slope > R(0)) ? R(1) : -R(1), bound = (*slope > R(0)) ? upper : lower;
            const real_t excess = (side * (mu + weight * (v - bound)) - l1) / (weight + l2);
            y = bound + side * excess;
            penalty = (l1 + R(0.5) * l2 * excess) * excess;
            *slope = side * (l1 + l2 * excess);
            *curvature = weight * l2 / (weight + l2);
        }
    }
    return penalty + (mu + R(0.5) * weight * (v - y)) * (v - y);
}

/* Returns L with the multipliers of the last update. */
static real_t merit(const solver_t *s)
{
    const auglag_t *a = &s->auglag;
    real_t sum = a->cost;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            sum += (a->lam[k][i] + R(0.5) * gap_weight(s, i) * a->gap[k][i]) * a->gap[k][i];
        }
    }
    for (int m = 0; m < NG; m++) {
        real_t slope, curvature;
        sum += row_relaxed[m] ? row_term(s, m, a->value[m], &slope, &curvature) : R(0);
    }
    return sum;
}

/* Sets the multipliers of the plan to their first-order estimates. */
static void estimate_multipliers(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->lam[k][i] = a->lam[k][i] + gap_weight(s, i) * a->gap[k][i];
        }
    }
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m]) {
            a->term[m] = row_term(s, m, a->value[m], &s->mult[m], &a->curvature[m]);
        }
    }
}

/* Replaces the multipliers by the estimates. */
static void update_multipliers(solver_t *s)
{
    auglag_t *a = &s->auglag;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            const real_t most = FACTOR_AUGMENTED_MULTIPLIER * gap_weight(s, i) * variable_scale[i];
            a->lam[k][i] = clip(s->lam[k][i], -most, most);
        }
    }
    for (int m = 0; m < NG; m++) {
        const real_t most = FACTOR_AUGMENTED_MULTIPLIER * a->penalty * SQRT(row_weight[m]);
        a->row[m] = row_relaxed[m] ? clip(s->mult[m], -most, most) : R(0);
    }
}

/* lam_0 += sign E_0' eta. L reads xhat where coupled rows read x_0, so that its multiplier of the initial condition is
 * lam_0 - E_0' eta. */
static void couple_start(solver_t *s, real_t sign)
{
    for (int j = 0; j < NE; j++) {
        for (int i = 0; i < NX; i++) {
            s->lam[0][i] += sign * s->coupled.J_0[j][i] * COUPLED_MULTIPLIERS(s)[j];
        }
    }
}

/* Restores the multipliers of the plan from before the estimates. */
static void restore_multipliers(solver_t *s)
{
    auglag_t *a = &s->auglag;
    (void)memcpy(s->lam, a->lam, sizeof s->lam);
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m]) {
            s->mult[m] = a->row[m];
        }
    }
    couple_start(s, R(1));
}
