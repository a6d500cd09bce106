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
 * Contents: section, template, operations of one run where they do not depend on data, bytes of its data
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
 *   integrator: explicit_runge_kutta integrators/explicit_runge_kutta.c.jinja              - operations        0 bytes
 *   hessian: gauss_newton           hessians/gauss_newton.c.jinja                         0 operations       40 bytes
 *   condensing: full                condensing/full.c.jinja                             108 operations      328 bytes
 *   qp: dense_active_set            qp/dense_active_set.c.jinja                          81 operations     1472 bytes
 *   algorithm: real_time_iteration  algorithms/real_time_iteration.c.jinja               28 operations      560 bytes
 */
#include "golden.h"

#include <math.h>
#include <string.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math and -ffinite-math-only: they void the checks for NaN"
#endif

#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 12
/* GCC 12 takes addresses that its loop optimiser has split into a null base and an index for accesses to NULL, finds the
 * function without effects and drops calls to it (seen with 12.2 at -O2); this switches the inference off. And where it turns
 * a loop over a local array into memset, with -march=native its stores may want an alignment that it has not given the stack
 * of a leaf function (seen with 12.2, too). Functions that are not declared inline stay apart: inside a larger one the loops
 * of the matrix products stay scalar, which halves the speed. */
#pragma GCC optimize("no-delete-null-pointer-checks", "no-tree-loop-distribute-patterns", "no-inline-functions")
#endif

/* dt_k */
static const golden_real interval_length[2] = { 0.5, 0.5 };
/* longest integration step */
static const golden_real step_length[1] = { 0.5 };
/* initial values of the states */
static const golden_real initial_state[1] = { 1.0 };
/* 0 inside the bounds */
static const golden_real default_control[1] = { 0.0 };
/* p */
static const golden_real default_parameter[1] = { 0.5 };
/* yref */
static const golden_real default_reference[2] = { 0.0, 0.0 };
/* yref_N */
static const golden_real default_terminal_reference[1] = { 0.0 };
/* W */
static const golden_real default_weight[2] = { 1.0, 2.0 };
/* W_N */
static const golden_real default_terminal_weight[1] = { 3.0 };
/* lower bounds of the rows */
static const golden_real default_lower[4] = { -1.0, -2.0, -3.0, -4.0 };
/* upper bounds of the rows */
static const golden_real default_upper[4] = { 1.0, 2.0, 3.0, 4.0 };
/* residual that holds the reference of control j, or -1 */
static const int control_reference[1] = { 1 };
/* row that bounds control j, or -1 */
static const int control_row[1] = { 0 };
/* state that is free component f of x_0 */
static const int free_state[1] = { 0 };
/* node of QP row m */
static const int row_node[5] = { 0, 1, 1, 2, 2 };
/* 0: state bound, 1: general row, 2: coupled row */
static const int row_kind[5] = { 1, 0, 1, 0, 1 };
/* component of x, h or r */
static const int row_index[5] = { 0, 0, 0, 0, 0 };
/* scalar row of the user */
static const int row_id[5] = { 2, 1, 2, 1, 3 };
/* first QP row of node k */
static const int row_first[4] = { 0, 1, 3, 5 };
/* l1 penalty of a row of the user; infinite: hard */
static const golden_real row_l1[4] = { (golden_real)INFINITY, (golden_real)INFINITY, (golden_real)INFINITY, (golden_real)INFINITY };
/* quadratic penalty of its violation */
static const golden_real row_l2[4] = { 0.0, 0.0, 0.0, 0.0 };
/* first element of a parameter in p */
static const int parameter_offset[2] = { 0, 1 };
/* slack variable of QP row m, or -1 */
static const int row_slack[5] = { -1, -1, -1, -1, -1 };
/* 1: the state starts at 0 at every sample */
static const int is_accumulator[1] = { 0 };
/* 1: x_0 is what is measured */
static const int is_measured[1] = { 1 };
/* l1 penalty of hard rows whose QP is infeasible; infinite: they stay hard */
static const golden_real relaxation_weight[1] = { (golden_real)INFINITY };

/* x_next = x + dt (u - p x)
 *   x [1]
 *   u [1]
 *   p [1]
 *   dt [1]
 *   x_next [1]
 *   S [1 x 2]
 * 3 add, 3 mul */
