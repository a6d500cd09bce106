static void condense_shift(solver_t *s)
{
    qp_shift_controls(&s->qp, NU);
}

/* Shifts the prediction of the working set: row m takes the predicted side of row source[m]. */
static void condense_shift_rows(solver_t *s, const int *source)
{
    for (int m = 0; m < NG; ++m) {
        if (row_slack[m] >= 0) { /* the predicted side of the slack moves with that of its row */
            s->qp.side[row_slack[m]] = s->qp.side[row_slack[source[m]]];
        }
    }
    qp_shift_rows(&s->qp, source);
}
