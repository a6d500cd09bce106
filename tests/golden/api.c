/* ==== settings and results =============================================================================== */

/* Settings, results and integration: what the application calls besides the algorithm. */

const char *golden_status_string(golden_status_t status)
{
    static const char *const text[] = {
        "ok",
        "iteration limit reached",
        "the constraints cannot be met",
        "soft solution: rows were relaxed",
        "numerical failure: the Hessian is not positive definite or a number is not finite",
        "the measured state is not finite",
        "feedback without prepare",
        "init was not called",
        "no such node, row or parameter",
        "lower bound above upper bound",
        "argument out of range or not finite",
        "no further progress"
    };
    const int index = (int)status;
    return (index >= 0 && index < 12) ? text[index] : "unknown status";
}

/* Back to the plain start; settings (references, weights, parameters, bounds) stay. */
golden_status_t golden_reset(golden_solver_t *s)
{
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    algorithm_reset(s);
    return GOLDEN_OK;
}

/* to = copies of from (n numbers), one after the other. */
static void fill_copies(golden_real *to, int copies, const golden_real *from, int n)
{
    int k, i;
    for (k = 0; k < copies; k++) {
        for (i = 0; i < n; i++) {
            to[k * n + i] = from[i];
        }
    }
}

/* Everything to what the problem states. */
golden_status_t golden_init(golden_solver_t *s)
{
    memset(s, 0, sizeof *s);
    fill_copies(&s->p[0][0], GOLDEN_N + 1, default_parameter, GOLDEN_NP);
    fill_copies(&s->yref[0][0], GOLDEN_N, default_reference, GOLDEN_NY);
    fill_copies(&s->yref_N[0], 1, default_terminal_reference, GOLDEN_NY_N);
    fill_copies(&s->W[0][0], 1, default_weight, GOLDEN_NW);
    fill_copies(&s->W_N[0], 1, default_terminal_weight, GOLDEN_NW_N);
    fill_copies(&s->lower[0][0], 2, default_lower, GOLDEN_NR);
    fill_copies(&s->upper[0][0], 2, default_upper, GOLDEN_NR);
    s->magic = GOLDEN_MAGIC;
    algorithm_reset(s);
    return GOLDEN_OK;
}

/* Copies first .. end - 1 of the data of node k, or of GOLDEN_ALL; 0 if there is no such node. The nodes lowest .. highest
 * have a copy of their own, the highest one the last. */
static int locate(int k, int lowest, int highest, int copies, int *first, int *end)
{
    const int own = k >= lowest && k <= highest;
    *first = own ? copies - 1 - (highest - k) : 0;
    *end = own ? *first + 1 : copies;
    return own || k == GOLDEN_ALL;
}

/* Reference of the path residual y. Takes effect in the next feedback. */
golden_status_t golden_set_reference(golden_solver_t *s, int k, const golden_real yref[GOLDEN_NY])
{
    int first, end, n, i;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (!locate(k, 0, GOLDEN_N - 1, GOLDEN_N, &first, &end)) {
        return GOLDEN_BAD_INDEX;
    }
    if (!all_finite(yref, GOLDEN_NY)) {
        return GOLDEN_BAD_ARGUMENT;
    }
    for (n = first; n < end; n++) {
        for (i = 0; i < GOLDEN_NY; i++) {
            s->yref[n][i] = yref[i];
        }
    }
    s->reference_changed = 1;
    return GOLDEN_OK;
}

golden_status_t golden_set_terminal_reference(golden_solver_t *s, const golden_real yref[GOLDEN_NY_N])
{
    int i;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (!all_finite(yref, GOLDEN_NY_N)) {
        return GOLDEN_BAD_ARGUMENT;
    }
    for (i = 0; i < GOLDEN_NY_N; i++) {
        s->yref_N[i] = yref[i];
    }
    s->reference_changed = 1;
    return GOLDEN_OK;
}

/* 1 if W is finite with nonnegative diagonal (n entries), or finite and symmetric (n x n entries). */
static int weight_is_valid(const golden_real *W, int n, int entries)
{
    const int stride = (entries == n) ? 1 : n + 1;
    int i, j;
    for (i = 0; i < n; i++) {
        if (!(W[i * stride] >= 0.0)) {
            return 0;
        }
        for (j = 0; entries > n && j < i; j++) {
            if (W[i * n + j] < W[j * n + i] || W[i * n + j] > W[j * n + i]) {
                return 0;
            }
        }
    }
    return all_finite(W, entries);
}

