/* golden: nonlinear model predictive controller, double precision.
 *
 * x   = (x)
 * u   = (u)
 * p   = (p)
 * y   = (x, u)
 * y_N = (x)
 * h   = (product)
 * h_N = (square_end)
 *
 * Contents: section, template, operations of one run if independent of the data, bytes of its data
 *   integrator_interval             printed kernel                                        6 operations
 *   integrator_step                 printed kernel                                        4 operations
 *   path_cost                       printed kernel                                        8 operations
 *   path_gradient                   printed kernel                                        4 operations
 *   path_hessian                    printed kernel                                        0 operations
 *   terminal_cost                   printed kernel                                        4 operations
 *   terminal_gradient               printed kernel                                        2 operations
 *   terminal_hessian                printed kernel                                        0 operations
 *   path_rows                       printed kernel                                        1 operations
 *   terminal_rows                   printed kernel                                        2 operations
 *   integrator: explicit_runge_kutta integrators/explicit_runge_kutta.c                    - operations        0 bytes
 *   hessian: gauss_newton           hessians/gauss_newton.c                               0 operations       40 bytes
 *   condensing: full                condensing/full.c                                   157 operations      176 bytes
 *   qp: dense_active_set            qp/dense_active_set.c                                70 operations     1480 bytes
 *   algorithm: real_time_iteration  algorithms/real_time_iteration.c                     28 operations      816 bytes
 */
#include "golden.h"

#include <math.h>
#include <string.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math and -ffinite-math-only: they void the checks for NaN"
#endif

#if defined(__OPTIMIZE__) && defined(__GNUC__) && !defined(__clang__) && __GNUC__ == 12
/* GCC 12 mistakes addresses that its loop optimiser has split into a null base and an index for accesses to NULL,
 * concludes that the function has no effects and removes calls to it (observed with 12.2 at -O2);
 * -fno-delete-null-pointer-checks disables this inference. With -march=native on x86, vector stores to a local array
 * may require an alignment that it has not given to the stack of a leaf function (also observed with 12.2): where loops
 * do not become calls of memset this is rarer; -Wa,-muse-unaligned-vector-move excludes it, which no pragma can pass.
 * Functions that are not declared inline are not inlined: inside a larger function the loops of the matrix products
 * remain scalar, which halves the speed. CMakeLists.txt passes the same options; the pragma covers all other builds. */
#pragma GCC optimize("no-delete-null-pointer-checks", "no-tree-loop-distribute-patterns", "no-inline-functions")
#endif

#ifdef NMPC_CODEGEN_UNIT
#error "one generated controller per translation unit: compile the others on their own"
#endif
#define NMPC_CODEGEN_UNIT GOLDEN_MAGIC

