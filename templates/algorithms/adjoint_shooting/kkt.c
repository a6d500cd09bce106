/* KKT residuals of the plan: the absolute ones, and the largest relative one. A residual is divided by the scale of its
 * variable or row plus the sum of the magnitudes of its terms. The dynamics hold because the states are simulated. The
 * argument `what` selects the multipliers of the rows or their estimates; the multipliers of the control bounds follow
 * from the gradient. */

#include "algorithms/shared/kkt_terms.c"

static void kkt_soft_row(const solver_t *s, int m, real_t value, real_t mu, kkt_t *kkt)
{
    const real_t l1 = row_l1(s, m), l2 = row_l2(s, m);
    const real_t scale = row_magnitude[row_id(m)];
    kkt_soft_side(kkt, value - row_upper(s, m), (mu > R(0)) ? mu : R(0), l1, l2, value, scale);
    kkt_soft_side(kkt, row_lower(s, m) - value, (mu < R(0)) ? -mu : R(0), l1, l2, value, scale);
}

/* Evaluates violation and complementarity of all rows. */
static void kkt_rows(const solver_t *s, int what, kkt_t *kkt)
{
    real_t value[NG];
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        const real_t mu = row_factor(s, m, value[m], what, R(0));
        if (row_is_soft(s, m)) {
            kkt_soft_row(s, m, value[m], mu, kkt);
            continue;
        }
        kkt_row(kkt, value[m], row_lower(s, m), row_upper(s, m), mu, row_magnitude[row_id(m)]);
    }
}

/* Evaluates stationarity with respect to control j at node k, whose gradient a bound may hold. */
static void kkt_control(const solver_t *s, int k, int j, real_t pulled, real_t own, kkt_t *kkt)
{
    const real_t u = s->u[k][j], lower = control_lower(s, k, j), upper = control_upper(s, k, j), g = pulled + own;
    const int holds = (g > R(0) && !(u > lower)) || (g < R(0) && !(u < upper));
    kkt_row(kkt, u, lower, upper, holds ? -g : R(0), z_scale[NX + j]);
    kkt_note(kkt, &kkt->stationarity, holds ? R(0) : g, FABS(pulled) + FABS(own), force_size[NX + j]);
}

/* Returns the largest relative stationarity. */
static real_t residual_of(const solver_t *s, int what, kkt_t *kkt)
{
    real_t lam[NX], g[NZ], own[NZ], stationarity;
    (void)memset(kkt, 0, sizeof *kkt);
    start_adjoint(s, what, lam);
    for (int k = N - 1; k >= 0; k--) {
        carry_back(s, k, what, lam, g, own);
        for (int j = 0; j < NU; j++) {
            kkt_control(s, k, j, g[NX + j], own[NX + j], kkt);
        }
    }
    stationarity = kkt->relative;
    for (int k = 0; k < N; k++) {
        interval_value(s, k, lam);
        for (int i = 0; i < NX; i++) {
            kkt_note(kkt, &kkt->equality, lam[i] - s->x[k + 1][i], FABS(lam[i]), z_scale[i]);
        }
    }
    kkt_rows(s, what, kkt);
    return stationarity;
}

void API(kkt)(const solver_t *s, kkt_t *out)
{
    if (s->magic != MAGIC) {
        (void)memset(out, 0, sizeof *out);
        out->relative = INF;
        return;
    }
    (void)residual_of(s, MULTIPLIER, out);
}