/* Weight of the path residual: its diagonal. Takes effect in the next prepare. */
golden_status_t golden_set_weight(golden_solver_t *s, int k, const golden_real W[GOLDEN_NW])
{
    int first, end, n;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (!locate(k, 0, -1, 1, &first, &end)) {
        return GOLDEN_BAD_INDEX;
    }
    if (!weight_is_valid(W, GOLDEN_NY, GOLDEN_NW)) {
        return GOLDEN_BAD_ARGUMENT;
    }
    for (n = first; n < end; n++) {
        memcpy(s->W[n], W, GOLDEN_NW * sizeof(*W));
    }
    return GOLDEN_OK;
}

golden_status_t golden_set_terminal_weight(golden_solver_t *s, const golden_real W[GOLDEN_NW_N])
{
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (!weight_is_valid(W, GOLDEN_NY_N, GOLDEN_NW_N)) {
        return GOLDEN_BAD_ARGUMENT;
    }
    memcpy(s->W_N, W, GOLDEN_NW_N * sizeof(*W));
    return GOLDEN_OK;
}

/* One parameter (GOLDEN_PARAM_...). Takes effect in the next prepare. */
golden_status_t golden_set_parameter(golden_solver_t *s, int param, int k, const golden_real *values)
{
    int first, end, n, i;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (param < 0 || param >= GOLDEN_PARAMS || !locate(k, 0, GOLDEN_N, GOLDEN_N + 1, &first, &end)) {
        return GOLDEN_BAD_INDEX;
    }
    if (!all_finite(values, parameter_offset[param + 1] - parameter_offset[param])) {
        return GOLDEN_BAD_ARGUMENT;
    }
    for (n = first; n < end; n++) {
        for (i = parameter_offset[param]; i < parameter_offset[param + 1]; i++) {
            s->p[n][i] = values[i - parameter_offset[param]];
        }
    }
    return GOLDEN_OK;
}

/* 1 if the row of the user holds at node k. */
static int row_holds(int row, int k)
{
    int m, j;
    for (m = row_first[k]; m < row_first[k + 1]; m++) {
        if (row_id[m] == row) {
            return 1;
        }
    }
    for (j = 0; k < GOLDEN_N && j < GOLDEN_NU; j++) {
        if (control_row[j] == row) {
            return 1;
        }
    }
    return 0;
}

/* Bounds of one scalar row (GOLDEN_ROW_...) at one of its nodes. Crossed or undefined bounds are refused, old ones kept.
 * Takes effect in the next feedback. */
golden_status_t golden_set_bounds(golden_solver_t *s, int row, int k, golden_real lower, golden_real upper)
{
    int first, end, n;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (row < 0 || row >= GOLDEN_NR || !locate(k, GOLDEN_N, GOLDEN_N, 2, &first, &end)) {
        return GOLDEN_BAD_INDEX;
    }
    if (k != GOLDEN_ALL && !row_holds(row, k)) {
        return GOLDEN_BAD_INDEX;
    }
    if (!(lower <= upper) || lower == (golden_real)INFINITY || upper == -(golden_real)INFINITY) {
        return GOLDEN_BAD_BOUNDS;
    }
    for (n = first; n < end; n++) {
        s->lower[n][row] = lower;
        s->upper[n][row] = upper;
    }
    return GOLDEN_OK;
}

/* x_next = x after dt (s) under constant u and the parameters of node 0. */
void golden_integrate(const golden_solver_t *s, const golden_real x[GOLDEN_NX], const golden_real u[GOLDEN_NU], golden_real dt,
    golden_real x_next[GOLDEN_NX])
{
    (void)s; /* where parameters are fixed */
    integrate(x, u, s->p[0], dt, x_next);
}

/* Cost of the present iterate: sum_k l_k + l_N and the penalties of soft rows. */
golden_real golden_cost(const golden_solver_t *s)
{
    return nodal_cost(s) + soft_penalties(s);
}
