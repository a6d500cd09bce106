/* The filter holds pairs of measures; a new point has to improve one of each pair (Waechter and Biegler 2005, algorithm
 * A). */

/* Returns 1 if the filter accepts a point. */
static int passes_filter(const sqp_t *q, const measures_t *at)
{
    int ok = at->violation <= q->most_violation && at->cost < INF;
    for (int n = 0; n < q->entries; n++) {
        ok &= at->violation < q->filter[n].violation || at->cost < q->filter[n].cost;
    }
    return ok;
}

/* Extends the filter: points that are not better than the base, up to rounding of the violation, are rejected from now
 * on. Entries that the new one dominates leave; if there are FILTER others, the one with the largest violation is
 * replaced. */
static void extend_filter(sqp_t *q)
{
    const measures_t added = {(R(1) - FACTOR_FILTER_SHARE) * q->base.violation + TOL_MERIT_ROUNDING,
        q->base.cost - FACTOR_FILTER_SHARE * q->base.violation * q->cost_scale};
    int kept = 0, worst = 0;
    for (int n = 0; n < q->entries; n++) {
        if (q->filter[n].violation < added.violation || q->filter[n].cost < added.cost) {
            q->filter[kept] = q->filter[n];
            worst = (q->filter[kept].violation > q->filter[worst].violation) ? kept : worst;
            kept++;
        }
    }
    q->filter[(kept < FILTER) ? kept : worst] = added;
    q->entries = (kept < FILTER) ? kept + 1 : FILTER;
}

/* Returns 1 if the present point is accepted after the step. While feasibility is restored, the violation has to
 * decrease by a fraction of `gain`, the decrease that the linearised rows and gaps predict. Otherwise the filter has to
 * accept the point, the violation must not become more than ten times as large, and the cost has to fall if the step is
 * expected to reduce it by more than it violates. */
static int accepts(solver_t *s)
{
    sqp_t *q = &s->sqp;
    const measures_t at = measure(s), *base = &q->base;
    const real_t rounding = TOL_MERIT_ROUNDING * (FABS(base->cost) + q->cost_scale);
    const real_t share = FACTOR_FILTER_SHARE * base->violation, descent = -q->slope / q->cost_scale;
    if (q->restoring) {
        return at.cost < INF && at.violation <= base->violation - FACTOR_SQP_ARMIJO * s->trial.length * q->gain;
    }
    if (!passes_filter(q, &at) || at.violation > FACTOR_SQP_MOST_GROWTH * base->violation + FACTOR_SQP_GROWTH_FLOOR) {
        return 0;
    }
    if (descent > R(0) && base->violation <= FACTOR_FILTER_DESCENT * q->most_violation &&
        s->trial.length * descent * descent > base->violation) {
        return at.cost <= base->cost + FACTOR_SQP_ARMIJO * s->trial.length * q->slope + rounding;
    }
    if (at.violation > base->violation - share + TOL_MERIT_ROUNDING &&
        at.cost > base->cost - share * q->cost_scale + rounding) {
        return 0;
    }
    extend_filter(q);
    return 1;
}
