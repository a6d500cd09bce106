/* largest = max(largest, |value|), where NaN counts as the largest value. */
static void enlarge(real_t *largest, real_t value)
{
    const real_t a = FABS(value);
    if (a > *largest || a != a) {
        *largest = a;
    }
}
