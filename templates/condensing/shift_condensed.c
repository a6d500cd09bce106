/* Slacks follow their rows. */
static void condense_shift(solver_t *s, const int *source)
{
    int m;
    for (m = 0; m < NG; m++) {
        if (row_slack[m] >= 0) {
            s->qp.side[row_slack[m]] = (source[m] < 0) ? 0 : s->qp.side[row_slack[source[m]]];
        }
    }
    qp_shift_working_set(&s->qp, NU, source);
}
