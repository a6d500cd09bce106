/* Returns the curvature of a linear cost with this slope in a control that has these bounds: |slope| / size, where size
 * is half the width of the bounds, or 1 without bounds; 0 if they are equal. */
static real_t linear_curvature(real_t slope, real_t lower, real_t upper)
{
    const real_t width = upper - lower, size = (width < INF) ? R(0.5) * width : R(1);
    return (size > R(0)) ? FABS(slope) / size : R(0);
}
