/* The exact Hessian of a search, made convex on the stages of the problem, whatever the QP solver:
 *
 *     Q_k + sum_m w_m a_m a_m' + shift D,   D = diag(unit) on states and controls.
 *
 * The QP is strictly convex if and only if the pivots of the recursion
 *
 *     M = Q_k + S_k' P S_k,   P <- M_xx - M_xu M_uu^-1 M_ux
 *
 * are positive. If they are not, equations and the bounds and rows with a multiplier are held: w_m / 2 (a_m'z -
 * bound)^2 changes neither the step nor the multipliers of a QP in which they are active, and makes the Hessian convex
 * if it is so on their null space (Finsler's lemma). If that is not sufficient, all variables are shifted. */

#if TWO_HESSIANS
#include "algorithms/solve/linearize_with_curvature.c"

#endif
/* Linearises the present point, and writes its Hessian to s->curved. */
static void evaluate_iterate(solver_t *s)
{
    curved_t *c = &s->curved;
    if (ITERATES && !c->in_solve) { /* the Hessian of samples is used */
        evaluate_for_sample(s);
        return;
    }
    if (TWO_HESSIANS) {
        linearize_with_curvature(s);
        s->renewal = UP_TO_DATE;
    } else {
        evaluate_here(s);
        (void)memcpy(c->Q, s->hessian.Q, sizeof c->Q);
        (void)memcpy(c->Q_N, s->hessian.Q_N, sizeof c->Q_N);
    }
    (void)memset(s->hessian.Q, 0, sizeof s->hessian.Q);
    (void)memset(s->hessian.Q_N, 0, sizeof s->hessian.Q_N);
    for (int i = 0; i < NZ; i++) {
        for (int j = 0; j < i; j++) {
            for (int k = 0; k < N; k++) {
                c->Q[k][j][i] = c->Q[k][i][j];
            }
        }
    }
    for (int i = 0; i < NX; i++) {
        for (int j = 0; j < i; j++) {
            c->Q_N[j][i] = c->Q_N[i][j];
        }
    }
}

/* Returns row `i` of the Hessian of node k. */
static inline real_t *curved_row(curved_t *c, int k, int i)
{
    return (k < N) ? c->Q[k][i] : c->Q_N[i];
}

/* T = P S_k and M = Q_k + S_k' T + shift D, lower triangle. */
static void curved_stage(solver_t *s, int k, real_t shift)
{
    curved_t *c = &s->curved;
    const node_t *node = &s->node[k];
    (void)memset(c->T, 0, sizeof c->T);
    for (int i = 0; i < NX; i++) {
        for (int l = 0; l < NX; l++) {
            for (int j = 0; j < NZ; j++) {
                c->T[i][j] += c->P[i][l] * node->S[l][j];
            }
        }
    }
    for (int i = 0; i < NZ; i++) {
        (void)memcpy(c->M[i], c->Q[k][i], sizeof c->M[0]);
        for (int l = 0; l < NX; l++) {
            for (int j = 0; j <= i; j++) {
                c->M[i][j] += node->S[l][i] * c->T[l][j];
            }
        }
        c->M[i][i] += shift * c->unit[i];
    }
}

/* Eliminates variable j of M, lower triangle, from those before it. Returns 0 if its pivot is not positive. */
static int eliminate(curved_t *c, int j)
{
    const real_t pivot = c->M[j][j];
    if (!(pivot > TOL_CURVED_PIVOT * c->unit[j]) || !isfinite(pivot)) {
        return 0;
    }
    for (int i = 0; i < j; i++) {
        const real_t factor = c->M[j][i] / pivot;
        for (int l = 0; l <= i; l++) {
            c->M[i][l] -= factor * c->M[j][l];
        }
    }
    return 1;
}

/* Returns 1 if the cost to go is strictly convex in the free components of x_0. */
static int free_pivots(curved_t *c)
{
    for (int f = NF - 1; f >= 0; f--) {
        const int j = free_state[f];
        const real_t pivot = c->P[j][j];
        if (!(pivot > TOL_CURVED_PIVOT * c->unit[j]) || !isfinite(pivot)) {
            return 0;
        }
        for (int e = 0; e < f; e++) {
            const real_t factor = c->P[j][free_state[e]] / pivot;
            for (int l = 0; l < f; l++) {
                c->P[free_state[e]][free_state[l]] -= factor * c->P[j][free_state[l]];
            }
        }
    }
    return 1;
}

