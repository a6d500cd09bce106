/* golden: nonlinear model predictive controller, double precision.
 * The generator's MIT licence does not extend to this file: it is yours.
 *
 * x   = (x)
 * u   = (u)
 * p   = (p)
 * y   = (x, u)
 * y_N = (x)
 * h   = (product)
 * h_N = (square_end)
 *
 * The caller owns the memory: one golden_solver_t is 3192 bytes in size, holds no pointers and may be
 * copied with '='. Only one execution context at a time may use an instance. An interrupt may change measurements
 * during a call: pass a copy of them. Members of size 0 do not exist. */
#ifndef GOLDEN_H
#define GOLDEN_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* begin declarations */
typedef double golden_real;

#define GOLDEN_N 2 /* intervals */
#define GOLDEN_NX 1 /* states */
#define GOLDEN_NU 1 /* controls */
#define GOLDEN_NZ 2 /* NX + NU */
#define GOLDEN_NP 1 /* parameters */
#define GOLDEN_NY 2 /* path residuals */
#define GOLDEN_NY_N 1 /* terminal residuals */
#define GOLDEN_NW 2 /* entries of the path weight */
#define GOLDEN_NW_N 1 /* entries of the terminal weight */
#define GOLDEN_NH 1 /* general path rows */
#define GOLDEN_NH_N 1 /* general terminal rows */
#define GOLDEN_NR 4 /* scalar rows with bounds */
#define GOLDEN_NQ 1 /* path Hessian blocks */
#define GOLDEN_NF 0 /* free components of x_0 */
#define GOLDEN_NE 0 /* coupled rows */
#define GOLDEN_NG 5 /* scalar rows of all nodes besides control bounds */
#define GOLDEN_NS 1 /* stages of the QP */
#define GOLDEN_NUS 2 /* controls of a stage of the QP */
#define GOLDEN_NXS 1 /* states of a stage: NX and copies of components of x_0 */
#define GOLDEN_NZS 3 /* NXS + NUS */
#define GOLDEN_NV 2 /* variables of the QP */
#define GOLDEN_NSL 0 /* slack variables of the QP */
#define GOLDEN_LDV 4 /* NV rounded up to PANEL */
#define GOLDEN_LDH 4 /* NV - NSL rounded up to PANEL */
#define GOLDEN_PANEL 4 /* columns processed together */
#define GOLDEN_SOFT_ROWS 0 /* rows with a penalty */
#define GOLDEN_PARAMS 1 /* parameters by name */
#define GOLDEN_SIZE_P 1 /* elements of p */
#define GOLDEN_STEPS 1 /* Runge-Kutta steps per interval */
#define GOLDEN_COLUMNS 8 /* columns of G_k that are processed together */
#define GOLDEN_LDG 8 /* columns of G_k: NX + N NU, rounded up to COLUMNS */
#define GOLDEN_QP_MAX_ITERATIONS 120 /* cap on the active-set iterations of one feedback phase */
#define GOLDEN_QP_MAX_PROXIMAL_STEPS 200 /* cap on the proximal steps for a semidefinite Hessian */
#define GOLDEN_QP_MAX_SEARCHES 520 /* cap on the searches for violated rows */
#define GOLDEN_PATIENCE 10 /* samples after which a failure is not that of one sample alone */
#define GOLDEN_SHIFT 0 /* 1: step() moves the plan before preparing */
#define GOLDEN_MAX_TRIALS 30 /* halvings of the step in the line search of solve() */
#define GOLDEN_MAX_ATTEMPTS 2 /* new starts of solve() where rows cannot be satisfied, at most */
#define GOLDEN_MAX_WATCHED 4 /* accelerated steps of solve() without the line search, at most */
#define GOLDEN_FILTER 16 /* pairs of violation and cost that solve() does not accept again */
#define GOLDEN_MANY 1000000 /* maximum value of counters */
#define GOLDEN_MAGIC 1313689667 /* marks a struct that init has initialised */

enum { GOLDEN_ALL = -1 }; /* all nodes, as argument k of the setters */

enum { /* scalar rows, for set_bounds */
    GOLDEN_ROW_U = 0,
    GOLDEN_ROW_X = 1,
    GOLDEN_ROW_PRODUCT = 2,
    GOLDEN_ROW_SQUARE_END = 3
};

