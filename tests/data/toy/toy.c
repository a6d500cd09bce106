#include "toy.h"

#include <math.h>

#if defined(__FAST_MATH__)
#error "toy.c needs IEEE arithmetic: compile without -ffast-math"
#endif

/* toy_solver_t.phase */
enum { RAW = 0, READY = 77, PREPARED = 78 };

static const toy_real DT = (toy_real)0.1;
static const toy_real HALF = (toy_real)0.5;

static toy_status_t report(toy_solver_t *s, toy_status_t status)
{
    s->status = (int32_t)status;
    return status;
}

/* x+ = A x + B a + d,  A = [1 dt; 0 1],  B = (dt^2/2, dt)/m */
static void propagate(const toy_real p[TOY_NP], const toy_real x[TOY_NX], toy_real a, toy_real dt, toy_real next[TOY_NX])
{
    const toy_real p0 = x[0] + dt * x[1] + HALF * dt * dt * a / p[0] + p[1];
    const toy_real v0 = x[1] + dt * a / p[0] + p[2];
    next[0] = p0;
    next[1] = v0;
}

toy_status_t toy_reset(toy_solver_t *s)
{
    int k;
    if (s->phase != READY && s->phase != PREPARED) {
        return TOY_NOT_INITIALIZED;
    }
    for (k = 0; k <= TOY_N; ++k) {
        s->x[k][0] = s->x[k][1] = 0;
        s->lam[k][0] = s->lam[k][1] = 0;
        s->mu_x[k][0] = s->mu_x[k][1] = 0;
    }
    for (k = 0; k < TOY_N; ++k) {
        s->u[k][0] = 0;
        s->mu_u[k][0] = 0;
        s->mu[k][0] = 0;
    }
    s->mu_N[0] = 0;
    s->samples = 0;
    s->stats.qp_iterations = 0;
    s->stats.active_set_changes = 0;
    s->stats.dropped_rows = 0;
    s->stats.relaxed_rows = 0;
    s->stats.sqp_iterations = 0;
    s->stats.violated_row = s->stats.violated_node = -1;
    s->stats.violation = 0;
    s->kkt.stationarity = s->kkt.equality = s->kkt.inequality = s->kkt.complementarity = 0;
    s->phase = READY;
    return report(s, TOY_OK);
}

toy_status_t toy_init(toy_solver_t *s)
{
    int i;
    int k;
    for (k = 0; k <= TOY_N; ++k) {
        s->p[k][0] = 1;
        s->p[k][1] = s->p[k][2] = 0;
    }
    for (k = 0; k < TOY_N; ++k) {
        s->yref[k][0] = s->yref[k][1] = s->yref[k][2] = 0;
    }
    s->yref_N[0] = s->yref_N[1] = 0;
    s->W[0][0] = 10;
    s->W[0][1] = 1;
    s->W[0][2] = (toy_real)0.1;
    s->W_N[0] = 100;
    s->W_N[1] = 10;
    for (i = 0; i < 2; ++i) {
        s->lower[i][0] = -5;
        s->upper[i][0] = 5;
        s->lower[i][1] = s->lower[i][2] = -INFINITY;
        s->upper[i][1] = s->upper[i][2] = INFINITY;
    }
    s->phase = READY;
    return toy_reset(s);
}

/* One step of the recursion from cost-to-go k+1 to k. */
static toy_status_t riccati_step(toy_solver_t *s, int k)
{
    toy_riccati_t *r = &s->riccati;
    const toy_real B0 = HALF * DT * DT / s->p[k][0];
    const toy_real B1 = DT / s->p[k][0];
    const toy_real p00 = r->P[k + 1][0][0];
    const toy_real p01 = r->P[k + 1][0][1];
    const toy_real p11 = r->P[k + 1][1][1];
    const toy_real g0 = p00 * s->p[k][1] + p01 * s->p[k][2] + r->s[k + 1][0];
    const toy_real g1 = p01 * s->p[k][1] + p11 * s->p[k][2] + r->s[k + 1][1];
    const toy_real BP0 = B0 * p00 + B1 * p01;
    const toy_real BP1 = B0 * p01 + B1 * p11;
    const toy_real R = s->W[0][2] + BP0 * B0 + BP1 * B1;
    const toy_real S0 = BP0;
    const toy_real S1 = BP0 * DT + BP1;
    const toy_real h = -s->W[0][2] * s->yref[k][2] + B0 * g0 + B1 * g1;
    if (!(R > 0)) {
        return TOY_NUMERICAL_FAILURE;
    }
    r->K[k][0] = -S0 / R;
    r->K[k][1] = -S1 / R;
    r->f[k] = -h / R;
    r->P[k][0][0] = s->W[0][0] + p00 - S0 * S0 / R;
    r->P[k][0][1] = r->P[k][1][0] = p00 * DT + p01 - S0 * S1 / R;
    r->P[k][1][1] = s->W[0][1] + DT * (p00 * DT + p01) + p01 * DT + p11 - S1 * S1 / R;
    r->s[k][0] = -s->W[0][0] * s->yref[k][0] + g0 - S0 * h / R;
    r->s[k][1] = -s->W[0][1] * s->yref[k][1] + DT * g0 + g1 - S1 * h / R;
    return TOY_OK;
}

