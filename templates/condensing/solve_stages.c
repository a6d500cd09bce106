static status_t condense_solve(solver_t *s)
{
    status_t status;
    condense_embed(s);
    status = qp_solve(s);
    condense_expand(s);
    return status;
}

static void condense_shift(solver_t *s, const int *source)
{
    qp_shift_working_set(s, NU, source);
}
