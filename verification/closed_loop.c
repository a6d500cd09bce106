/* Times the closed loop of one package in C, with the package's own model as plant.
 * Compile with -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"'
 * -DQP_ITERATIONS=<member of the solver>. Arguments:
 *     runs steps dt period amplitude restart x0...  set_points [y... y_N...]...  pushes [u...]
 * Every `period` steps the plant restarts at x0 (1 + restart * U(-1, 1)) if restart > 0, amplitude * U(-1, 1) is added
 * to all states, the next set point becomes the reference of path and end (cyclically), and the plant runs for `pushes`
 * samples under u. Prints per run: median us of prepare + feedback and of feedback, failed steps, mean and maximum of
 * the QP iterations per step; then the total of the worst step, where the time of a step is its minimum over the runs,
 * which are all equal. */
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

enum { POINT = SIZE(_NY) + SIZE(_NY_N) };

typedef struct {
    int runs, steps, period, n_points, pushes;
    double dt, amplitude, restart;
    API(_real) x0[SIZE(_NX)], push[SIZE(_NU)];
    API(_real) *points; /* n_points rows (y, y_N) */
} scenario_t;

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

static char **take(char **argument, int n, API(_real) *out)
{
    int i;
    for (i = 0; i < n; i++) {
        out[i] = (API(_real))atof(argument[i]);
    }
    return argument + n;
}

static void read_scenario(scenario_t *c, char **argument)
{
    c->runs = atoi(*argument++);
    c->steps = atoi(*argument++);
    c->dt = atof(*argument++);
    c->period = atoi(*argument++);
    c->amplitude = atof(*argument++);
    c->restart = atof(*argument++);
    argument = take(argument, SIZE(_NX), c->x0);
    c->n_points = atoi(*argument++);
    c->points = malloc((size_t)(1 + c->n_points * POINT) * sizeof *c->points);
    argument = take(argument, c->n_points * POINT, c->points);
    c->pushes = atoi(*argument++);
    take(argument, c->pushes > 0 ? SIZE(_NU) : 0, c->push);
}

/* Events before step n, every `period` steps. */
static void event(const scenario_t *c, int n, API(_real) *x)
{
    int i;
    if (n % c->period != 0) {
        return;
    }
    for (i = 0; c->restart > 0.0 && i < SIZE(_NX); i++) {
        x[i] = c->x0[i] * (API(_real))(1.0 + c->restart * (2.0 * rand() / RAND_MAX - 1.0));
    }
    for (i = 0; i < SIZE(_NX); i++) {
        x[i] += (API(_real))(c->amplitude * (2.0 * rand() / RAND_MAX - 1.0));
    }
    if (c->n_points > 0) {
        const API(_real) *point = c->points + n / c->period % c->n_points * POINT;
#if SIZE(_NY) > 0 /* setters exist only for data of the problem */
        API(_set_reference)(&solver, SIZE(_ALL), point);
#endif
#if SIZE(_NY_N) > 0
        API(_set_terminal_reference)(&solver, point + SIZE(_NY));
#endif
    }
    for (i = 0; i < c->pushes; i++) {
        API(_integrate)(&solver, x, c->push, (API(_real))c->dt, x);
    }
}

/* The phases are functions of their own, so that callgrind can count between their entry and their return. */
__attribute__((noinline)) static void preparation(void)
{
    API(_prepare)(&solver);
}

__attribute__((noinline)) static int feedback_phase(const API(_real) *x, API(_real) *u)
{
    return API(_feedback)(&solver, x, u) != 0;
}

static void run(const scenario_t *c, double *total, double *feedback, double *least)
{
    API(_real) x[SIZE(_NX)], u[SIZE(_NU)];
    double iterations = 0.0;
    int failed = 0, most = 0, n, i;
    srand(1);
    for (i = 0; i < SIZE(_NX); i++) {
        x[i] = c->x0[i];
    }
    API(_init)(&solver);
    for (n = 0; n < c->steps; n++) {
        double start, middle, end;
        event(c, n, x);
        start = microseconds();
        preparation();
        middle = microseconds();
        failed += feedback_phase(x, u);
        end = microseconds();
        total[n] = end - start;
        feedback[n] = end - middle;
        least[n] = least[n] < total[n] ? least[n] : total[n];
        iterations += solver.QP_ITERATIONS;
        most = solver.QP_ITERATIONS > most ? solver.QP_ITERATIONS : most;
        API(_integrate)(&solver, x, u, (API(_real))c->dt, x);
    }
    qsort(total, (size_t)c->steps, sizeof *total, ascending);
    qsort(feedback, (size_t)c->steps, sizeof *feedback, ascending);
    printf("%.4f %.4f %d %.4f %d\n", total[c->steps / 2], feedback[c->steps / 2], failed, iterations / c->steps, most);
}

int main(int argc, char **argv)
{
    scenario_t c;
    double *total, *feedback, *least;
    int k;
    (void)argc;
    read_scenario(&c, argv + 1);
    total = malloc((size_t)c.steps * sizeof *total);
    feedback = malloc((size_t)c.steps * sizeof *feedback);
    least = malloc((size_t)c.steps * sizeof *least);
    for (k = 0; k < c.steps; k++) {
        least[k] = 1e30;
    }
    for (k = 0; k < c.runs; k++) {
        run(&c, total, feedback, least);
    }
    qsort(least, (size_t)c.steps, sizeof *least, ascending);
    printf("%.4f\n", least[c.steps - 1]);
    free(least);
    free(total);
    free(feedback);
    free(c.points);
    return 0;
}
