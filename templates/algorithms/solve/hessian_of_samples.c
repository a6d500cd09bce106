/* The search takes the Hessian of the samples, which is convex. */

/* Linearises the present point, and evaluates the Hessian. */
static void evaluate_iterate(solver_t *s)
{
    evaluate_for_sample(s);
}

/* Forms the QP of the present linearisation. */
static status_t form_qp(solver_t *s)
{
    return condense_prepare(s);
}

static void push_to_bounds(solver_t *s)
{
}

static void restore_gradients(solver_t *s)
{
}

static int damp_qp(solver_t *s)
{
    return 0;
}

static int adapt_shifts(solver_t *s, status_t status)
{
    return 0;
}

static int is_damped_for_ever(const solver_t *s)
{
    return 0;
}

static void bound_multipliers(solver_t *s)
{
}
