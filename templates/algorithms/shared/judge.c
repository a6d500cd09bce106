/* Returns 1 if a residual is above the tolerance. */
static inline int is_far(real_t residual)
{
    return !(residual <= residual_tolerance[0]);
}

/* Returns NOT_CONVERGED instead of OK if the plan of the sample is far from the model. */
static inline status_t judge_residual(status_t status, real_t residual)
{
    return (status == OK && is_far(residual)) ? NOT_CONVERGED : status;
}