/* Returns 1 if the QP with this shift is strictly convex. */
static int is_convex(solver_t *s, real_t shift)
{
    curved_t *c = &s->curved;
    (void)memcpy(c->P, c->Q_N, sizeof c->P);
    for (int i = 0; i < NX; i++) {
        c->P[i][i] += shift * c->unit[i];
    }
    for (int k = N - 1; k >= 0; k--) {
        curved_stage(s, k, shift);
        for (int j = NZ - 1; j >= NX; j--) {
            if (!eliminate(c, j)) {
                return 0;
            }
        }
        for (int i = 0; i < NX; i++) {
            for (int j = 0; j <= i; j++) {
                c->P[j][i] = c->M[i][j];
                c->P[i][j] = c->P[j][i];
            }
        }
    }
    if (NF) {
        return free_pivots(c);
    } else {
        return 1;
    }
}

/* unit = max(unit, C / size^2), where C is the largest change of the cost, by its gradient, for a move by the size of a
 * variable. A linear cost has a curvature of this kind. */
static void raise_units(const solver_t *s, real_t *unit)
{
    real_t size[NZ], most = R(0);
    control_sizes(s, size + NX);
    for (int i = 0; i < NX; i++) {
        size[i] = size_or(s->sqp.state_scale[i], z_scale[i]);
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            enlarge_if_finite(&most, ((k < N) ? s->node[k].g[i] : s->terminal.g[i]) * size[i]);
        }
    }
    for (int i = 0; i < NZ; i++) {
        enlarge(&unit[i], most / (size[i] * size[i]));
        unit[i] = (unit[i] > R(0)) ? unit[i] : cost_size[0] / (size[i] * size[i]);
    }
}

/* Computes the curvature that is typical of each variable: the largest |Q_jj| + sum_i S_ij^2 |Q_ii of the next node|,
 * more for a variable with more curvature beside the diagonal than on it, and at least C / size^2 of raise_units(). */
static void find_units(solver_t *s)
{
    curved_t *c = &s->curved;
    (void)memset(c->unit, 0, sizeof c->unit);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NZ; j++) {
            real_t sum = FABS(c->Q[k][j][j]);
            for (int i = 0; i < NX; i++) {
                sum += s->node[k].S[i][j] * s->node[k].S[i][j] * FABS(curved_row(c, k + 1, i)[i]);
            }
            enlarge(&c->unit[j], sum);
        }
    }
    raise_units(s, c->unit);
    for (int k = 0; k < N; k++) {
        extend_units(c->Q[k][0], NZ, NZ, c->unit);
    }
}

/* Returns the bound to which a multiplier belongs. */
static inline real_t bound_of(real_t lower, real_t upper, real_t mult)
{
    return (mult > R(0)) ? upper : lower;
}

/* Returns 1 if row m is held: an equation, or a row with a multiplier. */
static int row_is_held(const solver_t *s, int m)
{
    const real_t mult = FABS(s->trial.step.mult[m]);
    if (row_is_soft(s, m)) {
        /* at its kink */
        return mult > R(0) && mult < FACTOR_SHIFT_AT_KINK * row_l1(s, m);
    }
    return mult > R(0) || row_lower(s, m) >= row_upper(s, m);
}

/* Returns the weight with which row m of gradient a has the curvature of the units of its variables; 0 if it is not
 * held. */
static real_t row_weight(const solver_t *s, int m, const real_t *a)
{
    real_t sum = R(0);
    if (!row_is_held(s, m)) {
        return R(0);
    }
    for (int i = 0; i < NZ; i++) {
        sum += a[i] * a[i] / s->curved.unit[i];
    }
    return (sum > R(0)) ? R(1) / sum : R(0);
}

/* Adds hold w a a' for all rows. */
static void hold_rows(solver_t *s, real_t hold)
{
    real_t a[NZ];
    for (int m = 0; m < NG; m++) {
        const int n = nz_at(row_node(m));
        const real_t weight = hold * s->curved.weight[m];
        if (!(weight > R(0))) {
            continue;
        }
        copy_row_gradient(s, m, a);
        for (int i = 0; i < n; i++) {
            for (int j = 0; a[i] != R(0) && j < n; j++) { /* exactly: structural zeros add nothing */
                curved_row(&s->curved, row_node(m), i)[j] += weight * a[i] * a[j];
            }
        }
    }
}

