/* Toy package: a hand-written controller of a cart, with the faces of a generated one.
 *
 *     min  sum_{k<N} 1/2 |(p, v, a)_k - yref_k|^2_W + 1/2 |(p, v)_N - yref_N|^2_{W_N}
 *     s.t. p_{k+1} = p_k + dt v_k + dt^2/(2 m_k) a_k + d_k[0],   v_{k+1} = v_k + dt/m_k a_k + d_k[1]
 *
 * solved by a Riccati recursion; the control is clipped to its bounds in the forward sweep, state rows are not enforced.
 * It lets the runtime be tested without a compiler of problems.
 */
#ifndef TOY_H
#define TOY_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* begin declarations */
#define TOY_N 4
#define TOY_NX 2
#define TOY_NU 1
#define TOY_NP 3
#define TOY_NY 3
#define TOY_NY_N 2
#define TOY_NH 0
#define TOY_NH_N 0
#define TOY_NR 3
#define TOY_SIZE_M 1
#define TOY_SIZE_D 2
#define TOY_ALL -1

enum { TOY_ROW_A = 0, TOY_ROW_BOX_0 = 1, TOY_ROW_BOX_1 = 2 };
enum { TOY_PARAM_M = 0, TOY_PARAM_D = 1 };

typedef double toy_real;

typedef enum {
    TOY_OK = 0,
    TOY_ITERATION_LIMIT = 1,
    TOY_INFEASIBLE = 2,
    TOY_RELAXED = 3,
    TOY_NUMERICAL_FAILURE = 4,
    TOY_NOT_FINITE = 5,
    TOY_NOT_PREPARED = 6,
    TOY_NOT_INITIALIZED = 7,
    TOY_BAD_INDEX = 8,
    TOY_BAD_BOUNDS = 9,
    TOY_BAD_ARGUMENT = 10,
    TOY_STALLED = 11
} toy_status_t;

/* Feedback law u_k = K_k x_k + f_k and cost-to-go 1/2 x'P_k x + s_k'x. */
typedef struct {
    toy_real K[TOY_N][TOY_NX];
    toy_real f[TOY_N];
    toy_real P[TOY_N + 1][TOY_NX][TOY_NX];
    toy_real s[TOY_N + 1][TOY_NX];
} toy_riccati_t;

typedef struct {
    int32_t qp_iterations;
    int32_t active_set_changes;
    int32_t dropped_rows;
    int32_t relaxed_rows;
    int32_t sqp_iterations;
    int32_t violated_row;
    int32_t violated_node;
    toy_real violation;
} toy_stats_t;

typedef struct {
    toy_real stationarity;
    toy_real equality;
    toy_real inequality;
    toy_real complementarity;
} toy_kkt_t;

typedef struct {
    int32_t status;
    int64_t samples;
    int32_t phase;
    toy_stats_t stats;
    toy_kkt_t kkt;
    toy_real x[TOY_N + 1][TOY_NX];
    toy_real u[TOY_N][TOY_NU];
    toy_real lam[TOY_N + 1][TOY_NX];
    toy_real mu_x[TOY_N + 1][TOY_NX];
    toy_real mu_u[TOY_N][TOY_NU];
    toy_real mu[TOY_N][1];
    toy_real mu_N[1];
    toy_real p[TOY_N + 1][TOY_NP];
    toy_real yref[TOY_N][TOY_NY];
    toy_real yref_N[TOY_NY_N];
    toy_real W[1][TOY_NY];
    toy_real W_N[TOY_NY_N];
    toy_real lower[2][TOY_NR];
    toy_real upper[2][TOY_NR];
    toy_riccati_t riccati;
} toy_solver_t;

toy_status_t toy_init(toy_solver_t *s);
toy_status_t toy_reset(toy_solver_t *s);
toy_status_t toy_prepare(toy_solver_t *s);
toy_status_t toy_feedback(toy_solver_t *s, const toy_real xhat[TOY_NX], toy_real u0[TOY_NU]);
toy_status_t toy_step(toy_solver_t *s, const toy_real xhat[TOY_NX], toy_real u0[TOY_NU]);
toy_status_t toy_shift(toy_solver_t *s);
toy_status_t toy_solve(toy_solver_t *s, const toy_real xhat[TOY_NX], toy_real tol, int max_iterations);
void toy_integrate(const toy_solver_t *s, const toy_real x[TOY_NX], const toy_real u[TOY_NU], toy_real dt, toy_real x_next[TOY_NX]);
toy_status_t toy_set_reference(toy_solver_t *s, int k, const toy_real yref[TOY_NY]);
toy_status_t toy_set_terminal_reference(toy_solver_t *s, const toy_real yref[TOY_NY_N]);
toy_status_t toy_set_weight(toy_solver_t *s, int k, const toy_real W[TOY_NY]);
toy_status_t toy_set_terminal_weight(toy_solver_t *s, const toy_real W[TOY_NY_N]);
toy_status_t toy_set_parameter(toy_solver_t *s, int param, int k, const toy_real *values);
toy_status_t toy_set_bounds(toy_solver_t *s, int row, int k, toy_real lower, toy_real upper);
toy_real toy_cost(const toy_solver_t *s);
void toy_kkt(const toy_solver_t *s, toy_kkt_t *out);
const char *toy_status_string(toy_status_t status);
/* end declarations */

#ifdef __cplusplus
}
#endif

#endif