toy_status_t toy_prepare(toy_solver_t *s)
{
    toy_riccati_t *r = &s->riccati;
    int k;
    if (s->phase != READY && s->phase != PREPARED) {
        return TOY_NOT_INITIALIZED;
    }
    r->P[TOY_N][0][0] = s->W_N[0];
    r->P[TOY_N][1][1] = s->W_N[1];
    r->P[TOY_N][0][1] = r->P[TOY_N][1][0] = 0;
    r->s[TOY_N][0] = -s->W_N[0] * s->yref_N[0];
    r->s[TOY_N][1] = -s->W_N[1] * s->yref_N[1];
    for (k = TOY_N - 1; k >= 0; --k) {
        const toy_status_t status = riccati_step(s, k);
        if (status != TOY_OK) {
            return report(s, status);
        }
    }
    s->phase = PREPARED;
    return report(s, TOY_OK);
}

static toy_real clip(const toy_solver_t *s, toy_real a)
{
    const toy_real low = s->lower[0][0];
    const toy_real high = s->upper[0][0];
    return a < low ? low : (a > high ? high : a);
}

/* lam_N = W_N (x_N - yref_N),  lam_k = Q (x_k - yref_k) + A' lam_{k+1},  mu_u = -(W_a (a - yref_a) + B' lam_{k+1}) */
static void multipliers(toy_solver_t *s)
{
    int k;
    s->lam[TOY_N][0] = s->W_N[0] * (s->x[TOY_N][0] - s->yref_N[0]);
    s->lam[TOY_N][1] = s->W_N[1] * (s->x[TOY_N][1] - s->yref_N[1]);
    for (k = TOY_N - 1; k >= 0; --k) {
        const toy_real l0 = s->lam[k + 1][0];
        const toy_real l1 = s->lam[k + 1][1];
        const toy_real Bl = (HALF * DT * DT * l0 + DT * l1) / s->p[k][0];
        s->mu_u[k][0] = -(s->W[0][2] * (s->u[k][0] - s->yref[k][2]) + Bl);
        s->lam[k][0] = s->W[0][0] * (s->x[k][0] - s->yref[k][0]) + l0;
        s->lam[k][1] = s->W[0][1] * (s->x[k][1] - s->yref[k][1]) + DT * l0 + l1;
    }
}

toy_status_t toy_feedback(toy_solver_t *s, const toy_real xhat[TOY_NX], toy_real u0[TOY_NU])
{
    const toy_real x0 = xhat[0];
    const toy_real x1 = xhat[1];
    int changes = 0;
    int k;
    u0[0] = clip(s, 0);
    if (s->phase != READY && s->phase != PREPARED) {
        return TOY_NOT_INITIALIZED;
    }
    if (s->phase != PREPARED) {
        return report(s, TOY_NOT_PREPARED);
    }
    if (!isfinite(x0) || !isfinite(x1)) {
        return report(s, TOY_NOT_FINITE);
    }
    s->x[0][0] = x0;
    s->x[0][1] = x1;
    for (k = 0; k < TOY_N; ++k) {
        const toy_real *K = s->riccati.K[k];
        const toy_real a = K[0] * s->x[k][0] + K[1] * s->x[k][1] + s->riccati.f[k];
        s->u[k][0] = clip(s, a);
        changes += s->u[k][0] < a || s->u[k][0] > a;
        propagate(s->p[k], s->x[k], s->u[k][0], DT, s->x[k + 1]);
    }
    multipliers(s);
    u0[0] = s->u[0][0];
    s->stats.qp_iterations = 1;
    s->stats.active_set_changes = changes;
    s->samples += 1;
    s->phase = READY;
    return report(s, changes > 0 ? TOY_RELAXED : TOY_OK);
}

toy_status_t toy_step(toy_solver_t *s, const toy_real xhat[TOY_NX], toy_real u0[TOY_NU])
{
    const toy_status_t prepared = toy_prepare(s);
    const toy_status_t status = toy_feedback(s, xhat, u0);
    return prepared == TOY_OK ? status : report(s, prepared);
}

toy_status_t toy_shift(toy_solver_t *s)
{
    int k;
    for (k = 0; k < TOY_N; ++k) {
        s->x[k][0] = s->x[k + 1][0];
        s->x[k][1] = s->x[k + 1][1];
        s->u[k][0] = s->u[k + 1 < TOY_N ? k + 1 : k][0];
    }
    propagate(s->p[TOY_N - 1], s->x[TOY_N - 1], s->u[TOY_N - 1][0], DT, s->x[TOY_N]);
    return report(s, TOY_OK);
}

toy_status_t toy_solve(toy_solver_t *s, const toy_real xhat[TOY_NX], toy_real tol, int max_iterations)
{
    toy_real u0[TOY_NU];
    toy_status_t status;
    if (!(tol > 0) || max_iterations < 1) {
        return report(s, TOY_BAD_ARGUMENT);
    }
    status = toy_step(s, xhat, u0);
    s->stats.sqp_iterations = 1;
    return status;
}

