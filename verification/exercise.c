/* Calls every function of one package with good and bad arguments and checks u0 after every return, for sanitizers.
 * The package defines API() and CONTROL_LOWER(); setters exist only for data of the problem. Compile with
 * -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"'; arguments: x0... Prints every finding. */
#include <stdio.h>
#include <stdlib.h>

#include PACKAGE

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define SIZE(name) JOIN(MACRO, name)
#define PADDED(name) (SIZE(name) > 0 ? SIZE(name) : 1)
#define EXPECT(condition) expect((condition) != 0, #condition, __LINE__)

typedef API(real) real;

static API(solver_t) s, twin;
static real x0[PADDED(_NX)], x[PADDED(_NX)], u[PADDED(_NU)];
static real large[PADDED(_NP) + PADDED(_NW) + PADDED(_NW_N) + PADDED(_NY) + PADDED(_NY_N)];
static int findings;

static void expect(int holds, const char *what, int line)
{
    if (!holds) {
        printf("line %d: %s\n", line, what);
        findings++;
    }
}

static void safe(int line)
{
    int j;
    for (j = 0; j < SIZE(_NU); j++) {
        const real low = CONTROL_LOWER(j), high = CONTROL_UPPER(j);
        expect(isfinite(u[j]) && u[j] >= low && u[j] <= high, "u0 finite and inside its bounds", line);
        u[j] = (real)NAN;
    }
}

static void fill(real value)
{
    size_t i;
    for (i = 0; i < sizeof large / sizeof *large; i++) {
        large[i] = value;
    }
}

/* Every function on a struct that is not initialised. */
static void uninitialised(void)
{
    API(kkt_t) residuals;
    memset(&s, 0x5a, sizeof s);
    EXPECT(API(feedback)(&s, x, u) == SIZE(_NOT_INITIALIZED) && isfinite(u[0]));
    EXPECT(API(step)(&s, x, u) == SIZE(_NOT_INITIALIZED) && isfinite(u[0]));
    EXPECT(API(prepare)(&s) == SIZE(_NOT_INITIALIZED));
    EXPECT(API(solve)(&s, x, (real)1e-3, 5) == SIZE(_NOT_INITIALIZED));
    EXPECT(API(shift)(&s) == SIZE(_NOT_INITIALIZED));
    EXPECT(API(reset)(&s) == SIZE(_NOT_INITIALIZED));
    EXPECT(isnan(API(cost)(&s)));
    API(kkt)(&s, &residuals);
    EXPECT(isinf(residuals.relative));
#if SIZE(_NY) > 0
    EXPECT(API(set_reference)(&s, SIZE(_ALL), large) == SIZE(_NOT_INITIALIZED));
    EXPECT(API(set_weight)(&s, SIZE(_ALL), large) == SIZE(_NOT_INITIALIZED));
#endif
#if SIZE(_NY_N) > 0
    EXPECT(API(set_terminal_reference)(&s, large) == SIZE(_NOT_INITIALIZED));
    EXPECT(API(set_terminal_weight)(&s, large) == SIZE(_NOT_INITIALIZED));
#endif
#if SIZE(_PARAMS) > 0
    EXPECT(API(set_parameter)(&s, 0, 0, large) == SIZE(_NOT_INITIALIZED));
#endif
#if SIZE(_NR) > 0
    EXPECT(API(set_bounds)(&s, 0, SIZE(_ALL), -1, 1) == SIZE(_NOT_INITIALIZED));
#endif
}

/* Ranges of nodes that do not exist, rows with a number that is not finite: nothing is written. */
static void refused_ranges(void)
{
    const int bad[][2] = { { -1, 1 }, { 0, 0 }, { 0, SIZE(_N) + 2 }, { SIZE(_N) + 1, 1 }, { 1, 1 << 30 } };
    int i;
    (void)bad;
    fill((real)1);
    for (i = 0; i < 5; i++) {
#if SIZE(_NY) > 0
        EXPECT(API(set_reference_range)(&s, bad[i][0], bad[i][1], large) == SIZE(_BAD_INDEX));
#endif
#if SIZE(_PARAMS) > 0
        EXPECT(API(set_parameter_range)(&s, 0, bad[i][0], bad[i][1], large) == SIZE(_BAD_INDEX));
        EXPECT(API(set_parameter_range)(&s, SIZE(_PARAMS), 0, 1, large) == SIZE(_BAD_INDEX));
#endif
    }
    fill((real)NAN);
#if SIZE(_NY) > 0
    EXPECT(API(set_reference_range)(&s, SIZE(_N), 1, large) == SIZE(_BAD_INDEX));
    EXPECT(API(set_reference_range)(&s, 0, 1, large) == SIZE(_BAD_ARGUMENT));
#endif
#if SIZE(_PARAMS) > 0
    EXPECT(API(set_parameter_range)(&s, 0, SIZE(_N), 1, large) == SIZE(_BAD_ARGUMENT));
#endif
}

