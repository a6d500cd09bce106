static int qp_response(qp_t *q, int j, real_t *h, real_t *e, real_t *feed);

/* Law of the first control on the predicted working set, from the responses of the QP: with z_j = feed - h'dg + e't,
 * where dg = Hx dx_0 and t are the bounds of the members, of which those of a general row change by -Ax dx_0. Returns 0
 * if there is none. */
static int condense_law(solver_t *s)
{
    for (int j = 0; j < NU; ++j) {
        real_t h[LDV], e[LDV];
        if (!qp_response(&s->qp, j, h, e, &s->first.feed[j])) {
            return 0;
        }
        for (int i = 0; i < NX; ++i) {
            real_t sum = R(0);
            for (int l = 0; l < NV - NSL; ++l) {
                sum -= h[l] * s->condensed.Hx[l][i];
            }
            if (NG) {
                for (int k = 0; k < s->qp.nw; ++k) {
                    const int m = s->qp.row[k] - NV;
                    sum -= (m >= 0) ? e[k] * s->condensed.Ax[m][i] : R(0);
                }
            }
            s->first.gain[j][i] = sum;
        }
    }
    return 1;
}