void toy_integrate(const toy_solver_t *s, const toy_real x[TOY_NX], const toy_real u[TOY_NU], toy_real dt, toy_real x_next[TOY_NX])
{
    propagate(s->p[0], x, u[0], dt, x_next);
}

toy_status_t toy_set_reference(toy_solver_t *s, int k, const toy_real yref[TOY_NY])
{
    int i;
    int j;
    if (k < TOY_ALL || k >= TOY_N) {
        return TOY_BAD_INDEX;
    }
    for (j = 0; j < TOY_N; ++j) {
        for (i = 0; i < TOY_NY; ++i) {
            s->yref[j][i] = k == TOY_ALL || k == j ? yref[i] : s->yref[j][i];
        }
    }
    return TOY_OK;
}

toy_status_t toy_set_terminal_reference(toy_solver_t *s, const toy_real yref[TOY_NY_N])
{
    s->yref_N[0] = yref[0];
    s->yref_N[1] = yref[1];
    return TOY_OK;
}

toy_status_t toy_set_weight(toy_solver_t *s, int k, const toy_real W[TOY_NY])
{
    int i;
    if (k != TOY_ALL) {
        return TOY_BAD_INDEX;
    }
    for (i = 0; i < TOY_NY; ++i) {
        s->W[0][i] = W[i];
    }
    return TOY_OK;
}

toy_status_t toy_set_terminal_weight(toy_solver_t *s, const toy_real W[TOY_NY_N])
{
    s->W_N[0] = W[0];
    s->W_N[1] = W[1];
    return TOY_OK;
}

toy_status_t toy_set_parameter(toy_solver_t *s, int param, int k, const toy_real *values)
{
    static const int offset[2] = {0, 1};
    static const int size[2] = {1, 2};
    int i;
    int j;
    if (param < 0 || param > 1) {
        return TOY_BAD_ARGUMENT;
    }
    if (k < TOY_ALL || k > TOY_N) {
        return TOY_BAD_INDEX;
    }
    for (j = 0; j <= TOY_N; ++j) {
        for (i = 0; i < size[param]; ++i) {
            if (k == TOY_ALL || k == j) {
                s->p[j][offset[param] + i] = values[i];
            }
        }
    }
    return TOY_OK;
}

/* Bounds are shared: one for all path nodes, one for the terminal node. */
toy_status_t toy_set_bounds(toy_solver_t *s, int row, int k, toy_real lower, toy_real upper)
{
    if (row < 0 || row >= TOY_NR) {
        return TOY_BAD_ARGUMENT;
    }
    if (k != TOY_ALL && k != TOY_N) {
        return TOY_BAD_INDEX;
    }
    if (!(lower <= upper)) {
        return TOY_BAD_BOUNDS;
    }
    if (k == TOY_ALL) {
        s->lower[0][row] = lower;
        s->upper[0][row] = upper;
    }
    s->lower[1][row] = lower;
    s->upper[1][row] = upper;
    return TOY_OK;
}

/* sum_k 1/2 |y_k - yref_k|^2_W + 1/2 |y_N - yref_N|^2_{W_N} */
toy_real toy_cost(const toy_solver_t *s)
{
    toy_real sum = 0;
    int i;
    int k;
    for (k = 0; k < TOY_N; ++k) {
        const toy_real y[TOY_NY] = {s->x[k][0], s->x[k][1], s->u[k][0]};
        for (i = 0; i < TOY_NY; ++i) {
            sum += HALF * s->W[0][i] * (y[i] - s->yref[k][i]) * (y[i] - s->yref[k][i]);
        }
    }
    for (i = 0; i < TOY_NY_N; ++i) {
        sum += HALF * s->W_N[i] * (s->x[TOY_N][i] - s->yref_N[i]) * (s->x[TOY_N][i] - s->yref_N[i]);
    }
    return sum;
}

/* Stationarity and gaps vanish by construction; a multiplier of an inactive or wrong bound is not complementary. */
void toy_kkt(const toy_solver_t *s, toy_kkt_t *out)
{
    int k;
    out->stationarity = out->equality = out->inequality = out->complementarity = 0;
    for (k = 0; k < TOY_N; ++k) {
        const toy_real mu = s->mu_u[k][0];
        const toy_real gap = mu > 0 ? s->upper[0][0] - s->u[k][0] : s->u[k][0] - s->lower[0][0];
        const toy_real product = (toy_real)fabs((double)(mu * gap));
        out->complementarity = product > out->complementarity ? product : out->complementarity;
    }
}

const char *toy_status_string(toy_status_t status)
{
    static const char *const names[12] = {"OK", "ITERATION_LIMIT", "INFEASIBLE", "RELAXED",
                                          "NUMERICAL_FAILURE", "NOT_FINITE", "NOT_PREPARED", "NOT_INITIALIZED",
                                          "BAD_INDEX", "BAD_BOUNDS", "BAD_ARGUMENT", "STALLED"};
    return (int)status >= 0 && (int)status < 12 ? names[status] : "UNKNOWN";
}
