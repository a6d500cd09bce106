/* No plan was OK yet. */
static void forget_sizes(solver_t *s)
{
    for (int i = 0; i < NX; i++) {
        s->state_size[i] = INF;
    }
}
