/* Times the QP of one package in C: both phases of the solver on data that are already in the struct.
 * Compile as a shared library with -DNAME=<prefix> -DPACKAGE='"<prefix>.c"'. */
#define _POSIX_C_SOURCE 199309L
#include <string.h>
#include <time.h>

#include PACKAGE

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#undef API /* the package's own short name */
#define API(name) JOIN(NAME, name)

int size_of_timed(void);
void init_timed(API(_solver_t) * s);
int run_timed_qp(API(_solver_t) * s, const API(_real) * dx0);
double time_qp(API(_solver_t) * s, const API(_solver_t) * before, const API(_real) * dx0, int repeats, int cold);
double time_condensing(API(_solver_t) * s, int repeats);

static double microseconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

int size_of_timed(void)
{
    return (int)sizeof(API(_solver_t));
}

void init_timed(API(_solver_t) * s)
{
    (void)API(_init)(s);
}

int run_timed_qp(API(_solver_t) * s, const API(_real) * dx0)
{
    const int status = (int)condense_prepare(s);
    memcpy(s->step.dx[0], dx0, sizeof s->step.dx[0]);
    return status ? status : (int)condense_solve(s);
}

/* Minimum time (us) of both phases, from the working set that `before` predicts or from none. Negative: not solved. */
double time_qp(API(_solver_t) * s, const API(_solver_t) * before, const API(_real) * dx0, int repeats, int cold)
{
    double least = 1e30;
    int i;
    for (i = 0; i < repeats; i++) {
        double start, end;
        int status;
        *s = *before;
        if (cold) {
            condense_init(s);
        }
        start = microseconds();
        status = run_timed_qp(s, dx0);
        end = microseconds();
        if (status) {
            return -1.0;
        }
        least = (end - start < least) ? end - start : least;
    }
    return least;
}

#ifdef FULL_CONDENSING
/* Minimum time (us) of full condensing: Hessian, gradient, rows. */
double time_condensing(API(_solver_t) * s, int repeats)
{
    double least = 1e30;
    int i;
    for (i = 0; i < repeats; i++) {
        double start = microseconds(), end;
        condense_matrices(s);
        condense_rows(s);
        end = microseconds();
        least = (end - start < least) ? end - start : least;
    }
    return least;
}
#endif