enum { /* parameters, for set_parameter */
    GOLDEN_PARAM_P = 0
};

typedef enum {
    GOLDEN_OK = 0, /* ok */
    GOLDEN_ITERATION_LIMIT = 1, /* iteration limit reached */
    GOLDEN_INFEASIBLE = 2, /* the constraints cannot be met */
    GOLDEN_RELAXED = 3, /* soft solution: rows were relaxed */
    GOLDEN_NUMERICAL_FAILURE = 4, /* numerical failure: a factorisation broke down or a number is not finite */
    GOLDEN_NOT_FINITE = 5, /* the measured state is not finite */
    GOLDEN_NOT_PREPARED = 6, /* feedback without prepare */
    GOLDEN_NOT_INITIALIZED = 7, /* init was not called */
    GOLDEN_BAD_INDEX = 8, /* no such node, row or parameter */
    GOLDEN_BAD_BOUNDS = 9, /* lower bound above upper bound */
    GOLDEN_BAD_ARGUMENT = 10, /* argument out of range or not finite */
    GOLDEN_STALLED = 11, /* no further progress */
    GOLDEN_SUBPROBLEM_FAILED = 12 /* a subproblem was given up */
} golden_status_t;













typedef union { /* memory of phases that do not overlap */
    golden_columns_t columns; /* while the QP is formed */
    golden_basis_t basis; /* from qp_factorize to the end of the feedback */
} golden_work_t;

















/* init: initialise all members to their declared values. reset: keep the settings and restore the initial iterate. */
golden_status_t golden_init(golden_solver_t *s);
golden_status_t golden_reset(golden_solver_t *s);

/* Preparation phase: linearise, condense, factorise. A call that fails leaves the plan unchanged; feedback restarts a
 * plan that fails repeatedly. */
golden_status_t golden_prepare(golden_solver_t *s);

/* Feedback phase: compute u0 for the measured xhat; u0 is finite and inside its bounds on every return. */
golden_status_t golden_feedback(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU]);

/* Call prepare and feedback. */
golden_status_t golden_step(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real u0[GOLDEN_NU]);

/* Move the plan by one interval. */
golden_status_t golden_shift(golden_solver_t *s);

/* Iterate from the present plan, with globalisation, until the KKT residual is at most tol or max_iterations is
 * reached; kkt and stats describe the outcome. */
golden_status_t golden_solve(golden_solver_t *s, const golden_real xhat[GOLDEN_NX], golden_real tol, int max_iterations);

/* Data that can be changed. k is GOLDEN_ALL or one node:
 *   reference  0 .. N - 1
 *   weight     no node
 *   parameter  0 .. N
 *   bounds     N, if the row holds there
 * A call that is refused (BAD_INDEX, BAD_ARGUMENT, BAD_BOUNDS) changes nothing. References and bounds take effect in
 * the next feedback, parameters and weights in the next prepare. */
golden_status_t golden_set_reference(golden_solver_t *s, int k, const golden_real yref[GOLDEN_NY]);
golden_status_t golden_set_terminal_reference(golden_solver_t *s, const golden_real yref[GOLDEN_NY_N]);
golden_status_t golden_set_weight(golden_solver_t *s, int k, const golden_real W[GOLDEN_NW]);
golden_status_t golden_set_terminal_weight(golden_solver_t *s, const golden_real W[GOLDEN_NW_N]);
golden_status_t golden_set_parameter(golden_solver_t *s, int param, int k, const golden_real *values);
golden_status_t golden_set_bounds(golden_solver_t *s, int row, int k, golden_real lower, golden_real upper);

/* integrate: plant model over the time dt; cost: cost of the present plan; kkt: its KKT residuals. */
void golden_integrate(const golden_solver_t *s, const golden_real x[GOLDEN_NX], const golden_real u[GOLDEN_NU],
    golden_real dt, golden_real x_next[GOLDEN_NX]);
golden_real golden_cost(const golden_solver_t *s);
void golden_kkt(const golden_solver_t *s, golden_kkt_t *out);
const char *golden_status_string(golden_status_t status);
/* end declarations */

#ifdef __cplusplus
}
#endif

#endif
