/* Times the factorisation of the stage QP of one package, at the working set of its second sample.
 * Compile with -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"'; arguments: x0... Prints the least time in us. */
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

enum { RUNS = 400, REPEATS = 10 };

static API(_solver_t) solver;

static double microseconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    API(_real) x[SIZE(_NX)], u[SIZE(_NU)];
    double best = 1e30;
    if (argc != 1 + SIZE(_NX)) {
        return 2;
    }
    for (int i = 0; i < SIZE(_NX); i++) {
        x[i] = (API(_real))atof(argv[1 + i]);
    }
    API(_init)(&solver);
    if (API(_step)(&solver, x, u) != 0 || API(_prepare)(&solver) != 0) {
        return 1;
    }
    for (int run = 0; run < RUNS; run++) {
        const double start = microseconds();
        for (int i = 0; i < REPEATS; i++) {
            if (!riccati_factorize(&solver, SIZE(_N))) {
                return 1;
            }
        }
        const double time = (microseconds() - start) / REPEATS;
        best = time < best ? time : best;
    }
    printf("%.4f\n", best);
    return 0;
}
