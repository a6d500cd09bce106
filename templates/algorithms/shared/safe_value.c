/* Returns control j at node k, replaced by its reference if it is not finite, clipped to its bounds. */
static real_t safe_value(const solver_t *s, int k, int j)
{
    const real_t u = s->u[k][j];
    return clip(isfinite(u) ? u : reference_of_control(s, k, j), control_lower(s, k, j), control_upper(s, k, j));
}

/* Sets the controls of the plan to their references, clipped to their bounds. */
static void refer_controls(solver_t *s)
{
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            s->u[k][j] = reference_of_control(s, k, j);
            s->u[k][j] = safe_value(s, k, j);
        }
    }
}