/* Adds the gradient of hold w / 2 (a'z - bound)^2 for all rows. */
static void push_rows(solver_t *s)
{
    real_t a[NZ];
    for (int m = 0; m < NG; m++) {
        const real_t weight = s->curved.hold * s->curved.weight[m];
        real_t *g = gradient_of(s, row_node(m));
        real_t value = row_constant(s, m);
        if (!(weight > R(0))) {
            continue;
        }
        if (row_is_coupled(m)) {
            for (int i = 0; i < NX; i++) {
                value += s->coupled.J_0[row_index(m)][i] * (s->xhat[i] - s->x[0][i]);
            }
        }
        copy_row_gradient(s, m, a);
        for (int i = 0; i < nz_at(row_node(m)); i++) {
            g[i] += weight * (value - s->curved.target[m]) * a[i];
        }
    }
}

/* Predicts which bounds and rows are held, and where: those with a multiplier in the last QP. */
static void predict_active(solver_t *s)
{
    curved_t *c = &s->curved;
    c->hold = R(0);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            const real_t mult = s->trial.step.mult_u[k][j];
            c->weight_u[k][j] = (FABS(mult) > R(0)) ? c->unit[NX + j] : R(0);
            c->target_u[k][j] = bound_of(control_lower(s, k, j), control_upper(s, k, j), mult);
        }
    }
    real_t a[NZ];
    for (int m = 0; m < NG; m++) {
        copy_row_gradient(s, m, a);
        c->weight[m] = row_weight(s, m, a);
        c->target[m] = bound_of(row_lower(s, m), row_upper(s, m), s->trial.step.mult[m]);
    }
}

/* Gives the held rows and controls the weight `hold`, in units of their variables, instead of their present weight. */
static void hold_active(solver_t *s, real_t hold)
{
    curved_t *c = &s->curved;
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            c->Q[k][NX + j][NX + j] += (hold - c->hold) * c->weight_u[k][j];
        }
    }
    hold_rows(s, hold - c->hold);
    c->hold = hold;
}

/* Adds the gradients of the held rows and bounds; restore_gradients() subtracts them. */
static void push_to_bounds(solver_t *s)
{
    curved_t *c = &s->curved;
    if (ITERATES && !c->in_solve) {
        return;
    }
    for (int k = 0; k < N; k++) {
        (void)memcpy(c->g[k], s->node[k].g, sizeof c->g[0]);
    }
    (void)memcpy(c->g[N], s->terminal.g, sizeof s->terminal.g);
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            if (c->weight_u[k][j] > R(0)) {
                s->node[k].g[NX + j] += c->hold * c->weight_u[k][j] * (s->u[k][j] - c->target_u[k][j]);
            }
        }
    }
    push_rows(s);
}

static void restore_gradients(solver_t *s)
{
    if (ITERATES && !s->curved.in_solve) {
        return;
    }
    for (int k = 0; k < N; k++) {
        (void)memcpy(s->node[k].g, s->curved.g[k], sizeof s->curved.g[0]);
    }
    (void)memcpy(s->terminal.g, s->curved.g[N], sizeof s->terminal.g);
}

/* Returns the smallest shift for which the QP is convex, up to a factor of 4 to the power of 2^-BISECTIONS; infinite if
 * none is found. The search starts at the last one. */
