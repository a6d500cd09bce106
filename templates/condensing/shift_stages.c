static void condense_shift(solver_t *s, const int *source)
{
    qp_shift_working_set(s, NU, source);
}
