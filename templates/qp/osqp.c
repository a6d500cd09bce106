/* Component "qp". Contract: qp_init, qp_factorize and qp_solve for the condensed QP
 *     min  1/2 z'H z + g'z   s.t.   lower[i] <= z_i <= upper[i],  i < NV;
 *                                   lower[NV+j] <= A[j] z <= upper[NV+j],  j < NG
 * Here: OSQP, third-party code in the folder osqp/ with one static workspace. Copies of the solver struct share this
 * workspace, so that solves must not overlap. All data are loaded again for every solve. */

/* Solves the QP; defined in osqp/API(osqp).c. Returns the status of OSQP, or 0 if OSQP rejects the data. Infinite
 * bounds become OSQP_INFTY. */
int API(osqp_solve)(const double *P, const double *A, const double *g, const double *lower, const double *upper,
    double *z, double *mult, double *certificate, int *iterations);

static void qp_init(qp_t *q)
{
    (void)memset(q, 0, sizeof *q);
    for (int c = 0; c < NV + NG; ++c) {
        q->lower[c] = -INF;
        q->upper[c] = INF;
        q->penalty[c] = INF;
    }
}

/* Stores the matrices H and A by columns. */
static status_t qp_factorize(qp_t *q)
{
    int n = 0;
    for (int j = 0; j < NV; ++j) {
        for (int i = 0; i <= j; ++i) {
            q->P_x[n++] = q->H[j][i];
        }
    }
    n = 0;
    for (int j = 0; j < NV; ++j) {
        q->A_x[n++] = R(1);
        for (int i = 0; i < NG; ++i) {
            q->A_x[n++] = q->A[i][j];
        }
    }
    return all_finite(q->P_x, OSQP_P) && all_finite(q->A_x, OSQP_A) ? OK : NUMERICAL_FAILURE;
}

static status_t qp_fail(qp_t *q, status_t status)
{
    (void)memset(q->z, 0, sizeof q->z);
    (void)memset(q->mult, 0, sizeof q->mult);
    return status;
}

/* Scales the dual ray of an infeasible QP to max |f| = 1. */
static void qp_scale_certificate(qp_t *q)
{
    real_t largest = R(0);
    for (int c = 0; c < NV + NG; ++c) {
        const real_t f = FABS(q->certificate[c]);
        largest = (f > largest) ? f : largest;
    }
    for (int c = 0; c < NV + NG && largest > R(0); ++c) {
        q->certificate[c] /= largest;
    }
}

static status_t qp_solve(qp_t *q)
{
    int iterations = 0, ordered = 1;
    q->iterations = 0;
    (void)memset(q->certificate, 0, sizeof q->certificate);
    for (int c = 0; c < NV + NG; ++c) {
        if (isnan(q->lower[c]) || isnan(q->upper[c])) {
            return qp_fail(q, NUMERICAL_FAILURE);
        }
        ordered &= q->lower[c] <= q->upper[c];
    }
    if (!ordered || !all_finite(q->g, NV)) {
        return qp_fail(q, ordered ? NUMERICAL_FAILURE : INFEASIBLE);
    }
    const int status =
        API(osqp_solve)(q->P_x, q->A_x, q->g, q->lower, q->upper, q->z, q->mult, q->certificate, &iterations);
    q->iterations = iterations;
    if (status == 1) {
        return OK;
    }
    if (status == 3) {
        qp_scale_certificate(q);
        return INFEASIBLE;
    }
    if (status == 2 || status == 7) {
        return ITERATION_LIMIT;
    }
    return qp_fail(q, NUMERICAL_FAILURE);
}

#include "qp/dense_active_set_shift.c"
