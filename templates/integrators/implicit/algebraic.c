/* Algebraic variables of a point (x, z): 0 = g(x, z, u, p), by Newton's method. A step is halved until the next step
 * with the same factors is shorter. */

/* Computes z from the initial guess in `point`, and the factors of dg/dz. Returns -1 on success, the index of a
 * variable whose column has no pivot, or NALG plus the index of a variable that does not converge. */
static int solve_algebraic(real_t *point, const real_t *u, const real_t *p, real_t (*M)[NALG], int *order)
{
    real_t *z = point + NX, from[NALG], g[NALG], J[NALG][NALG], d[NALG], next[NALG], size = INF, length = R(1);
    int halved = 0, worst = 0;
    for (int n = 0; n < NEWTON_LIMIT; n++) {
        const real_t before = size;
        (void)memset(J, 0, sizeof J);
        STAGE_EQUATION(point, u, p, g, J);
        if (n > 0 && halved < HALVINGS) {
            lu_solve(M[0], order, NALG, g, next, 1);
            const real_t shorter = size_of_correction(next, from, state_unit + NX, NALG, &worst);
            if (!(shorter <= (R(1) - R(0.5) * length) * size)) { /* also true for NaN */
                length *= R(0.5);
                halved++;
                for (int i = 0; i < NALG; i++) {
                    z[i] = from[i] - length * d[i];
                }
                continue;
            }
        }
        (void)memcpy(M, J, sizeof J);
        const int singular = lu_factorize(M[0], order, state_unit + NX, NALG);
        if (singular >= 0) {
            return singular;
        }
        lu_solve(M[0], order, NALG, g, d, 1);
        size = size_of_correction(d, z, state_unit + NX, NALG, &worst);
        const int converged = size <= ((size >= R(0.5) * before) ? TOL_NEWTON_STALLED : TOL_NEWTON);
        (void)memcpy(from, z, sizeof from);
        for (int i = 0; i < NALG; i++) {
            z[i] -= d[i];
        }
        if (converged || !(size < INF)) {
            return converged ? -1 : NALG + worst;
        }
        length = R(1);
        halved = 0;
    }
    return NALG + worst;
}

/* Computes z from `start`, and from the declared values if that fails; z is NaN if both fail. */
static int find_algebraic(
    real_t *point, const real_t *start, const real_t *u, const real_t *p, real_t (*M)[NALG], int *order)
{
    (void)memcpy(point + NX, start, NALG * sizeof *point);
    int reason = solve_algebraic(point, u, p, M, order);
    if (reason >= 0) {
        (void)memcpy(point + NX, algebraic_start, NALG * sizeof *point);
        reason = solve_algebraic(point, u, p, M, order);
    }
    for (int i = 0; reason >= 0 && i < NALG; i++) {
        point[NX + i] = (real_t)NAN;
    }
    return reason;
}

/* Fills the data that functions of a node read: the parameters and z. Returns -1, or the reason why there is no z. */
static int fill_node(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t *data, real_t (*M)[NALG], int *order)
{
    real_t point[NXA];
    (void)memcpy(point, x, NX * sizeof *x);
    const int reason = find_algebraic(point, z, u, p, M, order);
    for (int i = 0; i < NP; i++) {
        data[i] = p[i];
    }
    (void)memcpy(data + NP, point + NX, NALG * sizeof *point);
    return reason;
}

static void implicit_node_point(const real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t *data)
{
    real_t M[NALG][NALG];
    int order[NALG];
    (void)fill_node(x, z, u, p, data, M, order);
}

/* Fills the data of a node, and W = -(dg/dz)^-1 row by row. */
static void implicit_node_data(const real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t *data)
{
    real_t M[NALG][NALG], minus[NALG * NALG] = {R(0)}, *W = data + NP + NALG;
    int order[NALG];
    const int reason = fill_node(x, z, u, p, data, M, order);
    for (int i = 0; i < NALG; i++) {
        minus[i * NALG + i] = (reason < 0) ? -R(1) : (real_t)NAN;
    }
    if (reason < 0) {
        lu_solve(M[0], order, NALG, minus, W, NALG);
    } else {
        (void)memcpy(W, minus, sizeof minus);
    }
}
