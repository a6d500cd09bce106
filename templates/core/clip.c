/* Returns the nearest number in [lower, upper]; NaN stays NaN. */
static real_t clip(real_t value, real_t lower, real_t upper)
{
    if (value < lower) {
        return lower;
    }
    return (value > upper) ? upper : value;
}
