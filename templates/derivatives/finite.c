/* Contract: every entry point returns NOT_FINITE, and leaves its results undefined, if its data or results are not
 * finite. */

static int all_finite(const real_t *values, int n)
{
    for (int i = 0; i < n; i++) {
        if (!isfinite(values[i])) {
            return 0;
        }
    }
    return 1;
}

static status_t finite_or(const real_t *values, int n)
{
    return all_finite(values, n) ? OK : NOT_FINITE;
}
