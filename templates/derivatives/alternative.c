/* Alternative integration, Algorithms 6.8 to 6.10, integrates the response S_n = dx_n / du_k of all states to one
 * control over n = k + 1, ..., N together with the states. It needs no NX x NX transition matrices. */

/* Computes x_n and S_n, k < n <= end, from x_k. */
static void respond(const data_t *d, int k, int end, response_t *s)
{
    real_t(*x)[NX] = s->nodes.x;
    INTEGRATOR_FORCED(d, k, x[k], d->u[k], x[k + 1], &s->S[k + 1][0][0]);
    for (int n = k + 1; n < end; n++) {
        INTEGRATOR_FREE(d, n, x[n], d->u[n], &s->S[n][0][0], x[n + 1], &s->S[n + 1][0][0]);
    }
}

/* Algorithm 6.8 for one k: computes S_n = dx_n / du_k, zero for n <= k. */
status_t API(sensitivities_alternative)(const data_t *d, int k, response_t *s)
{
    if (k < 0 || k >= N) {
        return BAD_INDEX;
    }
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    clear(&s->S[0][0][0], (k + 1) * NX * NU);
    roll_out(d, k, s->nodes.x);
    respond(d, k, N, s);
    return finite_or(&s->S[0][0][0], (N + 1) * NX * NU);
}

/* Algorithms 6.8 and 6.9: g_k = r_k + sum_{k<n<N} q_n' S_n + q_N' S_N. The first pass, k = 0, yields all states. */
status_t API(gradient_alternative)(const data_t *d, response_t *s, real_t g[N][NU])
{
    if (!data_finite(d)) {
        return NOT_FINITE;
    }
    copy_state(s->nodes.x[0], d->x0);
    for (int k = 0; k < N; k++) {
        respond(d, k, N, s);
        if (k == 0) {
            cost_gradients(d, &s->nodes);
        }
        start_gradient(&s->nodes, k, g[k]);
        for (int n = k + 1; n < N; n++) {
            add_columns(s->nodes.g[n], &s->S[n][0][0], g[k]);
        }
        add_columns(s->nodes.g_N, &s->S[N][0][0], g[k]);
    }
    return finite_or(&g[0][0], N * NU);
}
