/* Component "condensing". Contract:
 *   condense_init      once: constant parts
 *   condense_prepare   preparation: all computations that depend neither on xhat nor on the final bounds, including the
 *                      factorisation of the QP
 *   condense_gradient  called if only gradients of the nodes have changed
 *   condense_rows      called if gaps b and values of the rows have changed, but no matrix
 *   condense_solve     feedback: solves the QP for step.dx[0] and the present bounds; result in step
 *   condense_multiplier  multiplier of x_k after condense_solve has succeeded
 *   condense_shift     shifts the predicted working set of the controls by one interval
 *   condense_shift_rows  row m takes the predicted side of row source[m]
 * Here: nothing is eliminated; the stages of the QP are those of the problem. Data that a QP solver on stages reads:
 * stage_S = [A B], stage_b, stage_g, stage_Q, stage_Q_N (lower triangles), and the rows. */

static void qp_init(solver_t *s);
static status_t qp_factorize(solver_t *s);
static void qp_gradient(solver_t *s);
static status_t qp_solve(solver_t *s);
static real_t qp_multiplier(const solver_t *s, int m);

static inline real_t (*stage_S(solver_t *s, int k))[NZ]
{
    return s->node[k].S;
}

static inline real_t *stage_b(solver_t *s, int k)
{
    return s->node[k].b;
}

static inline real_t *stage_g(solver_t *s, int k)
{
    return (k < N) ? s->node[k].g : s->terminal.g;
}

static inline real_t (*stage_Q(solver_t *s, int k))[NZ]
{
    if (CURVED) {
        if (s->curved.in_solve) {
            return s->curved.Q[k];
        }
    }
    if (NQ == 1) {
        return s->hessian.Q[0];
    }
    return s->hessian.Q[k];
}

/* Returns the Hessian of the last stage, lower triangle. */
static inline real_t (*stage_Q_N(solver_t *s))[NX]
{
    if (CURVED) {
        if (s->curved.in_solve) {
            return s->curved.Q_N;
        }
    }
    return s->hessian.Q_N;
}

static void condense_init(solver_t *s)
{
    qp_init(s);
}

/* Sets the bounds of the rows relative to the present iterate, and the costs of their violation. */
static void condense_embed_rows(solver_t *s)
{
    for (int m = 0; m < NG; ++m) {
        real_t value = row_constant(s, m);
        if (row_is_coupled(m)) {
            for (int i = 0; i < NX; ++i) {
                value += s->coupled.J_0[row_index(m)][i] * s->step.dx[0][i];
            }
        }
        s->qp.lower[NV + m] = row_lower(s, m) - value;
        s->qp.upper[NV + m] = row_upper(s, m) - value;
        s->qp.penalty[m] = row_penalty(s, m);
        s->qp.curvature[m] = row_l2(s, m);
    }
}

/* Sets the bounds of the controls and rows relative to the present iterate. */
static void condense_embed(solver_t *s)
{
    for (int k = 0; k < N; ++k) {
        for (int j = 0; j < NU; ++j) {
            s->qp.lower[k * NU + j] = control_lower(s, k, j) - s->u[k][j];
            s->qp.upper[k * NU + j] = control_upper(s, k, j) - s->u[k][j];
        }
    }
    condense_embed_rows(s);
}

static status_t condense_prepare(solver_t *s)
{
    (void)memset(s->step.dx[0], 0, sizeof s->step.dx[0]);
    condense_embed(s);
    return qp_factorize(s);
}

static void condense_gradient(solver_t *s)
{
    qp_gradient(s);
}

static void condense_rows(solver_t *s)
{
    qp_gradient(s);
}

static void condense_expand(solver_t *s)
{
    (void)memcpy(s->step.dx, s->qp.x, sizeof s->step.dx);
    (void)memcpy(s->step.du, s->qp.z, sizeof s->step.du);
    (void)memcpy(s->step.mult_u, s->qp.mult, sizeof s->step.mult_u);
    for (int m = 0; m < NG; m++) {
        s->step.mult[m] = qp_multiplier(s, m);
    }
}

/* Returns the multiplier, which the QP computes when it checks its solution. */
static inline const real_t *condense_multiplier(const solver_t *s, int k)
{
    return s->riccati.work.vectors.rhs.g[k];
}

static status_t condense_solve(solver_t *s)
{
    status_t status;
    condense_embed(s);
    status = qp_solve(s);
    condense_expand(s);
    return status;
}

static void qp_shift_controls(solver_t *s, int n);
static void qp_shift_rows(solver_t *s, const int *source);

static void condense_shift(solver_t *s)
{
    qp_shift_controls(s, NU);
}

static void condense_shift_rows(solver_t *s, const int *source)
{
    qp_shift_rows(s, source);
}