static void integrator_interval(const golden_real *x, const golden_real *u, const golden_real *p, const golden_real *dt, golden_real *x_next, golden_real *S)
{
    const golden_real x_0 = x[0];
    const golden_real u_0 = u[0];
    const golden_real p_0 = p[0];
    const golden_real dt_0 = dt[0];
    const golden_real t4 = p_0 * x_0;
    const golden_real t5 = u_0 - t4;
    const golden_real t6 = dt_0 * t5;
    const golden_real t7 = x_0 + t6;
    const golden_real t9 = dt_0 * p_0;
    const golden_real t10 = 1.0 - t9;
    x_next[0] = t7;
    S[0] = t10;
    S[1] = dt_0;
}

/* x_next = x + dt (u - p x)
 *   x [1]
 *   u [1]
 *   p [1]
 *   h [1]
 *   x_next [1]
 * 2 add, 2 mul */
static void integrator_step(const golden_real *x, const golden_real *u, const golden_real *p, const golden_real *h, golden_real *x_next)
{
    const golden_real x_0 = x[0];
    const golden_real u_0 = u[0];
    const golden_real p_0 = p[0];
    const golden_real h_0 = h[0];
    const golden_real t4 = p_0 * x_0;
    const golden_real t5 = u_0 - t4;
    const golden_real t6 = h_0 * t5;
    const golden_real t7 = x_0 + t6;
    x_next[0] = t7;
}

/* l = 1/2 |y - yref|^2_W
 *   x [1]
 *   u [1]
 *   p [1]
 *   dt [1]
 *   yref [2]
 *   W [2]: diagonal of the weight
 *   l [1]
 * 3 add, 5 mul */
static void path_cost(const golden_real *x, const golden_real *u, const golden_real *p, const golden_real *dt, const golden_real *yref, const golden_real *W, golden_real *l)
{
    const golden_real x_0 = x[0];
    const golden_real yref_0 = yref[0];
    const golden_real W_0 = W[0];
    const golden_real u_0 = u[0];
    const golden_real yref_1 = yref[1];
    const golden_real W_1 = W[1];
    const golden_real t2 = x_0 - yref_0;
    const golden_real t4 = W_0 * t2;
    const golden_real t5 = t4 * t2;
    const golden_real t8 = u_0 - yref_1;
    const golden_real t10 = W_1 * t8;
    const golden_real t11 = t10 * t8;
    const golden_real t12 = t5 + t11;
    const golden_real t14 = 0.5 * t12;
    l[0] = t14;
    (void)p;
    (void)dt;
}

/* g = W (y - yref)
 *   x [1]
 *   u [1]
 *   p [1]
 *   dt [1]
 *   yref [2]
 *   W [2]: diagonal of the weight
 *   g [2]
 * 2 add, 2 mul */
static void path_gradient(const golden_real *x, const golden_real *u, const golden_real *p, const golden_real *dt, const golden_real *yref, const golden_real *W, golden_real *g)
{
    const golden_real x_0 = x[0];
    const golden_real yref_0 = yref[0];
    const golden_real W_0 = W[0];
    const golden_real u_0 = u[0];
    const golden_real yref_1 = yref[1];
    const golden_real W_1 = W[1];
    const golden_real t2 = x_0 - yref_0;
    const golden_real t4 = W_0 * t2;
    const golden_real t7 = u_0 - yref_1;
    const golden_real t9 = W_1 * t7;
    g[0] = t4;
    g[1] = t9;
    (void)p;
    (void)dt;
}

/* Q = W
 *   x [1]
 *   u [1]
 *   p [1]
 *   dt [1]
 *   W [2]: diagonal of the weight
 *   Q [2 x 2]
 * no operations */
static void path_hessian(const golden_real *x, const golden_real *u, const golden_real *p, const golden_real *dt, const golden_real *W, golden_real *Q)
{
    const golden_real W_0 = W[0];
    const golden_real W_1 = W[1];
    Q[0] = W_0;
    Q[3] = W_1;
    (void)x;
    (void)u;
    (void)p;
    (void)dt;
}

/* l = 1/2 |y - yref|^2_W
 *   x [1]
 *   p [1]
 *   yref [1]
 *   W [1]: diagonal of the weight
 *   l [1]
 * 1 add, 3 mul */
static void terminal_cost(const golden_real *x, const golden_real *p, const golden_real *yref, const golden_real *W, golden_real *l)
{
    const golden_real x_0 = x[0];
    const golden_real yref_0 = yref[0];
    const golden_real W_0 = W[0];
    const golden_real t2 = x_0 - yref_0;
    const golden_real t4 = W_0 * t2;
    const golden_real t5 = t4 * t2;
    const golden_real t7 = 0.5 * t5;
    l[0] = t7;
    (void)p;
}

