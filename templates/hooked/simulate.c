/* Single shooting: the plan is simulated before it is linearised. */

/* x_{k+1} = Phi(x_k, u_k) from x_0 of the plan, so that the linearisation has no gaps. A plan whose simulation is not
 * finite keeps its states. Returns the largest change of a state in its scale, which is what the gaps add up to. */
static real_t simulate_plan(solver_t *s)
{
    real_t size[NX], moved[NX] = {R(0)}, most = R(0);
    (void)memcpy(s->step.dx, s->x, sizeof s->step.dx);
    for (int k = 0; k < N; k++) {
        interval_value(s, k, s->x[k + 1]);
    }
    if (!all_finite(s->x[0], (N + 1) * NX)) {
        (void)memcpy(s->x, s->step.dx, sizeof s->x);
        return R(0);
    }
    for (int k = 1; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->step.dx[k][i] -= s->x[k][i];
        }
        enlarge_all(moved, s->step.dx[k], NX);
    }
    state_scales(s, size);
    for (int i = 0; i < NX; i++) {
        enlarge(&most, moved[i] / size[i]);
    }
    return most;
}

static status_t simulate_prepare_plan(solver_t *s)
{
    const real_t moved = simulate_plan(s);
    const status_t status = prepare_here(s);
    measure_residual(s);
    enlarge(&s->stats.residual, moved);
    return status;
}
