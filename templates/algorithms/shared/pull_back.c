/* Hard rows that depend on no state: the first control can keep them whatever the state is, as it keeps its bounds. A
 * step may leave those that bend, a relaxed QP gives them up, and a sample may fail. */

/* Row of these that the first control violates most, relative to its scale, or -1; by how much, and that in its scale;
 * values and gradients of all rows of its node. */
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

/* Moves the first control of the plan back onto these rows: along the gradient of the row that it violates most, in the
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

/* Moves a control that is returned in place of that of the plan back onto these rows; the plan stays as it is. */
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

/* The same for the first control of a plan that solve() has not brought to a solution. */
static void pull_plan_back(solver_t *s)
{
    real_t u0[NU];
    (void)memcpy(u0, s->u[0], sizeof u0);
    pull_control_back(s, u0);
    (void)memcpy(s->u[0], u0, sizeof u0);
}