/* g = W (y - yref)
 *   x [1]
 *   p [1]
 *   yref [1]
 *   W [1]: diagonal of the weight
 *   g [1]
 * 1 add, 1 mul */
static void terminal_gradient(const golden_real *x, const golden_real *p, const golden_real *yref, const golden_real *W, golden_real *g)
{
    const golden_real x_0 = x[0];
    const golden_real yref_0 = yref[0];
    const golden_real W_0 = W[0];
    const golden_real t2 = x_0 - yref_0;
    const golden_real t4 = W_0 * t2;
    g[0] = t4;
    (void)p;
}

/* Q = W
 *   x [1]
 *   p [1]
 *   W [1]: diagonal of the weight
 *   Q [1 x 1]
 * no operations */
static void terminal_hessian(const golden_real *x, const golden_real *p, const golden_real *W, golden_real *Q)
{
    const golden_real W_0 = W[0];
    Q[0] = W_0;
    (void)x;
    (void)p;
}

/* h = x u
 *   x [1]
 *   u [1]
 *   p [1]
 *   h [1]
 *   J [1 x 2]
 * 1 mul */
static void path_rows(const golden_real *x, const golden_real *u, const golden_real *p, golden_real *h, golden_real *J)
{
    const golden_real x_0 = x[0];
    const golden_real u_0 = u[0];
    const golden_real t2 = x_0 * u_0;
    h[0] = t2;
    J[0] = u_0;
    J[1] = x_0;
    (void)p;
}

/* h = x^2
 *   x [1]
 *   p [1]
 *   h [1]
 *   J [1 x 1]
 * 1 add, 1 mul */
static void terminal_rows(const golden_real *x, const golden_real *p, golden_real *h, golden_real *J)
{
    const golden_real x_0 = x[0];
    const golden_real t1 = x_0 * x_0;
    const golden_real t2 = x_0 + x_0;
    h[0] = t1;
    J[0] = t2;
    (void)p;
}

/* Rows of the QP besides the control bounds, sorted by node: state bounds (kind 0), general rows h (kind 1) and, at the end,
 * coupled rows r(x_0, x_N) (kind 2). */

static golden_real clip(golden_real value, golden_real lower, golden_real upper)
{
    if (value < lower) {
        return lower;
    }
    return (value > upper) ? upper : value;
}

static int all_finite(const golden_real *v, int n)
{
    int i;
    for (i = 0; i < n; i++) {
        if (!isfinite(v[i])) {
            return 0;
        }
    }
    return 1;
}

/* Bounds of control j at node k; +-infinity where the user stated none. (void): for packages that store one pair for all
 * nodes, or none. */
static golden_real control_lower(const golden_solver_t *s, int k, int j)
{
    (void)s;
    (void)k;
    return (control_row[j] >= 0) ? s->lower[0][control_row[j]] : -(golden_real)INFINITY;
}

static golden_real control_upper(const golden_solver_t *s, int k, int j)
{
    (void)s;
    (void)k;
    return (control_row[j] >= 0) ? s->upper[0][control_row[j]] : (golden_real)INFINITY;
}

static golden_real row_lower(const golden_solver_t *s, int m)
{
    (void)s;
    return s->lower[row_node[m] == GOLDEN_N][row_id[m]];
}

static golden_real row_upper(const golden_solver_t *s, int m)
{
    (void)s;
    return s->upper[row_node[m] == GOLDEN_N][row_id[m]];
}

/* Penalty l1 v + l2/2 v^2 of the violation v of row m: infinite l1 for hard rows, unless the present QP is relaxed. */
static golden_real row_penalty(const golden_solver_t *s, int m)
{
    const golden_real l1 = row_l1[row_id[m]];
    return (l1 < (golden_real)INFINITY) ? l1 : s->relaxation;
}

static golden_real row_curvature(int m)
{
    return row_l2[row_id[m]];
}

/* Where the multiplier of row m lives. */
static golden_real *row_multiplier_place(golden_solver_t *s, int m)
{
    const int k = row_node[m];
    if (row_kind[m] == 0) {
        return &s->mu_x[k][row_index[m]];
    }
    if (row_kind[m] == 2) {
        return &s->eta[row_index[m]];
    }
    return (k == GOLDEN_N) ? &s->mu_N[row_index[m]] : &s->mu[k][row_index[m]];
}

