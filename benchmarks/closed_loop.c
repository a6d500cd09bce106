/* Times the closed loop of one package in C, the package's own model as plant.
 * Compile with -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"'; arguments: runs steps period amplitude x0...
 * Every `period` steps all states are disturbed by amplitude * U(-1, 1). Prints per run: median us of prepare + feedback,
 * of feedback, the largest total, failed steps, QP iterations per step. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include PACKAGE

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define API(name) JOIN(NAME, name)
#define SIZE(name) JOIN(MACRO, name)

static API(_solver_t) solver;

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

int main(int argc, char **argv)
{
    const int runs = atoi(argv[1]), steps = atoi(argv[2]), period = atoi(argv[3]);
    const double amplitude = atof(argv[4]);
    double *total = malloc((size_t)steps * sizeof *total), *feedback = malloc((size_t)steps * sizeof *feedback);
    int run, n, i;
    (void)argc;
    for (run = 0; run < runs; run++) {
        API(_real) x[SIZE(_NX)], u[SIZE(_NU)];
        int failed = 0;
        double iterations = 0.0;
        srand(1);
        for (i = 0; i < SIZE(_NX); i++) {
            x[i] = (API(_real))atof(argv[5 + i]);
        }
        API(_init)(&solver);
        for (n = 0; n < steps; n++) {
            double start, middle, end;
            for (i = 0; n % period == 0 && i < SIZE(_NX); i++) {
                x[i] += (API(_real))(amplitude * (2.0 * rand() / RAND_MAX - 1.0));
            }
            start = microseconds();
            API(_prepare)(&solver);
            middle = microseconds();
            failed += API(_feedback)(&solver, x, u) != 0;
            end = microseconds();
            total[n] = end - start;
            feedback[n] = end - middle;
            iterations += solver.stats.qp_iterations;
            API(_integrate)(&solver, x, u, interval_length[0], x);
        }
        qsort(total, (size_t)steps, sizeof *total, ascending);
        qsort(feedback, (size_t)steps, sizeof *feedback, ascending);
        printf("%.4f %.4f %.4f %d %.4f\n", total[steps / 2], feedback[steps / 2], total[steps - 1], failed, iterations / steps);
    }
    free(total);
    free(feedback);
    return 0;
}
