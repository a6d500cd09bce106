/* Hard rows that depend on no state. The first control can satisfy them in every state, as it satisfies its bounds. The
 * step may violate nonlinear ones, a relaxed QP may give them up, and a sample may fail. */

/* Returns the index of the row that the first control violates most, relative to its scale, or -1; writes the
 * violation, also in that scale, and values and gradients of all rows of its node. */
static int most_broken_row(const solver_t *s, real_t *h, real_t (*J)[NZ], real_t *excess, real_t *relative)
{
    int worst = -1;
    real_t most = TOL_ROUNDING;
    PATH_ROWS(s, 0, h, J);
    for (int m = row_first[0]; m < row_first[1]; m++) {
        if (is_pulled[row_id(m)] == 0) {
            continue;
        }
        const real_t value = h[row_index(m)], lower = row_lower(s, m), upper = row_upper(s, m);
        const real_t out = value - clip(value, lower, upper), scale = row_magnitude[row_id(m)];
        if (FABS(out) > most * scale) {
            most = FABS(out) / scale;
            *excess = out;
            *relative = most;
            worst = m;
        }
    }
    return worst;
}

/* Moves the first control of the plan back onto these rows, along the gradient of the row that it violates most, in the
 * scales of the controls. Restores the control if the largest violation does not fall. */
static void pull_back(solver_t *s)
{
    real_t h[NH] = {R(0)}, J[NH][NZ] = {{R(0)}}, before[NU], excess = R(0), relative = R(0), first = R(0);
    (void)memcpy(before, s->u[0], sizeof before);
    for (int pass = 0; pass <= PULLS; pass++) {
        const int m = most_broken_row(s, h, J, &excess, &relative);
        if (m < 0) {
            return;
        }
        first = (pass == 0) ? relative : first;
        const real_t *a = &J[row_index(m)][NX];
        real_t slope = R(0);
        for (int j = 0; j < NU; j++) {
            slope += a[j] * a[j] * z_scale[NX + j] * z_scale[NX + j];
        }
        if (pass == PULLS || !(slope > R(0))) {
            break;
        }
        for (int j = 0; j < NU; j++) {
            s->u[0][j] -= excess / slope * a[j] * z_scale[NX + j] * z_scale[NX + j];
            s->u[0][j] = safe_value(s, 0, j);
        }
    }
    if (!(relative < first)) {
        (void)memcpy(s->u[0], before, sizeof before);
    }
}

/* Moves a control that is returned instead of that of the plan back onto these rows; the plan stays as it is. */
static void pull_control_back(solver_t *s, real_t *u0)
{
    real_t kept[NU], start[NX];
    (void)memcpy(kept, s->u[0], sizeof kept);
    (void)memcpy(start, s->x[0], sizeof start);
    (void)memcpy(s->u[0], u0, sizeof s->u[0]);
    if (AUGMENTED) {
        take_augmented(s, s->x[0]);
    }
    pull_back(s);
    (void)memcpy(u0, s->u[0], sizeof s->u[0]);
    (void)memcpy(s->u[0], kept, sizeof kept);
    (void)memcpy(s->x[0], start, sizeof start);
}

/* Moves the first control of a plan back onto these rows if solve() has not reached a solution. */
static void pull_plan_back(solver_t *s)
{
    real_t u0[NU];
    (void)memcpy(u0, s->u[0], sizeof u0);
    pull_control_back(s, u0);
    (void)memcpy(s->u[0], u0, sizeof u0);
}
