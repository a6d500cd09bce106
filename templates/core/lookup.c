/* Returns the index i of the interval of a sorted grid that contains x, grid[i] <= x < grid[i + 1]: the first one for
 * smaller x and for NaN, the last one for larger x. The search halves the range `passes` times, until one interval is
 * left. */
static real_t find_interval(const real_t *grid, int intervals, int passes, real_t x)
{
    int low = 0, high = intervals;
    for (int pass = 0; pass < passes; pass++) {
        const int middle = (low + high) / 2;
        if (x >= grid[middle]) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return (real_t)low;
}