/* Nodes that do not exist or have no data of their own; numbers that are not finite. */
static void refused_costs(void)
{
    const int far[] = { -2, SIZE(_N) + 1, 1 << 30, -(1 << 30) };
    int i;
    fill((real)1);
    for (i = 0; i < 4; i++) {
#if SIZE(_NY) > 0
        EXPECT(API(set_reference)(&s, far[i], large) == SIZE(_BAD_INDEX));
        EXPECT(API(set_weight)(&s, far[i], large) == SIZE(_BAD_INDEX));
#endif
#if SIZE(_PARAMS) > 0
        EXPECT(API(set_parameter)(&s, 0, far[i], large) == SIZE(_BAD_INDEX));
        EXPECT(API(set_parameter)(&s, far[i] + (far[i] > 0 ? SIZE(_PARAMS) : 0), 0, large) == SIZE(_BAD_INDEX));
        EXPECT(API(set_parameter)(&s, SIZE(_PARAMS), 0, large) == SIZE(_BAD_INDEX));
#endif
    }
#if SIZE(_NY) > 0
    EXPECT(API(set_reference)(&s, SIZE(_N), large) == SIZE(_BAD_INDEX));
    EXPECT(API(set_weight)(&s, 0, large) == SIZE(_BAD_INDEX));
#endif
    fill((real)NAN);
#if SIZE(_NY) > 0
    EXPECT(API(set_reference)(&s, 0, large) == SIZE(_BAD_ARGUMENT));
    EXPECT(API(set_weight)(&s, SIZE(_ALL), large) == SIZE(_BAD_ARGUMENT));
#endif
#if SIZE(_NY_N) > 0
    EXPECT(API(set_terminal_reference)(&s, large) == SIZE(_BAD_ARGUMENT));
    EXPECT(API(set_terminal_weight)(&s, large) == SIZE(_BAD_ARGUMENT));
#endif
#if SIZE(_PARAMS) > 0
    EXPECT(API(set_parameter)(&s, 0, SIZE(_ALL), large) == SIZE(_BAD_ARGUMENT));
#endif
}

#if SIZE(_NR) > 0
/* Rows and nodes that do not exist; bounds that are no interval. No data may change. */
static void refused_bounds(void)
{
    const int far[] = { -2, SIZE(_N) + 1, 1 << 30, -(1 << 30) };
    int i, row;
    for (i = 0; i < 4; i++) {
        EXPECT(API(set_bounds)(&s, 0, far[i], -1, 1) == SIZE(_BAD_INDEX));
        EXPECT(API(set_bounds)(&s, far[i] + (far[i] > 0 ? SIZE(_NR) : 0), SIZE(_ALL), -1, 1) == SIZE(_BAD_INDEX));
    }
    EXPECT(API(set_bounds)(&s, SIZE(_NR), SIZE(_ALL), -1, 1) == SIZE(_BAD_INDEX));
    for (row = 0; row < SIZE(_NR); row++) {
        const real low = s.lower[0][row], high = s.upper[0][row];
        EXPECT(API(set_bounds)(&s, row, SIZE(_ALL), 2, 1) == SIZE(_BAD_BOUNDS));
        EXPECT(API(set_bounds)(&s, row, SIZE(_ALL), (real)NAN, 1) == SIZE(_BAD_BOUNDS));
        EXPECT(API(set_bounds)(&s, row, SIZE(_ALL), 0, (real)NAN) == SIZE(_BAD_BOUNDS));
        EXPECT(API(set_bounds)(&s, row, SIZE(_ALL), (real)INFINITY, (real)INFINITY) == SIZE(_BAD_BOUNDS));
        EXPECT(API(set_bounds)(&s, row, 0, -1, 1) == SIZE(_BAD_INDEX) || SIZE(_N) == 0);
        EXPECT(s.lower[0][row] <= low && s.lower[0][row] >= low && s.upper[0][row] <= high && s.upper[0][row] >= high);
    }
}
#endif

