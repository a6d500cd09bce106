/* Single shooting: states, outputs and cost of a sequence of controls. */

static void copy_state(real_t *y, const real_t *x)
{
    for (int i = 0; i < NX; i++) {
        y[i] = x[i];
    }
}

static void clear(real_t *y, int n)
{
    for (int i = 0; i < n; i++) {
        y[i] = R(0);
    }
}

/* J += l_k(x, u, p_k) */
static void add_cost(const data_t *d, int k, const real_t *x, const real_t *u, real_t *J)
{
    real_t l;
    PATH_COST(d, k, x, u, &l);
    *J += l;
}

/* J + l_N(x_N, p_N) */
static real_t with_terminal_cost(const data_t *d, const real_t *x, real_t J)
{
    real_t l;
    TERMINAL_COST(d, x, &l);
    return J + l;
}

/* x_{k+1} = Phi(x_k, u_k, p_k), k < end */
static void roll_out(const data_t *d, int end, real_t (*x)[NX])
{
    copy_state(x[0], d->x0);
    for (int k = 0; k < end; k++) {
        INTEGRATOR_VALUE(d, k, x[k], d->u[k], x[k + 1]);
    }
}

/* x_{k+1} = Phi(x_k, u_k, p_k), z_k = g(x_k, u_k, p_k), partial_k = sum_{n<k} l_n, J = partial_N + l_N */
status_t API(simulate)(const data_t *d, trajectory_t *t)
{
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    roll_out(d, N, t->x);
    t->partial[0] = R(0);
    for (int k = 0; k < N; k++) {
        t->partial[k + 1] = t->partial[k];
        add_cost(d, k, t->x[k], d->u[k], &t->partial[k + 1]);
        if (NOUT > 0) {
            OUTPUT(d, k, t->x[k], d->u[k], t->z[k]);
        }
    }
    t->J = with_terminal_cost(d, t->x[N], t->partial[N]);
    if (NOUT > 0 && !all_finite(&t->z[0][0], N * NOUT)) {
        return NOT_FINITE;
    }
    return (all_finite(&t->x[0][0], (N + 1) * NX) && all_finite(&t->J, 1)) ? OK : NOT_FINITE;
}