static golden_real row_multiplier(const golden_solver_t *s, int m)
{
    const int k = row_node[m];
    if (row_kind[m] == 0) {
        return s->mu_x[k][row_index[m]];
    }
    if (row_kind[m] == 2) {
        return s->eta[row_index[m]];
    }
    return (k == GOLDEN_N) ? s->mu_N[row_index[m]] : s->mu[k][row_index[m]];
}

/* Value of row m at the iterate; h are the general rows of its node, r the coupled rows. */
static golden_real row_value(const golden_solver_t *s, int m, const golden_real *h, const golden_real *r)
{
    if (row_kind[m] == 0) {
        return s->x[row_node[m]][row_index[m]];
    }
    return (row_kind[m] == 1) ? h[row_index[m]] : r[row_index[m]];
}

/* Value of row m in the linearisation. */
static golden_real row_constant(const golden_solver_t *s, int m)
{
    const int k = row_node[m];
    if (row_kind[m] == 1) {
        return (k == GOLDEN_N) ? s->terminal.h[row_index[m]] : s->node[k].h[row_index[m]];
    }
    return (row_kind[m] == 0) ? s->x[k][row_index[m]] : s->coupled.r[row_index[m]];
}

/* Gradient J = (d row / dx, d row / du) and value of row m in the linearisation; of a coupled row J = d row / dx_N. */
static golden_real row_gradient(const golden_solver_t *s, int m, golden_real *J)
{
    const int k = row_node[m];
    const int r = row_index[m];
    int i;
    for (i = 0; i < GOLDEN_NZ; i++) {
        J[i] = 0.0;
    }
    if (row_kind[m] == 0) {
        J[r] = 1.0;
    } else if (row_kind[m] == 1 && k < GOLDEN_N) {
        for (i = 0; i < GOLDEN_NZ; i++) {
            J[i] = s->node[k].J[r][i];
        }
    } else {
        const golden_real *last = (row_kind[m] == 1) ? s->terminal.J[r] : s->coupled.J_N[r];
        for (i = 0; i < GOLDEN_NX; i++) {
            J[i] = last[i];
        }
    }
    return row_constant(s, m);
}

/* The cost of the present iterate: the nodes' terms, and penalties l1 v + l2/2 v^2 of violated soft rows. */

/* sum_k l_k + l_N */
static golden_real nodal_cost(const golden_solver_t *s)
{
    golden_real total, l;
    int k;
    terminal_cost(s->x[GOLDEN_N], s->p[GOLDEN_N], s->yref_N, s->W_N, &total);
    for (k = 0; k < GOLDEN_N; k++) {
        path_cost(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W[0], &l);
        total += l;
    }
    return total;
}

/* What a violation v >= 0 of row m adds: to the violation of a hard row, to the penalties of a soft one. */
static void add_violation(int m, golden_real v, golden_real *violation, golden_real *penalties)
{
    const golden_real l1 = row_l1[row_id[m]];
    if (l1 < (golden_real)INFINITY) {
        *penalties += l1 * v + 0.5 * row_curvature(m) * v * v;
    } else {
        *violation += v;
    }
}

/* The rows of node k at the present iterate; h are its general rows, r the coupled ones. */
static void add_rows_of_node(const golden_solver_t *s, int k, const golden_real *h, const golden_real *r, golden_real *violation,
    golden_real *penalties)
{
    int m;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        const golden_real value = row_value(s, m, h, r);
        add_violation(m, fabs(value - clip(value, row_lower(s, m), row_upper(s, m))), violation, penalties);
    }
}

/* Penalties of the soft rows, evaluated afresh. */
static golden_real soft_penalties(const golden_solver_t *s)
{
    golden_real h[GOLDEN_NH] = {0}, h_N[GOLDEN_NH_N] = {0}, r[1] = {0};
    golden_real J[GOLDEN_NH * GOLDEN_NZ], J_N[GOLDEN_NH_N * GOLDEN_NX], J_r[1 * GOLDEN_NX];
    golden_real violation = 0.0, penalties = 0.0;
    int k;
    for (k = 0; GOLDEN_SOFT_ROWS > 0 && k < GOLDEN_N; k++) {
        path_rows(s->x[k], s->u[k], s->p[k], h, J);
        add_rows_of_node(s, k, h, r, &violation, &penalties);
    }
    if (GOLDEN_SOFT_ROWS > 0) {
        terminal_rows(s->x[GOLDEN_N], s->p[GOLDEN_N], h_N, J_N);
        coupled_rows(s->x[0], s->x[GOLDEN_N], r, J_r, J_r);
        add_rows_of_node(s, GOLDEN_N, h_N, r, &violation, &penalties);
    }
    return penalties;
}

