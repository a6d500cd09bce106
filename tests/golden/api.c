/* ==== settings and results =============================================================================== */

/* Settings, results and integration: the functions that the application calls besides those of the algorithm. */

const char *API(status_string)(status_t status)
{
    static const char *const text[] = {
        "ok",
        "iteration limit reached",
        "the constraints cannot be met",
        "soft solution: rows were relaxed",
        "numerical failure: a factorisation broke down or a number is not finite",
        "the measured state is not finite",
        "feedback without prepare",
        "init was not called",
        "no such node, row or parameter",
        "lower bound above upper bound",
        "argument out of range or not finite",
        "no further progress",
        "a subproblem was given up"
    };
    const int index = (int)status;
    return (index >= 0 && index < 13) ? text[index] : "unknown status";
}

/* Restores the initial iterate; the settings (references, weights, parameters, bounds) are kept. */
status_t API(reset)(solver_t *s)
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    algorithm_reset(s);
    return OK;
}

/* Fills `to` with consecutive copies of the n numbers in `from`. Not by memcpy: GCC 12 with AVX-512 stores wrong numbers in
 * place of a constant table that begins with equal numbers and ends with zeros. */
static void fill_copies(real_t *to, int copies, const real_t *from, int n)
{
    for (int i = 0; i < copies * n; i++) {
        to[i] = from[i % n];
    }
}

/* Initialises all members to their declared values. */
status_t API(init)(solver_t *s)
{
    memset(s, 0, sizeof *s);
    fill_copies(&s->p[0][0], N + 1, default_parameter, NP);
    fill_copies(&s->yref[0][0], N, default_reference, NY);
    fill_copies(&s->yref_N[0], 1, default_terminal_reference, NY_N);
    fill_copies(&s->W[0][0], 1, default_weight, NW);
    fill_copies(&s->W_N[0], 1, default_terminal_weight, NW_N);
    fill_copies(&s->lower[0][0], 2, default_lower, NR);
    fill_copies(&s->upper[0][0], 2, default_upper, NR);
    s->magic = MAGIC;
    algorithm_reset(s);
    return OK;
}

/* Finds the copies first .. end - 1 of the data of node k or of ALL nodes; returns 0 if there is no such node. Each of
 * the nodes lowest .. highest has its own copy; that of the highest node is the last one. */
static int locate(int k, int lowest, int highest, int copies, int *first, int *end)
{
    const int own = k >= lowest && k <= highest;
    *first = own ? copies - 1 - (highest - k) : 0;
    *end = own ? *first + 1 : copies;
    return own || k == ALL;
}

/* Sets the reference of the path residual y. Takes effect in the next feedback, after a change of weights or
 * parameters in the next prepare. */
status_t API(set_reference)(solver_t *s, int k, const real_t yref[NY])
{
    int first, end;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!locate(k, 0, N - 1, N, &first, &end)) {
        return BAD_INDEX;
    }
    if (!all_finite(yref, NY)) {
        return BAD_ARGUMENT;
    }
    for (int n = first; n < end; n++) {
        memcpy(s->yref[n], yref, sizeof s->yref[n]);
    }
    s->renewal = (s->renewal == HELD) ? HELD : REFERENCE_CHANGED;
    return OK;
}

status_t API(set_terminal_reference)(solver_t *s, const real_t yref[NY_N])
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!all_finite(yref, NY_N)) {
        return BAD_ARGUMENT;
    }
    memcpy(s->yref_N, yref, sizeof s->yref_N);
    s->renewal = (s->renewal == HELD) ? HELD : REFERENCE_CHANGED;
    return OK;
}

/* Returns 1 if W, n diagonal entries, is finite and nonnegative. */
static int weight_is_valid(const real_t *W, int n, int entries)
{
    for (int i = 0; i < n; i++) {
        if (!(W[i] >= R(0))) {
            return 0;
        }
    }
    return all_finite(W, entries);
}

/* Sets the weight of the path residual, given by its diagonal.
 * Takes effect in the next prepare. */
status_t API(set_weight)(solver_t *s, int k, const real_t W[NW])
{
    int first, end;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!locate(k, 0, -1, 1, &first, &end)) {
        return BAD_INDEX;
    }
    if (!weight_is_valid(W, NY, NW)) {
        return BAD_ARGUMENT;
    }
    hold_gradients(s);
    for (int n = first; n < end; n++) {
        memcpy(s->W[n], W, NW * sizeof(*W));
    }
    return OK;
}

status_t API(set_terminal_weight)(solver_t *s, const real_t W[NW_N])
{
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (!weight_is_valid(W, NY_N, NW_N)) {
        return BAD_ARGUMENT;
    }
    hold_gradients(s);
    memcpy(s->W_N, W, NW_N * sizeof(*W));
    return OK;
}

/* Sets one parameter (PARAM_...). Takes effect in the next prepare. */
status_t API(set_parameter)(solver_t *s, int param, int k, const real_t *values)
{
    int first, end;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (param < 0 || param >= PARAMS || !locate(k, 0, N, N + 1, &first, &end)) {
        return BAD_INDEX;
    }
    if (!all_finite(values, parameter_offset[param + 1] - parameter_offset[param])) {
        return BAD_ARGUMENT;
    }
    hold_gradients(s);
    for (int n = first; n < end; n++) {
        for (int i = parameter_offset[param]; i < parameter_offset[param + 1]; i++) {
            s->p[n][i] = values[i - parameter_offset[param]];
        }
    }
    return OK;
}

/* Returns 1 if the declared row is imposed at node k. */
static int row_holds(int row, int k)
{
    for (int m = row_first[k]; m < row_first[k + 1]; m++) {
        if (row_id[m] == row) {
            return 1;
        }
    }
    for (int j = 0; k < N && j < NU; j++) {
        if (control_row[j] == row) {
            return 1;
        }
    }
    return 0;
}

/* Sets the bounds of one scalar row (ROW_...) at one of its nodes. Crossed or undefined bounds are refused and the
 * previous ones kept. Takes effect in the next feedback. */
status_t API(set_bounds)(solver_t *s, int row, int k, real_t lower, real_t upper)
{
    int first, end;
    if (s->magic != MAGIC) {
        return NOT_INITIALIZED;
    }
    if (row < 0 || row >= NR || !locate(k, N, N, 2, &first, &end) || (k != ALL && !row_holds(row, k))) {
        return BAD_INDEX;
    }
    if (!(lower <= upper && lower < (real_t)INFINITY && upper > -(real_t)INFINITY)) {
        return BAD_BOUNDS;
    }
    for (int n = first; n < end; n++) {
        s->lower[n][row] = lower;
        s->upper[n][row] = upper;
    }
    return OK;
}

/* Cost of the present iterate: sum_k l_k + l_N and the penalties of soft rows. */
real_t API(cost)(const solver_t *s)
{
    return nodal_cost(s);
}
