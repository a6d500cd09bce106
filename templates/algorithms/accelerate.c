/* Anderson acceleration of solve() (Walker and Ni 2011). Steps with a Hessian that neglects curvature converge linearly;
 * the changes of the last two steps d and of the points z + d to which they lead show what is neglected. The step becomes
 *
 *     d - sum_j gamma_j change_j(z + d),   gamma = argmin |d - sum_j gamma_j change_j(d)|,
 *
 * in the norm of the diagonal of the path Hessians, which knows the units. */

/* Values of trend: whether steps in nearly the same direction shrink. Where they do not, there is negative curvature, and
 * acceleration would lead to a saddle point: steps are lengthened instead. */
enum { NO_TREND, SHRINKING, GROWING };

/* square = |d|^2 of the step of the QP, the trend since the last step, and gamma, before the last step is overwritten. */
static void update_trend(solver_t *s)
{
    sqp_t *q = &s->sqp;
    real_t before = R(0), both = R(0);
#if ACCELERATE
    real_t a = R(0), b = R(0), c = R(0);
#endif
    q->square = R(0);
    for (int k = 0; k < N; k++) {
        for (int i = 0; i < NZ; i++) {
            const real_t d = *step_at(&s->step, k, i), last = *step_at(&q->step, k, i);
            const real_t w = FABS(HESSIAN(s, k)[i][i]);
            q->square += w * d * d;
            before += w * last * last;
            both += w * d * last;
#if ACCELERATE
            const real_t older = q->change[k][i].d;
            a += w * older * older;
            b += w * older * (d - last);
            c += w * older * d;
#endif
        }
    }
    q->trend = NO_TREND;
    if (q->comparable && both > R(0) && both * both > R(0.5) * q->square * before) {
        q->trend = (q->square < R(0.9) * before) ? SHRINKING : GROWING;
    }
#if ACCELERATE
    const real_t e = q->square - both, change = e + (before - both), determinant = a * change - b * b;
    q->gamma[0] = q->gamma[1] = R(0);
    if (q->comparable && q->trend != GROWING && change > R(0)) {
        q->gamma[1] = (determinant > R(1e-3) * a * change) ? (c * change - b * e) / determinant : R(0);
        q->gamma[0] = (e - q->gamma[1] * b) / change;
    }
#endif
}

#if ACCELERATE
/* Sets the step to the accelerated one and stores the changes since the last. */
static void accelerate(solver_t *s)
{
    sqp_t *q = &s->sqp;
    for (int k = 0; k <= N; k++) {
        for (int i = 0; i < nz_at(k); i++) {
            change_t *change = &q->change[k][i];
            real_t *d = step_at(&s->step, k, i);
            const real_t end = point_at(s, k, i) + *d, older = change->end;
            change->d = R(q->comparable) * (*d - change->last_d);
            change->end = R(q->comparable) * (end - change->last_end);
            change->last_d = *d;
            change->last_end = end;
            *d -= q->gamma[0] * change->end + q->gamma[1] * older;
        }
    }
}

/* Returns 1 if the accelerated step has been taken. Such steps are long, and their errors of second order may hide from
 * the filter what they gain (Maratos effect): while steps shrink, MAX_WATCHED of those that it rejects are taken all the
 * same before |d| must have been halved. */
static int takes_accelerated(solver_t *s)
{
    sqp_t *q = &s->sqp;
    const real_t slope = q->slope;
    accelerate(s);
    if (!(FABS(q->gamma[0]) > R(0))) {
        return 0;
    }
    q->length = R(1);
    q->slope = slope_of(s);
    take_step(s);
    if (accepts(s)) {
        return 1;
    }
    q->slope = slope;
    if (q->square < R(0.25) * q->milestone) {
        q->milestone = q->square;
        q->watched = 0;
    }
    const measures_t at = measure(s);
    if (q->trend == SHRINKING && q->watched < MAX_WATCHED && at.violation < INF && at.cost < INF) {
        q->watched++;
        return 1;
    }
    move_back(s);
    return 0;
}
#endif
