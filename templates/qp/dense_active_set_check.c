/* Contract of this part: the optimality conditions of an answer, recomputed from the data, and iterative refinement. */

/* r = H x + g + mult[0..NV) + A'mult[NV..NV+NG), where H = L D L' - E, and size = the magnitude of its terms; where
 * all of them vanish up to rounding, size = sqrt(D) (|y0| + |y|) / 2^8. */
static void qp_stationarity(const qp_t *q, real_t *r, real_t *size)
{
    const real_t unit = R(1.0 / 256) * (q->scale + norm(q->work.basis.y));
    real_t u[LDV];
    qp_to_working_coordinates(q, q->x, r);
    for (int i = 0; i < NV; ++i) {
        u[i] = r[i] / q->inverse[i];
        r[i] = q->g[i] + q->mult[i] - (q->semidefinite ? q->proximal[i] * q->x[i] : R(0));
        size[i] = FABS(q->g[i]) + FABS(q->mult[i]) + FABS(u[i]) + unit / q->inverse[i];
        r[i] += u[i];
        for (int j = 0; j < i; ++j) {
            const real_t term = q->H[i][j] * u[j];
            r[i] += term;
            size[i] += FABS(term);
        }
    }
#if NG
    for (int c = NV; c < NV + NG; ++c) {
        for (int i = 0; q->side[c] != INACTIVE && i < NV; ++i) {
            const real_t term = q->A[c - NV][i] * q->mult[c];
            r[i] += term;
            size[i] += FABS(term);
        }
    }
#endif
}

/* Violation of row c by x, in both directions if the row is a member; 0 if it is saturated. Positive above the bound. */
static real_t qp_excess(const qp_t *q, int c)
{
#if NG
    const real_t value = qp_value(q, c, q->x);
#else
    const real_t value = q->x[c];
#endif
#if ELASTIC
    if (qp_is_saturated(q, c)) {
        return R(0);
    }
#endif
    if (qp_is_member(q, c)) {
        return value - qp_bound(q, c);
    }
    return value > q->upper[c] ? value - q->upper[c] : value < q->lower[c] ? value - q->lower[c] : R(0);
}

/* Returns 1 if x and mult satisfy the optimality conditions up to rounding. r: gradient of the Lagrangian; w: bounds
 * minus values of the members. */
static int qp_is_optimal(const qp_t *q, real_t *r, real_t *w)
{
    real_t size[LDV];
    int optimal = 1;
    clear(r);
    qp_stationarity(q, r, size);
    for (int i = 0; i < NV; ++i) {
        optimal &= FABS(r[i]) <= qp_tolerance() * size[i];
    }
    for (int c = 0; c < NV + NG; ++c) {
        const real_t excess = qp_excess(q, c);
        optimal &= FABS(excess) <= qp_tolerance() * qp_row_size(q, c);
    }
    for (int k = 0; k < q->nw; ++k) {
        w[k] = -qp_excess(q, q->row[k]);
    }
    return optimal;
}

/* One step of iterative refinement on the working set: x and lam take the corrections for the residuals r and w. */
static void qp_refine(qp_t *q, real_t *r, real_t *w)
{
    real_t c[LDV], step[LDV];
    for (int i = 0; i < LDV; ++i) {
        r[i] = -r[i];
    }
    qp_forward(q, r, 0);
    qp_solve_transposed(q, w);
    qp_move_to_bounds(q, w, c, r);
    qp_solve_triangle(q, c);
    qp_backward(q, r, step);
    for (int i = 0; i < LDV; ++i) {
        q->x[i] += step[i];
    }
    for (int k = 0; k < q->nw; ++k) {
        q->lam[k] += c[k];
    }
}

/* Writes the result; what fails its conditions is refined up to twice. Returns 0 if they still do not hold. */
static int qp_accept(qp_t *q)
{
    real_t r[LDV], w[LDV];
    for (int step = 0; qp_write_result(q); ++step) {
        if (qp_is_optimal(q, r, w)) {
            return 1;
        }
        if (step == 2) {
            return 0;
        }
        qp_refine(q, r, w);
    }
    return 0;
}
