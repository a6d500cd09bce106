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

/* Back to the plain start; settings (references, weights, parameters, bounds) stay. */
golden_status_t golden_reset(golden_solver_t *s)
{
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    algorithm_reset(s);
    return GOLDEN_OK;
}

/* Everything to what the problem states. */
golden_status_t golden_init(golden_solver_t *s)
{
    int k, i;
    memset(s, 0, sizeof *s);
    for (k = 0; k <= GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NP; i++) {
            s->p[k][i] = default_parameter[i];
        }
    }
    for (k = 0; k < GOLDEN_N; k++) {
        for (i = 0; i < GOLDEN_NY; i++) {
            s->yref[k][i] = default_reference[i];
        }
    }
    for (i = 0; i < GOLDEN_NY_N; i++) {
        s->yref_N[i] = default_terminal_reference[i];
    }
    memcpy(s->W, default_weight, sizeof s->W);
    memcpy(s->W_N, default_terminal_weight, sizeof s->W_N);
    for (i = 0; i < GOLDEN_NR; i++) {
        s->lower[0][i] = s->lower[1][i] = default_lower[i];
        s->upper[0][i] = s->upper[1][i] = default_upper[i];
    }
    s->magic = GOLDEN_MAGIC;
    algorithm_reset(s);
    return GOLDEN_OK;
}

/* Reference of the path residual y at node k = 0 .. N-1, or GOLDEN_ALL. Takes effect in the next feedback. */
golden_status_t golden_set_reference(golden_solver_t *s, int k, const golden_real yref[GOLDEN_NY])
{
    const int first = (k == GOLDEN_ALL) ? 0 : k;
    const int last = (k == GOLDEN_ALL) ? GOLDEN_N - 1 : k;
    int n, i;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (first < 0 || last >= GOLDEN_N) {
        return GOLDEN_BAD_INDEX;
    }
    if (!all_finite(yref, GOLDEN_NY)) {
        return GOLDEN_BAD_ARGUMENT;
    }
    for (n = first; n <= last; n++) {
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

/* Weight shared by all path nodes (k must be GOLDEN_ALL): its diagonal. Takes effect in the next prepare. */
golden_status_t golden_set_weight(golden_solver_t *s, int k, const golden_real W[GOLDEN_NW])
{
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (k != GOLDEN_ALL) {
        return GOLDEN_BAD_INDEX;
    }
    if (!weight_is_valid(W, GOLDEN_NY, GOLDEN_NW)) {
        return GOLDEN_BAD_ARGUMENT;
    }
    memcpy(s->W, W, GOLDEN_NW * sizeof(*W));
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

/* One parameter (GOLDEN_PARAM_...) at node k = 0 .. N, or GOLDEN_ALL. Takes effect in the next prepare. */
golden_status_t golden_set_parameter(golden_solver_t *s, int param, int k, const golden_real *values)
{
    const int first = (k == GOLDEN_ALL) ? 0 : k;
    const int last = (k == GOLDEN_ALL) ? GOLDEN_N : k;
    int n, i;
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (param < 0 || param >= GOLDEN_PARAMS || first < 0 || last > GOLDEN_N) {
        return GOLDEN_BAD_INDEX;
    }
    if (!all_finite(values, parameter_offset[param + 1] - parameter_offset[param])) {
        return GOLDEN_BAD_ARGUMENT;
    }
    for (n = first; n <= last; n++) {
        for (i = parameter_offset[param]; i < parameter_offset[param + 1]; i++) {
            s->p[n][i] = values[i - parameter_offset[param]];
        }
    }
    return GOLDEN_OK;
}

/* Bounds of one scalar row (GOLDEN_ROW_...), shared by its path nodes: k = GOLDEN_ALL sets all its nodes, k = GOLDEN_N only the
 * terminal one. Crossed or undefined bounds are refused, old ones kept. Takes effect in the next feedback. */
golden_status_t golden_set_bounds(golden_solver_t *s, int row, int k, golden_real lower, golden_real upper)
{
    if (s->magic != GOLDEN_MAGIC) {
        return GOLDEN_NOT_INITIALIZED;
    }
    if (row < 0 || row >= GOLDEN_NR || (k != GOLDEN_ALL && k != GOLDEN_N) || (k == GOLDEN_N && !row_has_terminal[row])) {
        return GOLDEN_BAD_INDEX;
    }
    if (!(lower <= upper) || lower == (golden_real)INFINITY || upper == -(golden_real)INFINITY) {
        return GOLDEN_BAD_BOUNDS;
    }
    if (k == GOLDEN_ALL) {
        s->lower[0][row] = lower;
        s->upper[0][row] = upper;
    }
    s->lower[1][row] = lower;
    s->upper[1][row] = upper;
    return GOLDEN_OK;
}

/* x_next = x after dt (s) under constant u and the parameters of node 0. */
void golden_integrate(const golden_solver_t *s, const golden_real x[GOLDEN_NX], const golden_real u[GOLDEN_NU], golden_real dt,
    golden_real x_next[GOLDEN_NX])
{
    integrate(x, u, s->p[0], dt, x_next);
}

/* Cost of the present iterate: sum_k l_k + l_N. */
golden_real golden_cost(const golden_solver_t *s)
{
    golden_real total, l;
    int k;
    terminal_cost(s->x[GOLDEN_N], s->p[GOLDEN_N], s->yref_N, s->W_N, &total);
    for (k = 0; k < GOLDEN_N; k++) {
        path_cost(s->x[k], s->u[k], s->p[k], &interval_length[k], s->yref[k], s->W, &l);
        total += l;
    }
    return total;
}
