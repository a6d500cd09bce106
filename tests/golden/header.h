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
 * The caller owns the memory: one golden_solver_t is 3224 bytes in size, holds no pointers and may be
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
#define GOLDEN_NQ 2 /* path Hessian blocks */
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
#define GOLDEN_STEPS 2 /* Runge-Kutta steps per interval */
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

typedef struct { /* linearisation of a path node */
    golden_real S[GOLDEN_NX][GOLDEN_NZ]; /* [A_k B_k] = d Phi / d(x, u) */
    golden_real g[GOLDEN_NZ]; /* gradient (q_k, r_k) */
    golden_real J[GOLDEN_NH][GOLDEN_NZ]; /* their Jacobian [C_k D_k] */
    golden_real b[GOLDEN_NX]; /* gap Phi(x_k, u_k) - x_{k+1} */
    golden_real h[GOLDEN_NH]; /* general rows */
} golden_node_t;

typedef struct { /* linearisation of the terminal node */
    golden_real g[GOLDEN_NX]; /* gradient q_N */
    golden_real h[GOLDEN_NH_N]; /* general rows */
    golden_real J[GOLDEN_NH_N][GOLDEN_NX]; /* their Jacobian C_N */
} golden_terminal_t;

typedef struct { /* KKT residuals, largest absolute values */
    golden_real stationarity; /* gradient of the Lagrangian */
    golden_real equality; /* gaps of the dynamics and x_0 - xhat */
    golden_real inequality; /* violation of bounds and rows */
    golden_real complementarity; /* multiplier times distance to its bound */
    golden_real relative; /* the largest of all, divided by 1 + the magnitudes of the terms that it sums */
} golden_kkt_t;

typedef struct { /* Hessian blocks, lower triangles, z = (x, u) */
    golden_real Q[GOLDEN_NQ][GOLDEN_NZ][GOLDEN_NZ]; /* path blocks; one for all nodes if it is constant */
    golden_real Q_N[GOLDEN_NX][GOLDEN_NX]; /* terminal block */
} golden_hessian_t;

typedef struct { /* a panel of columns of dx_k = G_k (dx_0, du) + c_k, while the QP is formed */
    golden_real G[GOLDEN_N + 1][GOLDEN_NX][GOLDEN_COLUMNS]; /* columns of G_0 .. G_N */
    golden_real W[GOLDEN_NX][GOLDEN_COLUMNS]; /* W_k of the backward sweep */
    golden_real T[GOLDEN_NU][GOLDEN_COLUMNS]; /* one block row of the condensed Hessian */
} golden_columns_t;

typedef struct { /* factors of the working set, vectors of an iteration */
    golden_real Q[GOLDEN_LDV][GOLDEN_LDV]; /* rows: orthonormal basis of the normals in the working set */
    golden_real R[GOLDEN_LDV][GOLDEN_LDV]; /* row j: coefficients of normal j in that basis (R transposed) */
    golden_real y[GOLDEN_LDV]; /* minimiser on the working set */
    golden_real m[GOLDEN_LDV]; /* normal of the row under consideration, in y */
    golden_real v[GOLDEN_LDV]; /* its part outside the span of the working set */
    golden_real d[GOLDEN_LDV]; /* its coefficients in the basis */
} golden_basis_t;

typedef union { /* memory of phases that do not overlap */
    golden_columns_t columns; /* while the QP is formed */
    golden_basis_t basis; /* from qp_factorize to the end of the feedback */
} golden_work_t;

typedef struct { /* the condensed QP's dependence on dx_0 */
    golden_real Ax[GOLDEN_NG][GOLDEN_NX]; /* coupling of the rows to dx_0 */
    golden_real g[GOLDEN_NV]; /* condensed gradient at dx_0 = 0 */
    golden_real Hx[GOLDEN_NV][GOLDEN_NX]; /* coupling of the controls to dx_0 */
    golden_real c[GOLDEN_N + 1][GOLDEN_NX]; /* free response of the gaps b_k */
    golden_real v[GOLDEN_NG]; /* values of the rows at du = 0, dx_0 = 0 */
    golden_real terms[GOLDEN_NG]; /* magnitude of the terms of v */
} golden_condensed_t;

