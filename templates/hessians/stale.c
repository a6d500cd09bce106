/* Detects data that differ from those for which a constant Hessian was computed. */

/* Returns 1 if one of n numbers differs from the declared one. */
static int numbers_differ(const real_t *values, const real_t *declared, int n)
{
    for (int i = 0; i < n; i++) {
        if (values[i] < declared[i] || values[i] > declared[i]) {
            return 1;
        }
    }
    return 0;
}

/* Returns 1 if a bound of one of the copies differs from that for which M was computed. */
static int bounds_differ(const real_t lower[NR], const real_t upper[NR])
{
    for (int i = 0; i < NR; i++) {
        if (lower[i] < tuned_least_lower[i] || lower[i] > tuned_most_lower[i] || upper[i] < tuned_least_upper[i] ||
            upper[i] > tuned_most_upper[i]) {
            return 1;
        }
    }
    return 0;
}

/* Returns 1 if data have other values than those for which M was computed. */
static int data_differ(const solver_t *s)
{
    int differ = 0;
    if (SET_PARAMETER) {
        for (int k = 0; k < N; k++) {
            for (int i = 0; i < NP; i++) {
                differ |= tuned_parameter[i] && numbers_differ(&PARAM(s, k)[i], &default_parameter[i], 1);
            }
        }
        for (int i = 0; i < NP; i++) {
            differ |= tuned_parameter[i] && numbers_differ(&PARAM_N(s)[i], &default_parameter[i], 1);
        }
    }
    if (SET_WEIGHT && NY) {
        for (int k = 0; k < N; k++) {
            differ |= numbers_differ(WEIGHT(s, k), default_weight, NW);
        }
    }
    if (SET_WEIGHT && NY_N) {
        differ |= numbers_differ(WEIGHT_N(s), default_terminal_weight, NW_N);
    }
    if (SET_BOUNDS) {
        for (int k = 0; k < (int)(sizeof s->lower / sizeof s->lower[0]); k++) { /* at most N + 1 passes */
            differ |= bounds_differ(s->lower[k], s->upper[k]);
        }
    }
    if (SET_SOFT) {
        for (int k = 0; k < (int)(sizeof s->soft_l1 / sizeof s->soft_l1[0]); k++) { /* at most N + 1 passes */
            differ |= numbers_differ(s->soft_l1[k], default_soft_l1, SOFT_ROWS);
            differ |= numbers_differ(s->soft_l2[k], default_soft_l2, SOFT_ROWS);
        }
    }
    return differ;
}
