/* ==== condensing: none ==================================================================================== */

/* Seam "condensing", contract: see the functions condense_init, _prepare, _gradient, _rows, _solve, _shift:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: everything that needs neither xhat nor the final bounds, the QP's factorisation included
 *   condense_gradient  gradients of the nodes have changed, nothing else
 *   condense_rows      gaps b and values of the rows have changed, no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_shift     the predicted working set moves by one interval (its own template: for plans that do)
 * Here: nothing is eliminated, the QP has the stages of the problem.
 * What a QP solver on stages reads: stage_S = [A B], stage_b, stage_g, stage_Q, stage_Q_N (lower triangles), stage_row (gradient
 * of a general row), tables stage_first, stage_of_row, stage_state. */

static void qp_init(golden_solver_t *s);
static golden_status_t qp_factorize(golden_solver_t *s);
static void qp_gradient(golden_solver_t *s);
static golden_status_t qp_solve(golden_solver_t *s);

static inline golden_real (*stage_S(golden_solver_t *s, int k))[GOLDEN_NZS]
{
    return s->node[k].S;
}

static inline golden_real *stage_b(golden_solver_t *s, int k)
{
    return s->node[k].b;
}

static inline golden_real *stage_g(golden_solver_t *s, int k)
{
    return (k < GOLDEN_NS) ? s->node[k].g : s->terminal.g;
}

static inline golden_real (*stage_Q(golden_solver_t *s, int k))[GOLDEN_NZS]
{
    return s->hessian.Q[GOLDEN_NQ == 1 ? 0 : k];
}

/* The Hessian of the last stage, lower triangle. */
static inline golden_real (*stage_Q_N(golden_solver_t *s))[GOLDEN_NXS]
{
    return s->hessian.Q_N;
}

/* Gradient of the general or coupled row m in the variables of its stage. */
static inline const golden_real *stage_row(const golden_solver_t *s, int m)
{
    const int k = row_node[m], r = row_index[m];
    if (row_kind[m] == 2) {
        return s->coupled.J_N[r];
    }
    return (k < GOLDEN_N) ? s->node[k].J[r] : s->terminal.J[r];
}

static void condense_init(golden_solver_t *s)
{
    qp_init(s);
}

/* Constant part of row m in the variables of its stage. */
static inline golden_real stage_row_value(const golden_solver_t *s, int m)
{
    return row_constant(s, m);
}

/* Bounds of the controls and rows relative to the present iterate, penalties; of J_0 dx_0 of a coupled row what is known. */
static void condense_embed(golden_solver_t *s)
{
    int k, j, m;
    for (k = 0; k < GOLDEN_N; k++) {
        for (j = 0; j < GOLDEN_NU; j++) {
            s->qp.lower[k * GOLDEN_NU + j] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[k * GOLDEN_NU + j] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    for (m = 0; m < GOLDEN_NG; m++) {
        golden_real value = stage_row_value(s, m);
        for (j = 0; row_kind[m] == 2 && j < GOLDEN_NX; j++) {
            value += is_free[j] ? 0.0 : s->coupled.J_0[row_index[m]][j] * s->step.dx[0][j];
        }
        s->qp.lower[GOLDEN_NV + m] = row_lower(s, m) - value;
        s->qp.upper[GOLDEN_NV + m] = row_upper(s, m) - value;
        s->qp.penalty[m] = row_penalty(s, m);
        s->qp.curvature[m] = row_curvature(m);
    }
}

static golden_status_t condense_prepare(golden_solver_t *s)
{
    memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return qp_factorize(s);
}

static void condense_gradient(golden_solver_t *s)
{
    qp_gradient(s);
}

static void condense_rows(golden_solver_t *s)
{
    qp_gradient(s);
}

static void condense_expand(golden_solver_t *s)
{
    memcpy(s->step.dx, s->qp.x, sizeof s->step.dx);
    memcpy(s->step.du, s->qp.z, sizeof s->step.du);
    memcpy(s->step.mult_u, s->qp.mult, sizeof s->step.mult_u);
    memcpy(s->step.mult, s->qp.mult + GOLDEN_NV, sizeof s->step.mult[0] * GOLDEN_NG);
}

static golden_status_t condense_solve(golden_solver_t *s)
{
    golden_status_t status;
    condense_embed(s);
    status = qp_solve(s);
    condense_expand(s);
    return status;
}
