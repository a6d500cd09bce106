static void condense_shift(solver_t *s)
{
    qp_shift_controls(s, NU);
}

static void condense_shift_rows(solver_t *s, const int *source)
{
    qp_shift_rows(s, source);
}
