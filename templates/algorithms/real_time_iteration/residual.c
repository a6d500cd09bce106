/* The residual of a plan measures how far the plan is from satisfying the model where a QP is linearised. It is the
 * largest gap relative to the scale of its state. Changes of data since the last step (measured state, bounds,
 * references) do not count, nor does the last interval, which a shift adds. */

#include "algorithms/shared/scales.c"

/* Rows count by the violation beyond that which the last step predicted for them. The scale of row m is the magnitude
 * of its finite bounds or, if they are 0, its value, at least 1/1000 of recent values; the constant part of a row
 * belongs to its bounds. The scale is at least a small fraction of the scale of its terms. */
static real_t scale_of_row(solver_t *s, int m, real_t value)
{
    const real_t offset = row_offset[row_id(m)];
    const real_t magnitude = row_magnitude[row_id(m)];
    real_t scale = R(0), *most = &s->row_scale[row_id(m)];
    enlarge(most, value - offset);
    enlarge_if_finite(&scale, row_lower(s, m) - offset);
    enlarge_if_finite(&scale, row_upper(s, m) - offset);
    if (!(scale > TOL_ZERO * magnitude)) {
        scale = FACTOR_SCALE_MOVING_ROW * *most;
        enlarge(&scale, value - offset);
    }
    enlarge(&scale, FACTOR_SCALE_LITTLE_OF_ROW * magnitude);
    return scale;
}

/* Returns the largest violation of a hard row at the present point beyond that in the solution of the QP, of whose step
 * the plan took the fraction `length`. */
static real_t row_residual(solver_t *s, real_t length)
{
    real_t value[NG], most = R(0);
    evaluate_rows(s, value);
    for (int m = 0; m < NG; m++) {
        if (row_is_soft(s, m) || row_is_state(m)) {
            continue;
        }
        const real_t promised = outside(s, m, row_constant(s, m) + row_change(s, m) / length);
        const real_t left = outside(s, m, value[m]) - promised, scale = scale_of_row(s, m, value[m]);
        enlarge(&most, (left <= R(0)) ? R(0) : left / scale);
    }
    return most;
}

/* Returns the largest gap of the plan, relative to the size of its state, without derivatives. */
static real_t largest_gap(const solver_t *s, const real_t *size)
{
    real_t most = R(0);
    for (int k = 0; k < N; k++) {
        real_t x_next[NX];
        interval_value(s, k, x_next);
        for (int i = 0; i < NX; i++) {
            enlarge(&most, (x_next[i] - s->x[k + 1][i]) / size[i]);
        }
    }
    return most;
}

/* Returns the largest violation of hard rows by the plan that has just been linearised, in their scales; bounds of
 * states count by its gaps. */
static real_t rows_left(solver_t *s)
{
    real_t most = R(0);
    if (NONLINEAR_ROWS) {
        most = s->row_residual;
    }
    for (int m = 0; m < NG; m++) {
        if (row_is_state(m) && !row_is_soft(s, m) && row_node(m) > 0) {
            const real_t value = s->x[row_node(m)][row_index(m)];
            const real_t end = value + s->node[row_node(m) - 1].b[row_index(m)];
            const real_t left = outside(s, m, end) - outside(s, m, value);
            enlarge(&most, (left <= R(0)) ? R(0) : left / scale_of_row(s, m, value));
        }
    }
    return most;
}

/* Computes the residual of the plan that has just been linearised. */
static void measure_residual(solver_t *s)
{
    real_t size[NX], gap[NX] = {R(0)}, most = R(0);
    state_scales(s, size);
    for (int k = 0; k < N; k++) {
        enlarge_all(gap, s->node[k].b, NX);
        if (IMPLICIT) {
            enlarge_all(gap, s->node[k].left, NX);
        }
    }
    for (int i = 0; i < NX; i++) {
        enlarge(&most, gap[i] / size[i]);
    }
    if (NONLINEAR_ROWS) {
        enlarge(&most, s->row_residual);
    }
    s->stats.residual = most;
}
