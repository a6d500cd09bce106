/* Rows (constraints other than the control bounds), sorted by node: state bounds, general rows h and, at the end,
 * coupled rows r(x_0, x_N). */

#if STATE_ROWS + GENERAL_ROWS + (NE > 0) > 1
enum { ROW_STATE = 0, ROW_GENERAL = 1, ROW_COUPLED = 2 }; /* values of row_kind */

#endif
#include "clip.c"

static int all_finite(const real_t *v, int n)
{
    for (int i = 0; i < n; i++) {
        if (!isfinite(v[i])) {
            return 0;
        }
    }
    return 1;
}

#if CHECK_STEP || (CONDENSED_QP && NG)
/* size = max(size, |v|) by components, n of them; NaN where v has not been finite. */
static inline void widen(real_t *size, const real_t *v, int n)
{
    for (int i = 0; i < n; i++) {
        const real_t a = FABS(v[i]);
        size[i] = ((a > size[i]) ? a : size[i]) + R(0) * a;
    }
}

#endif
#if NG
/* How far a value of row m is outside of its bounds. */
static inline real_t outside(const solver_t *s, int m, real_t value)
{
    return FABS(value - clip(value, ROW_LOWER(s, m), ROW_UPPER(s, m)));
}

/* Values of all rows at the present iterate. */
static void evaluate_rows(const solver_t *s, real_t *value)
{
#if GENERAL_ROWS
    real_t h[NH + NH_N] = {R(0)}, J[(NH + NH_N) * NZ];
#endif
#if NE
    real_t r[NE], J_0[NE * NX], J_N[NE * NX];
    COUPLED_ROWS(s, r, J_0, J_N);
#endif
    for (int m = 0; m < NG; m++) {
#if NH
        if (row_node[m] < N && m == row_first[row_node[m]]) {
            PATH_ROWS(s, row_node[m], h, J);
        }
#endif
#if NH_N
        if (row_node[m] == N && m == row_first[N]) {
            TERMINAL_ROWS(s, h, J);
        }
#endif
        value[m] = ROW_VALUE(s, m, h, r);
    }
}
#endif
