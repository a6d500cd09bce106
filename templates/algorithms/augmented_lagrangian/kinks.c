/* This part keeps the model of the relaxed rows valid along a step. The model has a parabola for every term psi_m,
 * expanded at the present plan, but along the step a row may begin or cease to act. The model then uses the parabola of
 * psi_m beyond this kink, so that the gradient of the model at d is that of the cost, the gaps and psi_m(v_m + J_m d),
 * with v_m and J_m from the linearisation. */

/* Returns J_m d_k of a relaxed row. */
static real_t row_change(const solver_t *s, int m, real_t (*d)[LDZ])
{
    const int k = row_node(m);
    if (row_is_state(m)) {
        return d[k][row_index(m)];
    }
    if (GENERAL_ROWS || NE) {
        const real_t *J = row_gradient(s, m);
        real_t change = R(0);
        for (int i = 0; i < nz_at(k); i++) {
            change += J[i] * d[k][i];
        }
        return change;
    } else {
        return R(0);
    }
}

/* Returns the slope of the term of row m at d minus the slope of its parabola, where `move` = J_m d; 0 if the
 * difference is rounding. */
static real_t miss_of_parabola(const solver_t *s, int m, real_t move, real_t *term, real_t *curvature)
{
    const auglag_t *a = &s->auglag;
    const real_t of_parabola = a->slope[m] + a->curvature[m] * move;
    real_t slope, miss, terms;
    *term = row_term(s, m, a->value[m] + move, &slope, curvature);
    miss = slope - of_parabola;
    terms = FABS(slope) + FABS(a->slope[m]) + FABS(a->curvature[m] * move);
    return (FABS(miss) > SQRT(TOL_UNIT) * terms) ? miss : R(0);
}

/* Returns the sum of the row terms at d minus their parabolas; 0 if no row has left its parabola. */
static real_t beyond_parabolas(solver_t *s)
{
    auglag_t *a = &s->auglag;
    real_t sum = R(0);
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m] && row_bends[m]) {
            const real_t move = row_change(s, m, a->d);
            real_t term, curvature;
            if (FABS(miss_of_parabola(s, m, move, &term, &curvature)) > R(0)) {
                sum += term - a->term[m] - (a->slope[m] + R(0.5) * a->curvature[m] * move) * move;
            }
        }
    }
    return sum;
}

/* Takes the parabolas at d. Returns the last node with a row that has left its parabola, -1 if there is none. */
static int take_parabolas(solver_t *s)
{
    auglag_t *a = &s->auglag;
    int last = -1;
    for (int m = 0; m < NG; m++) {
        if (row_relaxed[m] && row_bends[m]) {
            const real_t move = row_change(s, m, a->d);
            real_t term, curvature;
            const real_t miss = miss_of_parabola(s, m, move, &term, &curvature);
            if (FABS(miss) > R(0)) {
                const real_t bend = curvature - a->curvature[m];
                change_row(s, m, miss - bend * move, bend * move, bend);
                a->slope[m] += miss - bend * move;
                a->offset -= a->term[m];
                a->term[m] = term - (a->slope[m] + R(0.5) * curvature * move) * move;
                a->offset += a->term[m];
                a->curvature[m] = curvature;
                last = (row_node(m) > last) ? row_node(m) : last;
            }
        }
    }
    return last;
}
