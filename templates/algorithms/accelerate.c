/* Anderson acceleration of solve() (Walker and Ni 2011). Steps with a Hessian that neglects curvature converge linearly;
 * the last two steps d_j and the points z_j + d_j to which they led show what is neglected. The step becomes
 *
 *     d - sum_j gamma_j (z + d - z_j - d_j),   gamma = argmin |d - sum_j gamma_j (d - d_j)|,
 *
 * in the norm of the diagonal of the path Hessians, which knows the units. */

/* Values of trend: whether steps in nearly the same direction shrink. Where they do not, there is negative curvature, and
 * acceleration would lead to a saddle point: steps are lengthened instead. */
enum { NO_TREND, SHRINKING, GROWING };

/* Component i of (dx, du) at node k. */
static inline real_t *step_at(step_t *d, int k, int i)
{
    return (i < NX) ? &d->dx[k][i] : &d->du[k][i - NX];
}

#if ACCELERATE
/* The point to which a step from the present one leads. */
static inline real_t point_after(const solver_t *s, real_t d, int k, int i)
{
    return d + ((i < NX) ? s->x[k][i] : s->u[k][i - NX]);
}

#endif
/* square = |d|^2, and the trend since the latest step, |d_j|^2 and d'd_j. */
static void update_trend(solver_t *s)
{
    sqp_t *q = &s->sqp;
    real_t before = R(0), both = R(0);
    q->square = R(0);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t d = *step_at(&s->step, k, i), last = q->past[q->latest].d[k][i];
            const real_t w = FABS(HESSIAN(s, k)[i][i]);
            q->square += w * d * d;
            before += w * last * last;
            both += w * d * last;
        }
    }
    q->trend = NO_TREND;
    if (q->points > 0 && both > R(0) && both * both > R(0.5) * q->square * before) {
        q->trend = (q->square < R(0.9) * before) ? SHRINKING : GROWING;
    }
    q->much_shorter = q->square < R(0.01) * before;
}

#if ACCELERATE
/* Normal equations of gamma; entries of unknown steps are 0. */
static void normal_equations(solver_t *s, real_t a[2][2], real_t *b)
{
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t w = HESSIAN(s, k)[i][i], d = *step_at(&s->step, k, i);
            real_t e[2] = {R(0), R(0)};
            for (int j = 0; j < 2 && j < s->sqp.points; j++) {
                e[j] = d - s->sqp.past[j].d[k][i];
                a[j][j] += w * e[j] * e[j];
                b[j] += w * e[j] * d;
            }
            a[0][1] += w * e[0] * e[1];
        }
    }
}

/* Sets the step to the accelerated one. Returns 0 if there is none, because nothing is known or because d is much shorter
 * than the step before. */
static int accelerate(solver_t *s)
{
    const sqp_t *q = &s->sqp;
    const int n = q->latest;
    real_t a[2][2] = {{R(0), R(0)}, {R(0), R(0)}}, b[2] = {R(0), R(0)}, gamma[2] = {R(0), R(0)};
    if (q->points == 0 || q->much_shorter) {
        return 0;
    }
    normal_equations(s, a, b);
    if (!(a[n][n] > R(0))) {
        return 0;
    }
    const real_t determinant = a[0][0] * a[1][1] - a[0][1] * a[0][1];
    gamma[n] = b[n] / a[n][n];
    if (determinant > R(1e-6) * a[0][0] * a[1][1]) {
        gamma[0] = (b[0] * a[1][1] - b[1] * a[0][1]) / determinant;
        gamma[1] = (b[1] * a[0][0] - b[0] * a[0][1]) / determinant;
    }
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < (k < N ? NZ : NX); i++) {
            real_t *d = step_at(&s->step, k, i);
            const real_t end = point_after(s, *d, k, i);
            for (int j = 0; j < q->points; j++) {
                *d -= gamma[j] * (end - q->past[j].end[k][i]);
            }
        }
    }
    return step_is_finite(s);
}

#endif
/* Stores the step from the present point in place of the older one. */
static void remember_last(solver_t *s)
{
    sqp_t *q = &s->sqp;
    q->latest = (q->points < 2) ? q->points++ : 1 - q->latest;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < (k < N ? NZ : NX); i++) {
            const real_t d = *step_at(&q->step, k, i);
            q->past[q->latest].d[k][i] = d;
#if ACCELERATE
            q->past[q->latest].end[k][i] = point_after(s, d, k, i);
#endif
        }
    }
}

/* The length at which the search begins: steps that grow are tried at four times the last length. */
static void choose_length(sqp_t *q)
{
    const real_t before = (q->length > R(1)) ? q->length : R(1);
    q->length = (q->trend == GROWING) ? R(4) * before : R(1);
}

#if ACCELERATE
/* Returns to the plan from which the steps under watch started; its own step is searched along next. */
static void return_from_watch(solver_t *s)
{
    s->sqp.watched = -1;
    memcpy(s->x, s->sqp.watched_x, sizeof s->x);
    memcpy(s->u, s->sqp.watched_u, sizeof s->u);
}

/* Accelerated steps are long, and their errors of second order may hide from the filter what they gain (Maratos effect).
 * If it rejects one, up to MAX_WATCHED steps are taken without it. They have to halve |d|: otherwise the plan from which
 * they started returns, its step is searched along as usual, and there is no further trial before |d| has been halved.
 * Returns 1 if the plan has returned. */
static int watch(solver_t *s)
{
    sqp_t *q = &s->sqp;
    update_trend(s);
    if (q->watched > 0 && q->square < R(0.25) * q->watched_square) {
        q->watched = 0;
        q->watched_square = R(0);
    }
    if (q->watched < MAX_WATCHED) {
        return 0;
    }
    return_from_watch(s);
    return 1;
}

/* Returns 1 if a step has been taken that is not searched along, an accelerated one or one under watch. */
static int takes_accelerated(solver_t *s, const measures_t *start, real_t gain)
{
    sqp_t *q = &s->sqp;
    const int accelerated = q->watched >= 0 && accelerate(s) && (q->trend != GROWING || q->watched > 0);
    remember_last(s);
    if (!accelerated) {
        s->step = q->step;
    }
    if (!accelerated && q->watched <= 0) {
        q->watched = 0;
        return 0;
    }
    const real_t slope = slope_of(s);
    take_step(s);
    if (q->watched <= 0 && accepts(s, start, R(1), slope, gain)) {
        return 1;
    }
    const measures_t at = measure(s);
    const int usable = at.violation < INF && at.cost < INF;
    if (q->watched > 0) {
        q->watched++;
        if (!usable) {
            return_from_watch(s);
        }
        return 1;
    }
    const int failed = q->watched_square > R(0) && q->square > R(0.25) * q->watched_square;
    if (!usable || q->trend != SHRINKING || failed) {
        move_back(s);
        s->step = q->step;
        return 0;
    }
    q->watched = 1;
    q->watched_square = q->square;
    memcpy(q->watched_x, q->x, sizeof q->x);
    memcpy(q->watched_u, q->u, sizeof q->u);
    return 1;
}
#endif
