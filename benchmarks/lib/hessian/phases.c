/* Times the phases of a sample of one package in C, with the package's own model as plant.
 * Compile with -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"' -DAT_STAGES=<1 if
 * blocks are regularised stage by stage>. Arguments: runs steps dt period restart x0...
 * Every `period` steps the plant restarts at x0 (1 + restart * U(-1, 1)). Prints per run the medians, us, of shift,
 * linearisation with second derivatives, regularisation (with the terminal block), condensing, feedback, and the
 * total. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include PACKAGE

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#undef API /* the package's own short name */
#define API(name) JOIN(NAME, name)
#define SIZE(name) JOIN(MACRO, name)

enum { TIMED_PHASES = 5, MOST_SAMPLES = 4096 };

static API(_solver_t) solver;
static double spent[TIMED_PHASES + 1][MOST_SAMPLES];

static double microseconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* One sample: prepare() and feedback(), phase by phase. */
static void sample(int n, const API(_real) *x, API(_real) *u)
{
    double at[TIMED_PHASES + 1];
    int i;
    at[0] = microseconds();
    if (n > 0) {
        API(_shift)(&solver);
    }
    at[1] = microseconds();
    linearize(&solver);
    at[2] = microseconds();
#if AT_STAGES
    hessian(&solver);
#endif
    at[3] = microseconds();
    condense_prepare(&solver);
    solver.prepared = 1;
    at[4] = microseconds();
    API(_feedback)(&solver, x, u);
    at[5] = microseconds();
    for (i = 0; i < TIMED_PHASES; i++) {
        spent[i][n] = at[i + 1] - at[i];
    }
    spent[TIMED_PHASES][n] = at[TIMED_PHASES] - at[0];
}

int main(int argc, char **argv)
{
    const int runs = atoi(argv[1]), steps = atoi(argv[2]), period = atoi(argv[4]);
    const double dt = atof(argv[3]), restart = atof(argv[5]);
    API(_real) x[SIZE(_NX)], u[SIZE(_NU)];
    int run, n, i;
    if (argc != 6 + SIZE(_NX) || steps > MOST_SAMPLES) {
        return 1;
    }
    for (run = 0; run < runs; run++) {
        srand(1);
        API(_init)(&solver);
        for (n = 0; n < steps; n++) {
            for (i = 0; n % period == 0 && i < SIZE(_NX); i++) {
                x[i] = (API(_real))(atof(argv[6 + i]) * (1.0 + restart * (2.0 * rand() / RAND_MAX - 1.0)));
            }
            sample(n, x, u);
            API(_integrate)(&solver, x, u, (API(_real))dt, x);
        }
        for (i = 0; i <= TIMED_PHASES; i++) {
            qsort(spent[i], (size_t)steps, sizeof spent[i][0], ascending);
            printf("%.4f ", spent[i][steps / 2]);
        }
        printf("\n");
    }
    return 0;
}
