/* Contract of this part: improve() takes a step of a projected quasi-Newton method with limited memory. The controls at
 * a bound whose gradient points outward are held. In the subspace of the others d = -B r, where the inverse Hessian B
 * is built from the last pairs,
 *
 *     y = change of the gradient, z = change of the controls,   B <- (I - z y'/y'z) B (I - y z'/y'z) + z z'/y'z,
 *
 * starting from a diagonal D. The inverse of D is updated with the diagonal of the same formula (Gilbert and
 * Lemarechal, Math. Programming 45, 1989), because the first controls of an unstable plant have far more curvature than
 * the last ones. */

/* Updates D with the pair (y, z) of curvature y'z = bend; D = y'z / y'y after the first pair. */
static void scale_directions(shooting_t *a, int n, real_t bend)
{
    const real_t first = bend / inner(a->Y[n][0], a->Y[n][0]);
    for (int k = 0; a->pairs == 0 && k < N; k++) {
        for (int j = 0; j < NU; j++) {
            a->D[k][j] = first;
        }
    }
    real_t yDy = R(0), zz = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t y = a->Y[n][k][j], z = a->Z[n][k][j];
            yDy += y * y * a->D[k][j];
            zz += z * z / a->D[k][j];
        }
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t y = a->Y[n][k][j], z = a->Z[n][k][j] / a->D[k][j];
            const real_t inverse = (yDy / a->D[k][j] + y * y - yDy * z * z / zz) / bend;
            a->D[k][j] = (inverse > R(0) && inverse < INF) ? R(1) / inverse : first;
        }
    }
}

/* Stores the pair of the last step, unless its curvature is not positive. */
static void remember_step(solver_t *s)
{
    shooting_t *a = &s->shooting;
    const int n = a->pairs % MEMORY;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            a->Y[n][k][j] = a->r[k][j] - a->w[k][j];
            a->Z[n][k][j] = (s->u[k][j] - a->p[k][j]) / control_scale[j];
        }
    }
    const real_t bend = inner(a->Y[n][0], a->Z[n][0]), size = inner(a->Y[n][0], a->Y[n][0]);
    if (bend > TOL_UNIT * SQRT(size * inner(a->Z[n][0], a->Z[n][0])) && bend < INF && size < INF) {
        scale_directions(a, n, bend);
        a->pairs = (a->pairs < 2 * MEMORY - 1) ? a->pairs + 1 : MEMORY;
    }
}

/* held = 1 for controls at a bound whose gradient points outward; d = -r at the others. */
static void hold_outward(solver_t *s)
{
    shooting_t *a = &s->shooting;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t u = s->u[k][j], r = a->r[k][j];
            a->held[k][j] = (r > R(0) && !(u > control_lower(s, k, j))) || (r < R(0) && !(u < control_upper(s, k, j)));
            a->d[k][j] = -if_free(a, k, j) * r;
        }
    }
}

/* Returns sum x_kj y_kj over the free controls. */
static real_t free_inner(const shooting_t *a, real_t (*x)[NU], real_t (*y)[NU])
{
    real_t sum = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            sum += if_free(a, k, j) * x[k][j] * y[k][j];
        }
    }
    return sum;
}

/* d += factor x over the free controls. */
static void add_free(shooting_t *a, real_t factor, real_t (*x)[NU])
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            a->d[k][j] += if_free(a, k, j) * factor * x[k][j];
        }
    }
}

/* d = B d by two loops over the pairs, from the last to the first and back. Pairs without curvature in the subspace of
 * the free controls are left out. */
static void apply_memory(shooting_t *a)
{
    real_t part[MEMORY] = {R(0)}, bend[MEMORY] = {R(0)};
    const int stored = (a->pairs < MEMORY) ? a->pairs : MEMORY;
    for (int i = 0; i < stored; i++) { /* at most MEMORY passes in apply_memory */
        const int n = (a->pairs - 1 - i) % MEMORY;
        const real_t yz = free_inner(a, a->Y[n], a->Z[n]);
        if (yz > TOL_UNIT * SQRT(free_inner(a, a->Y[n], a->Y[n]) * free_inner(a, a->Z[n], a->Z[n]))) {
            bend[n] = yz;
            part[n] = free_inner(a, a->Z[n], a->d) / yz;
            add_free(a, -part[n], a->Y[n]);
        }
    }
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            a->d[k][j] *= a->D[k][j];
        }
    }
    for (int i = stored - 1; i >= 0; i--) { /* at most MEMORY passes in apply_memory */
        const int n = (a->pairs - 1 - i) % MEMORY;
        if (bend[n] > R(0)) {
            add_free(a, part[n] - free_inner(a, a->Y[n], a->d) / bend[n], a->Z[n]);
        }
    }
}

/* Sets d to the direction of steepest descent, limited to the length of one scale. */
static void descend_steepest(solver_t *s)
{
    shooting_t *a = &s->shooting;
    hold_outward(s);
    const real_t size = SQRT(inner(a->d[0], a->d[0]));
    for (int k = 0; k < N; k++) {
        for (int j = 0; size > R(1) && j < NU; j++) {
            a->d[k][j] /= size;
        }
    }
}

/* Takes one step. The pairs are forgotten if they yield no descent direction. */
static status_t improve(solver_t *s, int trials, int *moved)
{
    shooting_t *a = &s->shooting;
    *moved = STAYED;
    s->stats.newton_iterations++;
    differentiate(s);
    if (!all_finite(a->r[0], N * NU)) {
        return NUMERICAL_FAILURE;
    }
    if (a->paired) {
        remember_step(s);
    }
    hold_outward(s);
    if (a->pairs > 0) {
        apply_memory(a);
    }
    if (a->pairs == 0 || !all_finite(a->d[0], N * NU) || !(inner(a->r[0], a->d[0]) < R(0))) {
        descend_steepest(s);
        a->pairs = 0;
    }
    (void)memcpy(a->w, a->r, sizeof a->w);
    *moved = move(s, R(0), trials) ? MOVED : STAYED;
    a->paired = *moved == MOVED;
    return OK;
}
