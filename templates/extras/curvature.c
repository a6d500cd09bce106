/* The curvature of hard rows that are active, and of the dynamics that lead to them. Gauss-Newton steps lack it: where
 * a plan follows such a row, it jumps from bound to bound, and leaves the row by what the linearisation does not see.
 * While that is more than little, the positive part of what the exact Hessian has beyond it is added. */

#include "hessians/jacobi.c"

/* A = Q + (A - Q)_+, symmetric, for the exact block A of n rows and that of the samples, Q, lower triangles whose rows
 * have lda and ldq entries; (.)_+ keeps the positive eigenvalues. */
static void blend_block(curved_t *c, real_t *A, int lda, const real_t *Q, int ldq, int n)
{
    real_t largest = R(0), value[NZ];
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            c->A[i * n + j][0] = A[i * lda + j] - Q[i * ldq + j];
            enlarge(&largest, c->A[i * n + j][0]);
        }
    }
    for (int i = 0; i < n; i++) { /* to entries of at most 1, which jacobi() takes */
        for (int j = 0; j <= i; j++) {
            c->A[i * n + j][0] = (largest <= R(0)) ? R(0) : c->A[i * n + j][0] / largest;
        }
    }
    jacobi(c->A, c->V, n);
    for (int i = 0; i < n; i++) {
        const real_t lambda = c->A[i * n + i][0];
        value[i] = (lambda > R(0)) ? largest * lambda : R(0);
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            real_t sum = Q[i * ldq + j];
            for (int l = 0; l < n; l++) {
                sum += value[l] * c->V[l * n + i][0] * c->V[l * n + j][0];
            }
            A[i * lda + j] = A[j * lda + i] = sum;
        }
    }
}

/* Linearises the present point with the exact Hessian, and blends it with that of the samples, which becomes zero. */
static void evaluate_bent(solver_t *s)
{
    curved_t *c = &s->curved;
    linearize_with_curvature(s);
    hessian(s);
    for (int k = 0; k < N; k++) {
        blend_block(c, c->Q[k][0], NZ, HESSIAN(s, k)[0], NZ, NZ);
    }
    if (TERMINAL_BLOCK || HAS_TERMINAL_EXACT) {
        blend_block(c, c->Q_N[0], NX, s->hessian.Q_N[0], NX, NX);
    }
    memset(s->hessian.Q, 0, sizeof s->hessian.Q);
    memset(s->hessian.Q_N, 0, sizeof s->hessian.Q_N);
    c->in_solve = 1;
    s->renewal = UP_TO_DATE;
}

/* Returns 1 if a hard row that is no bound of a control has a multiplier. */
static int row_is_active(const solver_t *s)
{
    for (int m = 0; m < NG; m++) {
        if (!row_is_soft(s, m) && FABS(s->mult[m]) > R(0)) {
            return 1;
        }
    }
    return 0;
}

static void curvature_on_reset(solver_t *s)
{
    s->bent = 0;
}

static void curvature_before_solve(solver_t *s)
{
    s->bent = 0;
}

/* A plan that leaves all rows needs no curvature any more; multipliers of relaxed rows are those of their penalty. */
static void curvature_before_prepare(solver_t *s)
{
    s->bent = s->bent && s->failing <= NO_FAILURE && s->stats.violated_row < 0 && row_is_active(s);
    s->curved.in_solve = 0;
}

/* The linearisation tells what the last step has left of the rows. */
static status_t curvature_after_prepare(solver_t *s, status_t status)
{
    if (status == OK && !s->bent && s->failing <= NO_FAILURE && s->stats.violated_row < 0 &&
        rows_left(s) > FACTOR_CURVATURE_ROW_CHANGE * residual_tolerance[0] && row_is_active(s)) {
        s->bent = 1;
        status = prepare_here(s);
    }
    return status;
}
