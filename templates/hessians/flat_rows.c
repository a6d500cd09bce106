/* The curvature of the rows is left out. */
static void add_rows(solver_t *s)
{
    (void)s;
}
