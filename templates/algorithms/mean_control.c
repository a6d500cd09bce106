/* Mean of control j of the old plan over [from, to]. */
static real_t mean_control(const solver_t *s, int j, real_t from, real_t to)
{
    real_t sum = R(0);
    for (int n = 0; n < N; n++) {
        const real_t start = (node_time[n] > from) ? node_time[n] : from;
        const real_t end = (n + 1 < N && node_time[n + 1] < to) ? node_time[n + 1] : to;
        sum += (end > start) ? (end - start) * s->u[n][j] : R(0);
    }
    return sum / (to - from);
}