/* Short names inside this translation unit. */
typedef golden_real real_t;
typedef golden_node_t node_t;
typedef golden_terminal_t terminal_t;
typedef golden_kkt_t kkt_t;
typedef golden_columns_t columns_t;
typedef golden_basis_t basis_t;
typedef golden_condensed_t condensed_t;
typedef golden_qp_t qp_t;
typedef golden_step_t step_t;
typedef golden_measures_t measures_t;
typedef golden_change_t change_t;
typedef golden_sqp_t sqp_t;
typedef golden_solver_t solver_t;
typedef golden_status_t status_t;
#define N GOLDEN_N
#define NX GOLDEN_NX
#define NU GOLDEN_NU
#define NZ GOLDEN_NZ
#define NP GOLDEN_NP
#define NY GOLDEN_NY
#define NY_N GOLDEN_NY_N
#define NW GOLDEN_NW
#define NW_N GOLDEN_NW_N
#define NH GOLDEN_NH
#define NH_N GOLDEN_NH_N
#define NR GOLDEN_NR
#define NQ GOLDEN_NQ
#define NG GOLDEN_NG
#define NS GOLDEN_NS
#define NUS GOLDEN_NUS
#define NV GOLDEN_NV
#define NSL GOLDEN_NSL
#define LDV GOLDEN_LDV
#define LDH GOLDEN_LDH
#define PARAMS GOLDEN_PARAMS
#define STEPS GOLDEN_STEPS
#define COLUMNS GOLDEN_COLUMNS
#define LDG GOLDEN_LDG
#define QP_MAX_ITERATIONS GOLDEN_QP_MAX_ITERATIONS
#define QP_MAX_PROXIMAL_STEPS GOLDEN_QP_MAX_PROXIMAL_STEPS
#define QP_MAX_SEARCHES GOLDEN_QP_MAX_SEARCHES
#define PATIENCE GOLDEN_PATIENCE
#define MAX_TRIALS GOLDEN_MAX_TRIALS
#define MAX_ATTEMPTS GOLDEN_MAX_ATTEMPTS
#define MAX_WATCHED GOLDEN_MAX_WATCHED
#define FILTER GOLDEN_FILTER
#define MANY GOLDEN_MANY
#define MAGIC NMPC_CODEGEN_UNIT
#define ALL GOLDEN_ALL
#define OK GOLDEN_OK
#define ITERATION_LIMIT GOLDEN_ITERATION_LIMIT
#define INFEASIBLE GOLDEN_INFEASIBLE
#define RELAXED GOLDEN_RELAXED
#define NUMERICAL_FAILURE GOLDEN_NUMERICAL_FAILURE
#define NOT_FINITE GOLDEN_NOT_FINITE
#define NOT_PREPARED GOLDEN_NOT_PREPARED
#define NOT_INITIALIZED GOLDEN_NOT_INITIALIZED
#define BAD_INDEX GOLDEN_BAD_INDEX
#define BAD_BOUNDS GOLDEN_BAD_BOUNDS
#define BAD_ARGUMENT GOLDEN_BAD_ARGUMENT
#define STALLED GOLDEN_STALLED
#define SUBPROBLEM_FAILED GOLDEN_SUBPROBLEM_FAILED
#define SQRT sqrt
#define FABS fabs
#define CEIL ceil
#define INF ((real_t)INFINITY)
#define TOL_QP_PIVOT 7.105427357601002e-15
#define TOL_QP_DEPENDENT 2.2737367544323206e-13
#define TOL_QP_DEPENDENT_PREDICTION 3.637978807091713e-12
#define TOL_QP_FEASIBILITY 8.881784197001252e-16
#define TOL_QP_REDUNDANT 5.684341886080802e-14
#define TOL_QP_SIGN 1.4210854715202004e-14
#define TOL_QP_PROXIMAL 5.684341886080802e-14
#define TOL_QP_PROXIMAL_STAGNATION 9.094947017729282e-13
#define TOL_STEP 7.450580596923828e-09
#define TOL_STEP_GRADIENT 9.5367431640625e-07
#define TOL_QP_RESIDUAL 2.9103830456733704e-11
#define TOL_UNIT 2.220446049250313e-16
#define TOL_MERIT_ROUNDING 1.4210854715202004e-14
#define TOL_STEP_COUNT 9.094947017729282e-13
#define API(name) golden_##name
#define R(x) ((real_t)(x))
#define YREF(s, k) ((s)->yref[k])
#define YREF_N(s) ((s)->yref_N)
#define WEIGHT(s, k) ((s)->W[0])
#define WEIGHT_N(s) ((s)->W_N)
#define PARAM(s, k) ((s)->p[k])
#define PATH_LOWER(s, k, row) ((s)->lower[0])[row]
#define PATH_UPPER(s, k, row) ((s)->upper[0])[row]
#define CONTROL_LOWER(s, k, j) PATH_LOWER(s, k, control_row[j])
#define CONTROL_UPPER(s, k, j) PATH_UPPER(s, k, control_row[j])
#define CONTROL_REFERENCE(s, k, j) YREF(s, k)[control_reference[j]]
#define ROW_MULTIPLIER(s, m) (*((row_kind[m] == ROW_STATE) ? &((s)->mu_x[row_node[m]])[row_index[m]] : \
    &((row_node[m] == N) ? (s)->mu_N : (s)->mu[row_node[m]])[row_index[m]]))
#define ROW_CONSTANT(s, m) (*((row_kind[m] == ROW_STATE) ? &((s)->x[row_node[m]])[row_index[m]] : &((row_node[m] \
    == N) ? (s)->terminal.h : (s)->node[row_node[m]].h)[row_index[m]]))
#define ROW_VALUE(s, m, h, r) (*((row_kind[m] == ROW_STATE) ? &((s)->x[row_node[m]])[row_index[m]] : \
    &(h)[row_index[m]]))