typedef struct { /* condensed QP and its active-set factorisation */
    golden_real H[GOLDEN_LDH][GOLDEN_LDV]; /* Hessian (lower triangle); later D, L and L' of L D L' */
    golden_work_t work; /* factors of the working set; until qp_factorize the caller's */
    golden_real A[GOLDEN_NG][GOLDEN_LDH]; /* general rows */
    golden_real inverse[GOLDEN_LDV]; /* D^{-1/2} */
    golden_real R_inverse[GOLDEN_LDV]; /* inverse diagonal of R */
    golden_real lam[GOLDEN_LDV]; /* multipliers of the rows in the working set */
    golden_real y0[GOLDEN_LDV]; /* unconstrained minimiser, y = D^{1/2} L'z */
    golden_real x[GOLDEN_LDV]; /* z that belongs to y */
    golden_real proximal[GOLDEN_LDV]; /* diagonal E added to a semidefinite Hessian */
    golden_real center[GOLDEN_LDV]; /* centre of the proximal term */
    golden_real direction[GOLDEN_LDV]; /* direction of the last proximal step */
    golden_real g[GOLDEN_NV]; /* gradient */
    golden_real z[GOLDEN_NV]; /* minimiser */
    int32_t row[GOLDEN_LDV]; /* rows in the working set, in the order of the basis */
    golden_real lower[GOLDEN_NV + GOLDEN_NG]; /* lower bounds of variables, then of general rows */
    golden_real upper[GOLDEN_NV + GOLDEN_NG]; /* upper bounds */
    golden_real terms[GOLDEN_NG]; /* magnitude of the terms that the bounds of a general row sum up */
    golden_real mult[GOLDEN_NV + GOLDEN_NG]; /* multipliers, > 0 at the upper bound, < 0 at the lower */
    golden_real slack[GOLDEN_NV + GOLDEN_NG]; /* violation of a row that is accepted as rounding */
    golden_real scale; /* |y0|, and the terms that saturated rows add to it */
    golden_real penalty[GOLDEN_NV + GOLDEN_NG]; /* l1 penalty of violating a row; infinite: hard */
    golden_real certificate[GOLDEN_NV + GOLDEN_NG]; /* if INFEASIBLE: weights of a contradiction */
    golden_real total; /* its s'(H + E)s; 0: no conjugate direction follows */
    golden_real step; /* length of the proximal step */
    int32_t side[GOLDEN_NV + GOLDEN_NG]; /* +-1: in the set at upper, lower bound; +-2: saturated; or 0 */
    int32_t snapshot[GOLDEN_NV + GOLDEN_NG]; /* earlier values of side, to detect cycles */
    int32_t nw; /* number of rows in the working set */
    int32_t factorized; /* 1: qp_factorize has succeeded */
    int32_t strict; /* 1: rounding errors are judged by the terms of a row */
    int32_t semidefinite; /* 1: a pivot of H may be zero, E is not zero */
    int32_t face; /* value of changes when the direction was set */
    int32_t elastic; /* 1: a row has a finite penalty */
    int32_t iterations; /* active-set iterations of the last qp_solve */
    int32_t searches; /* searches for violated rows in that call */
    int32_t changes; /* rows that entered or left the working set in that call */
    int32_t dropped; /* equalities left out as redundant */
    int32_t relaxed; /* elastic rows that are violated */
} golden_qp_t;

typedef struct { /* counters of the last feedback or solve */
    golden_real violation; /* violation of this row by the last step of the QP */
    int32_t qp_iterations; /* iterations of the last QP */
    int32_t active_set_changes; /* changes of the working set in the last QP */
    int32_t dropped_rows; /* redundant rows left out of the working set */
    int32_t relaxed_rows; /* soft or relaxed rows that are violated */
    int32_t sqp_iterations; /* iterations of the last solve */
    int32_t violated_row; /* hard row that is infeasible (INFEASIBLE) or relaxed (RELAXED), or -1 */
    int32_t violated_node; /* its node, or -1 */
} golden_stats_t;

typedef struct { /* solution of the QP */
    golden_real mult[GOLDEN_NG]; /* multipliers of the rows */
    golden_real du[GOLDEN_N][GOLDEN_NU]; /* step of the controls */
    golden_real mult_u[GOLDEN_N][GOLDEN_NU]; /* multipliers of the control bounds */
    golden_real dx[GOLDEN_N + 1][GOLDEN_NX]; /* step of the states */
} golden_step_t;

typedef struct { /* measures of a point */
    golden_real violation; /* of gaps, initial condition and rows, in their scales */
    golden_real cost; /* with the penalties of the soft rows */
} golden_measures_t;

typedef struct { /* a component z of the last two steps d of solve() */
    golden_real last_d; /* d of the last */
    golden_real last_end; /* z + d of the last */
    golden_real d; /* d, less that before */
    golden_real end; /* z + d, less that before */
} golden_change_t;

