/* Law of the first control from the recursion at the predicted working set. Returns 0 if rows are equations of the set:
 * their multipliers are not part of the recursion. */
static int condense_law(solver_t *s)
{
    const riccati_t *r = &s->riccati;
    if (NG) {
        if (s->schur.active && s->schur.joint > 0) {
            return 0;
        }
    }
    for (int j = 0; j < NU; j++) {
        s->first.feed[j] = r->feed[0][j];
        (void)memcpy(s->first.gain[j], r->K[0][j], sizeof s->first.gain[j]);
    }
    return s->qp.factorized == FACTORS_READY;
}
