/* Algebraic variables of a point (x, z): 0 = g(x, z, u, p), by Newton's method, whose steps are halved until the next
 * one with the same factors is shorter. */

/* z -= length d. */
static void take_damped_step(real_t *point, const real_t *u, const real_t *p, const real_t *M, const int *order,
    const real_t *d, real_t size)
{
    real_t *z = point + NX, start[NALG], g[NALG], rest[NALG], J[NALG][NALG] = {{R(0)}}, length = R(1);
    int worst;
    memcpy(start, z, sizeof start);
    for (int n = 0; n <= HALVINGS; n++) {
        for (int i = 0; i < NALG; i++) {
            z[i] = start[i] - length * d[i];
        }
        STAGE_EQUATION(point, u, p, g, J);
        lu_solve(M, order, NALG, g, rest, 1);
        if (size_of_correction(rest, start, state_unit + NX, NALG, &worst) <= (R(1) - R(0.5) * length) * size) {
            return;
        }
        length *= R(0.5);
    }
}

/* z from that in the point, and the factors of dg/dz. Returns -1, the variable whose column has no pivot, or NALG plus
 * the one that does not converge. */
static int solve_algebraic(real_t *point, const real_t *u, const real_t *p, real_t (*M)[NALG], int *order)
{
    real_t *z = point + NX, g[NALG], d[NALG], size = INF;
    int worst = 0;
    for (int n = 0; n < NEWTON_LIMIT; n++) {
        const real_t before = size;
        memset(M, 0, NALG * sizeof *M);
        STAGE_EQUATION(point, u, p, g, M);
        const int singular = lu_factorize(M[0], order, state_unit + NX, NALG);
        if (singular >= 0) {
            return singular;
        }
        lu_solve(M[0], order, NALG, g, d, 1);
        size = size_of_correction(d, z, state_unit + NX, NALG, &worst);
        if (!(size < INF)) {
            return NALG + worst;
        }
        if (size <= ((size >= R(0.5) * before) ? TOL_NEWTON_STALLED : TOL_NEWTON)) {
            for (int i = 0; i < NALG; i++) {
                z[i] -= d[i];
            }
            return -1;
        }
        take_damped_step(point, u, p, M[0], order, d, size);
    }
    return NALG + worst;
}

/* The same from `start`, and from the declared values if that fails; NaN if both do. */
static int find_algebraic(
    real_t *point, const real_t *start, const real_t *u, const real_t *p, real_t (*M)[NALG], int *order)
{
    memcpy(point + NX, start, NALG * sizeof *point);
    int reason = solve_algebraic(point, u, p, M, order);
    if (reason >= 0) {
        memcpy(point + NX, algebraic_start, NALG * sizeof *point);
        reason = solve_algebraic(point, u, p, M, order);
    }
    for (int i = 0; reason >= 0 && i < NALG; i++) {
        point[NX + i] = (real_t)NAN;
    }
    return reason;
}

/* What functions of a node read: the parameters and z. Returns -1, or why there is no z. */
static int fill_node(const real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t *data,
    real_t (*M)[NALG], int *order)
{
    real_t point[NXA];
    memcpy(point, x, NX * sizeof *x);
    const int reason = find_algebraic(point, z, u, p, M, order);
    for (int i = 0; i < NP; i++) {
        data[i] = p[i];
    }
    memcpy(data + NP, point + NX, NALG * sizeof *point);
    return reason;
}

static void implicit_node_point(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t *data)
{
    real_t M[NALG][NALG];
    int order[NALG];
    (void)fill_node(x, z, u, p, data, M, order);
}

/* The same, and W = -(dg/dz)^-1 row by row. */
static void implicit_node_data(
    const real_t *x, const real_t *z, const real_t *u, const real_t *p, real_t *data)
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
        memcpy(W, minus, sizeof minus);
    }
}