static real_t smallest_shift(solver_t *s)
{
    real_t high = (s->curved.shift > FACTOR_SHIFT_RESTART) ? s->curved.shift : FACTOR_SHIFT_FIRST;
    int trial = 0;
    while (!is_convex(s, high)) { /* at most MAX_SHIFTS + 1 passes */
        if (trial++ == MAX_SHIFTS) {
            return INF;
        }
        high *= FACTOR_SHIFT_RATIO;
    }
    for (int n = 0; n < MAX_SHIFTS && trial == 0 && is_convex(s, high / FACTOR_SHIFT_RATIO); n++) {
        high /= FACTOR_SHIFT_RATIO;
    }
    real_t low = high / FACTOR_SHIFT_RATIO;
    for (int n = 0; n < BISECTIONS; n++) {
        const real_t middle = SQRT(low * high);
        if (is_convex(s, middle)) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return high;
}

/* Makes the curvature of idle components positive; it is their diagonal entry, as their columns of [A B] almost
 * vanish. */
static void mirror_idle(solver_t *s)
{
    curved_t *c = &s->curved;
    for (int k = 0; k < N; k++) {
        for (int i = first_idle(); i < NZ; i++) {
            if (c->Q[k][i][i] < R(0) && idle_slope[i] >= R(0) && is_idle(s, k, i)) {
                c->Q[k][i][i] *= -R(1);
            }
        }
    }
}

/* Makes the Hessian convex: unchanged if possible, then with little or much weight on the predicted active set, with
 * the proximal shift, or with the smallest shift. Returns 0 if that is impossible. */
static int convexify(solver_t *s)
{
    curved_t *c = &s->curved;
    real_t shift = c->damping;
    find_units(s);
    predict_active(s);
    int convex = is_convex(s, shift);
    if (SADDLES) {
        if (!convex) {
            mirror_idle(s);
            convex = is_convex(s, shift);
        }
    }
    for (int trial = 0; trial < 3 && !convex; trial++) {
        if (trial < 2) {
            hold_active(s, (trial == 0) ? R(1) : FACTOR_SHIFT_FIRM_HOLD);
        } else {
            enlarge(&shift, c->proximal);
        }
        convex = is_convex(s, shift);
    }
    if (!convex) {
        const real_t least = smallest_shift(s);
        if (!(least < INF)) {
            return 0;
        }
        c->shift = least;
        shift = FACTOR_SHIFT_MARGIN * least + c->damping;
    }
    c->used = shift;
    for (int k = 0; k <= N && shift > R(0); k++) {
        for (int i = 0; i < nz_at(k); i++) {
            curved_row(c, k, i)[i] += shift * c->unit[i];
        }
    }
    return 1;
}

/* Forms the QP of the present linearisation. */
static status_t form_qp(solver_t *s)
{
    if (ITERATES && !s->curved.in_solve) {
        return condense_prepare(s);
    }
    if (!convexify(s)) {
        return NUMERICAL_FAILURE;
    }
    push_to_bounds(s);
    return condense_prepare(s);
}

/* Increases the curvature after a QP without a solution, which may have one then. Returns 0 if the curvature is already
 * large. */
static int damp_qp(solver_t *s)
{
    curved_t *c = &s->curved;
    if (ITERATES && !c->in_solve) {
        return 0;
    }
    if (!(c->damping < R(1))) {
        return 0;
    }
    c->damping = (c->damping > R(0)) ? FACTOR_SQP_DAMP_STRONGLY * c->damping : FACTOR_SQP_FIRST_DAMPING;
    if (ITERATES) {
        enlarge(&c->damping, s->sqp.hasty ? R(1) : R(0));
    }
    s->trial.length = R(0);
    s->trial.elastic = 0;
    return 1;
}

/* Adapts the shift of the next Hessian: it grows after a step that had to be shortened. Returns 1 if the same point may
 * be tried again with a larger shift. */
static int adapt_shifts(solver_t *s, status_t status)
{
    curved_t *c = &s->curved;
    if (ITERATES && !c->in_solve) {
        return 0;
    }
    const real_t length = (status == STALLED) ? R(0) : s->trial.length;
    c->proximal = clip(
        c->proximal * ((length < R(1)) ? FACTOR_SQP_DAMP : R(1) / FACTOR_SQP_DAMP), FACTOR_SQP_LEAST_PROXIMAL, R(1));
    if (length < FACTOR_SQP_SHORT_STEP) {
        const real_t growth = (length < FACTOR_SQP_VERY_SHORT_STEP) ? FACTOR_SQP_DAMP_STRONGLY : FACTOR_SQP_DAMP;
        c->damping = (c->damping > R(0)) ? growth * c->damping : FACTOR_SQP_FIRST_DAMPING;
    } else if (length >= R(1)) {
        c->damping = (c->damping > FACTOR_SQP_LEAST_DAMPING) ? c->damping / FACTOR_SQP_DAMP : R(0);
    }
    return status == STALLED && c->damping < FACTOR_SQP_MOST_DAMPING;
}

/* Returns 1 if steps have become so short that only another start may help. */
static int is_damped_for_ever(const solver_t *s)
{
    return !(s->curved.damping < FACTOR_SQP_LAST_DAMPING);
}

/* Scales down multipliers that exceed what the cost can explain, far from feasibility. Their Hessian would hide the
 * cost from the next QP, whose multipliers would be larger still. */
static void bound_multipliers(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    const real_t most = FACTOR_SQP_MOST_MULTIPLIER * ((q->cost_scale > q->cost_unit) ? q->cost_scale : q->cost_unit);
    real_t largest = R(0);
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            enlarge(&largest, s->lam[k][i] * size_or(q->state_scale[i], z_scale[i]));
        }
    }
    if (!(q->base.violation > FACTOR_SQP_INFEASIBLE) || largest <= most) {
        return;
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < NX; i++) {
            s->lam[k][i] *= most / largest;
        }
        for (int j = 0; k < N && j < NU; j++) {
            s->mu_u[k][j] *= most / largest;
        }
    }
    for (int m = 0; m < NG; m++) {
        s->mult[m] *= most / largest;
    }
}
