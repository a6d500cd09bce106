/* Records a residual whose terms have the sum `terms` of magnitudes; `unit` is the scale of its variable or row. */
static void kkt_note(kkt_t *kkt, real_t *worst, real_t residual, real_t terms, real_t unit)
{
    enlarge(worst, residual);
    enlarge(&kkt->relative, residual / (unit + terms));
}

/* Records the residuals of one row lower <= value <= upper with multiplier mu: its violation, and |mu| times the
 * distance to the bound that the sign of mu selects. */
static void kkt_row(kkt_t *kkt, real_t value, real_t lower, real_t upper, real_t mu, real_t scale)
{
    kkt_note(kkt, &kkt->inequality, value - clip(value, lower, upper), FABS(value), scale);
    if (lower < upper && (mu > R(0) || mu < R(0))) {
        const real_t distance = mu > R(0) ? upper - value : value - lower;
        kkt_note(kkt, &kkt->complementarity, mu * distance, FABS(mu) * (scale + FABS(value)), cost_size[0]);
    }
}

/* Records the residuals of one side of a soft row with excess over its bound and multiplier m >= 0: the optimality
 * conditions of min l1 v + l2/2 v^2 s.t. v >= excess, v >= 0 at v = max(0, excess). The multiplier of v >= 0 is nu = l1
 * + l2 v - m >= 0. */
static void kkt_soft_side(kkt_t *kkt, real_t excess, real_t m, real_t l1, real_t l2, real_t value, real_t scale)
{
    const real_t v = (excess > R(0)) ? excess : R(0);
    const real_t nu = l1 + l2 * v - m, size = scale + FABS(value);
    kkt_note(kkt, &kkt->complementarity, nu * v, (l1 + l2 * v + m) * size, cost_size[0]);
    if (!(nu >= R(0))) {
        kkt_note(kkt, &kkt->complementarity, nu, l1 + l2 * v + m, cost_size[0] / scale);
    }
    if (m > R(0)) {
        kkt_note(kkt, &kkt->complementarity, m * (excess - v), m * size, cost_size[0]);
    }
}