#define ROW_LOWER(s, m) ((s)->lower[row_node[m] == N])[row_id[m]]
#define ROW_UPPER(s, m) ((s)->upper[row_node[m] == N])[row_id[m]]
#define ROW_PENALTY(s, m) (((s)->sqp.elastic && (s)->sqp.row_scale[row_id[m]] > R(0)) ? (s)->relaxation / \
    (s)->sqp.row_scale[row_id[m]] : (s)->relaxation)
#define HESSIAN(s, k) (s)->hessian.Q[0]
#define INTEGRATOR_INTERVAL(s, k, x_next, S) integrator_interval((s)->x[k], (s)->u[k], PARAM(s, k), \
    &interval_length[k], x_next, S)
#define INTEGRATOR_STEP(s, k, x, u, h, x_next) integrator_step(x, u, PARAM(s, k), h, x_next)
#define PATH_COST(s, k, l) path_cost((s)->x[k], (s)->u[k], YREF(s, k), WEIGHT(s, k), l)
#define PATH_GRADIENT(s, k, g) path_gradient((s)->x[k], (s)->u[k], YREF(s, k), WEIGHT(s, k), g)
#define PATH_HESSIAN(s, k, Q) path_hessian(WEIGHT(s, k), Q)
#define TERMINAL_COST(s, l) terminal_cost((s)->x[N], YREF_N(s), WEIGHT_N(s), l)
#define TERMINAL_GRADIENT(s, g) terminal_gradient((s)->x[N], YREF_N(s), WEIGHT_N(s), g)
#define TERMINAL_HESSIAN(s, Q) terminal_hessian(WEIGHT_N(s), Q)
#define PATH_ROWS(s, k, h, J) path_rows((s)->x[k], (s)->u[k], h, J)
#define TERMINAL_ROWS(s, h, J) terminal_rows((s)->x[N], h, J)
#define STATE_STEP(node, dx, du, y) state_step(node, dx, du, y)
#define ADJOINT_STEP(node, Q, dx, du, w) adjoint_step(node, Q, dx, du, w)
#define TERMINAL_ADJOINT(terminal, Q, dx, w) terminal_adjoint(terminal, Q, dx, w)
#define CONDENSE_FORWARD_PANEL(p, node, k) condense_forward_panel(p, node, k)
#define CONDENSE_TERMINAL_PANEL(p, Q) condense_terminal_panel(p, Q)
#define CONDENSE_BACKWARD_PANEL(p, node, Q, k) condense_backward_panel(p, node, Q, k)

/* dt_k */
static const real_t interval_length[2] = { 0.5, 0.5 };
/* longest integration step */
static const real_t step_length[1] = { 0.5 };
/* initial values of the states */
static const real_t initial_state[1] = { 1.0 };
/* 0, clipped to the bounds */
static const real_t default_control[1] = { 0.0 };
/* p */
static const real_t default_parameter[1] = { 0.5 };
/* yref */
static const real_t default_reference[2] = { 0.0, 0.0 };
/* yref_N */
static const real_t default_terminal_reference[1] = { 0.0 };
/* W */
static const real_t default_weight[2] = { 1.0, 2.0 };
/* W_N */
static const real_t default_terminal_weight[1] = { 3.0 };
/* lower bounds of the rows */
static const real_t default_lower[4] = { -1.0, -2.0, -3.0, -4.0 };
/* upper bounds of the rows */
static const real_t default_upper[4] = { 1.0, 2.0, 3.0, 4.0 };
/* residual that holds the reference of control j, or -1 */
static const int control_reference[1] = { 1 };
/* row that bounds control j, or -1 */
static const int control_row[1] = { 0 };
/* node of row m */
static const int row_node[5] = { 0, 1, 1, 2, 2 };
/* 0: state bound, 1: general row, 2: coupled row */
static const int row_kind[5] = { 1, 0, 1, 0, 1 };
/* component of x, h or r */
static const int row_index[5] = { 0, 0, 0, 0, 0 };
/* scalar row of the user */
static const int row_id[5] = { 2, 1, 2, 1, 3 };
/* first row of node k */
static const int row_first[4] = { 0, 1, 3, 5 };
/* first element of a parameter in p */
static const int parameter_offset[2] = { 0, 1 };