typedef struct { /* line search of solve() */
    golden_change_t change[GOLDEN_N + 1][GOLDEN_NZ]; /* of the step and its end */
    golden_measures_t filter[GOLDEN_FILTER]; /* pairs that the filter rejects */
    golden_step_t step; /* step that is tried, at its full length */
    golden_real row_scale[GOLDEN_NR]; /* scales of the rows */
    golden_real u[GOLDEN_N][GOLDEN_NU]; /* controls before the step */
    golden_real gamma[2]; /* shares of the changes that are removed */
    golden_measures_t base; /* measures before the step */
    golden_real x[GOLDEN_N + 1][GOLDEN_NX]; /* states before the step */
    int32_t comparable; /* 1: the last step had its full length */
    int32_t trend; /* of the length of steps in one direction */
    golden_real square; /* square of the norm of the step */
    int32_t watched; /* steps taken that the filter rejected */
    golden_real milestone; /* square at the first of them */
    golden_real state_scale[GOLDEN_NX]; /* scales of the states */
    golden_real row_weight; /* penalty of the rows in the elastic QP */
    int32_t entries; /* entries of the filter */
    int32_t restoring; /* 1: steps only have to reduce the violation */
    golden_real length; /* length of the last step */
    golden_real slope; /* of the cost along the step */
    golden_real gain; /* reduction of the violation that the step promises */
    golden_real cost_unit; /* how much the cost may change */
    golden_real cost_scale; /* largest slope of the cost */
    golden_real most_violation; /* violation that is never accepted */
    int32_t prepared; /* status of the preparation */
    int32_t attempts; /* new starts */
    int32_t resumes; /* set to 1 before solve() goes on from where it reached its limit */
    int32_t slow; /* 1: an elastic QP that hardly reduced the violation */
    int32_t elastic; /* 1: the last QP was infeasible and relaxed */
} golden_sqp_t;

typedef struct { /* the whole controller: no pointers, copy it with '=' */
    /* work */
    golden_node_t node[GOLDEN_N]; /* linearisation of a path node */
    golden_qp_t qp; /* condensed QP and its active-set factorisation */
    golden_step_t step; /* solution of the QP */
    golden_condensed_t condensed; /* the condensed QP's dependence on dx_0 */
    int32_t renewal; /* 1: references are newer than the gradients, 2: so are weights or parameters */
    golden_real xhat[GOLDEN_NX]; /* state measured at the last feedback */
    int32_t prepared; /* 1 between prepare and feedback */
    int32_t failing; /* failures in a row, at most 3; < 0: successes lacking since a restart */
    golden_real relaxation; /* l1 penalty of hard rows while a QP is relaxed, else infinite */
    golden_terminal_t terminal; /* linearisation of the terminal node */
    golden_hessian_t hessian; /* Hessian blocks, lower triangles, z = (x, u) */
    golden_sqp_t sqp; /* line search of solve() */
    int32_t magic; /* set by init */
    /* plan */
    golden_real u[GOLDEN_N][GOLDEN_NU]; /* controls of the plan */
    golden_real mu_u[GOLDEN_N][GOLDEN_NU]; /* multipliers of the control bounds */
    golden_real mu[GOLDEN_N][GOLDEN_NH]; /* multipliers of the general path rows */
    golden_real x[GOLDEN_N + 1][GOLDEN_NX]; /* states of the plan */
    golden_real lam[GOLDEN_N + 1][GOLDEN_NX]; /* multipliers of the dynamics; lam_0 belongs to x_0 = xhat */
    golden_real mu_x[GOLDEN_N + 1][GOLDEN_NX]; /* multipliers of the state bounds, > 0 at the upper one */
    golden_real mu_N[GOLDEN_NH_N]; /* multipliers of the general terminal rows */
    /* settings */
    golden_real lower[2][GOLDEN_NR]; /* lower bounds of the rows: path, terminal */
    golden_real upper[2][GOLDEN_NR]; /* upper bounds of the rows: path, terminal */
    golden_real yref[GOLDEN_N][GOLDEN_NY]; /* references of the path residual */
    golden_real W[1][GOLDEN_NY]; /* weight of the path residual */
    golden_real p[GOLDEN_N + 1][GOLDEN_NP]; /* parameters */
    golden_real yref_N[GOLDEN_NY_N]; /* reference of the terminal residual */
    golden_real W_N[GOLDEN_NY_N]; /* weight of the terminal residual */
    /* results of the last call */
    golden_stats_t stats; /* counters */
    golden_kkt_t kkt; /* KKT residuals of the last solve */
    int32_t status; /* status of the last call */
} golden_solver_t;

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