/* All data set to their present values. */
static void accepted(void)
{
    int k, i;
#if SIZE(_NY) > 0
    for (k = 0; k < SIZE(_N); k++) {
        EXPECT(API(set_reference)(&s, k, s.yref[k]) == SIZE(_OK));
    }
    for (i = 0; i < SIZE(_NW); i++) {
        large[i] = ((const real *)s.W)[i];
    }
    EXPECT(API(set_weight)(&s, SIZE(_ALL), large) == SIZE(_OK));
#endif
#if SIZE(_NY_N) > 0
    EXPECT(API(set_terminal_reference)(&s, s.yref_N) == SIZE(_OK));
    for (i = 0; i < SIZE(_NW_N); i++) {
        large[i] = ((const real *)s.W_N)[i];
    }
    EXPECT(API(set_terminal_weight)(&s, large) == SIZE(_OK));
#endif
#if SIZE(_PARAMS) > 0
    for (i = 0; i < SIZE(_PARAMS); i++) {
        for (k = 0; k <= SIZE(_N); k++) {
            memcpy(large, &s.p[k][parameter_offset[i]],
                (size_t)(parameter_offset[i + 1] - parameter_offset[i]) * sizeof *large);
            EXPECT(API(set_parameter)(&s, i, k, large) == SIZE(_OK));
        }
    }
#endif
#if SIZE(_NR) > 0
    for (i = 0; i < SIZE(_NR); i++) {
        EXPECT(API(set_bounds)(&s, i, SIZE(_ALL), s.lower[0][i], s.upper[0][i]) == SIZE(_OK));
        k = API(set_bounds)(&s, i, SIZE(_N), s.lower[1][i], s.upper[1][i]);
        EXPECT(k == SIZE(_OK) || k == SIZE(_BAD_INDEX));
    }
#endif
}

/* A closed loop with occasional bad samples: it must continue, and a copy must give the same results. */
static void loop(void)
{
    API(kkt_t) kkt;
    int n, i;
    memcpy(x, x0, sizeof x);
    for (n = 0; n < 30; n++) {
        const int bad = n % 7 == 6;
        real before[PADDED(_NU)];
        if (bad) {
            x[n % SIZE(_NX)] = (n % 2) ? (real)NAN : (real)INFINITY;
        }
        twin = s;
        EXPECT(API(step)(&twin, x, u) >= SIZE(_OK));
        memcpy(before, u, sizeof u);
        i = API(step)(&s, x, u);
        EXPECT(!bad || i == SIZE(_NOT_FINITE));
        EXPECT(memcmp(before, u, sizeof u) == 0);
        if (bad) {
            memcpy(x, x0, sizeof x);
        }
        memcpy(before, u, sizeof u);
        safe(__LINE__);
        API(integrate)(&s, x, before, (real)0.05, x);
        EXPECT(n % 11 != 10 || API(shift)(&s) == SIZE(_OK));
    }
    API(kkt)(&s, &kkt);
    EXPECT(isfinite(kkt.stationarity) && isfinite(kkt.equality) && isfinite(API(cost)(&s)));
}

static void poison(void)
{
    int k, i;
    for (k = 0; k <= SIZE(_N); k++) {
        for (i = 0; i < SIZE(_NX); i++) {
            s.x[k][i] = s.lam[k][i] = (real)NAN;
        }
        for (i = 0; k < SIZE(_N) && i < SIZE(_NU); i++) {
            s.u[k][i] = s.mu_u[k][i] = (real)NAN;
        }
    }
}

/* The iterate overwritten with NaN: controls are safe; the next sample, solve() and reset restore the plan. */
static void poisoned(void)
{
    poison();
    EXPECT(API(step)(&s, x0, u) == SIZE(_NUMERICAL_FAILURE));
    safe(__LINE__);
    EXPECT(API(step)(&s, x0, u) == SIZE(_OK));
    safe(__LINE__);
    poison();
    EXPECT(API(solve)(&s, x0, (real)1e-3, 20) == SIZE(_OK));
    poison();
    EXPECT(API(reset)(&s) == SIZE(_OK));
    EXPECT(API(step)(&s, x0, u) == SIZE(_OK));
    safe(__LINE__);
}

int main(int argc, char **argv)
{
    int i;
    for (i = 0; i < SIZE(_NX) && i + 1 < argc; i++) {
        x[i] = x0[i] = (real)atof(argv[1 + i]);
    }
    uninitialised();
    EXPECT(API(init)(&s) == SIZE(_OK));
    EXPECT(API(feedback)(&s, x, u) == SIZE(_NOT_PREPARED));
    safe(__LINE__);
    refused_costs();
    refused_ranges();
#if SIZE(_NR) > 0
    refused_bounds();
#endif
    accepted();
    EXPECT(API(solve)(&s, x0, (real)0, 5) == SIZE(_BAD_ARGUMENT));
    EXPECT(API(solve)(&s, x0, (real)1e-3, -1) == SIZE(_BAD_ARGUMENT));
    EXPECT(API(solve)(&s, x0, (real)1e-3, 0) == SIZE(_ITERATION_LIMIT));
    EXPECT(API(solve)(&s, x0, (real)1e-3, 50) == SIZE(_OK));
    EXPECT(API(reset)(&s) == SIZE(_OK));
    loop();
    poisoned();
    for (i = -2; i < 20; i++) {
        EXPECT(API(status_string)((API(status_t))(i & 15))[0] != '\0');
    }
    return findings != 0;
}
