/* Adds the controls that are process noise of a state, at the end of an interval. */
static inline void add_noise(const real_t *u, real_t *x_next)
{
    for (int n = 0; n < NOISES; n++) {
        x_next[noise_state[n]] += u[noise_control[n]];
    }
}
