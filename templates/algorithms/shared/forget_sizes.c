/* Forgets the sizes learnt from plans, as before the first plan that is OK. */
static void forget_sizes(solver_t *s)
{
    for (int i = 0; i < NX; i++) {
        s->state_size[i] = INF;
    }
}
