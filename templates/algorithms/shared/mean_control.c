/* Returns the mean of control j of the old plan over [from, to], which begins at or after node k. */
static real_t mean_control(const solver_t *s, int k, int j, real_t from, real_t to)
{
    real_t sum = R(0);
    for (int n = k; n < N && node_time[n] < to; n++) {
        const real_t start = (node_time[n] > from) ? node_time[n] : from;
        const real_t end = (n + 1 < N && node_time[n + 1] < to) ? node_time[n + 1] : to;
        sum += (end > start) ? (end - start) * s->u[n][j] : R(0);
    }
    return sum / (to - from);
}
