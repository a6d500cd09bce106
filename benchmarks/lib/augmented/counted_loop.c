/* The closed loop of loop.py in C, for callgrind: only sample() is counted. Arguments: factors of X, S, P before sample
 * 80. Prints the mean feed of the last 20 samples. */
#include <stdio.h>
#include <stdlib.h>

#include PACKAGE

enum { SAMPLES = 160, JUMP = 80, LAST = 20, PERIODS = 6, HIGH = 7, PARTS = 20 };

__attribute__((noinline, noclone)) static void sample(bioreactor_solver_t *s, const double *x, double *u)
{
    (void)bioreactor_step(s, x, u);
}

/* x after `time` hours in `parts` calls. */
static void plant(bioreactor_solver_t *s, double *x, const double *u, double time, int parts)
{
    for (int part = 0; part < parts; part++) {
        double next[BIOREACTOR_NX];
        (void)bioreactor_integrate(s, x, u, time / parts, next);
        for (int i = 0; i < BIOREACTOR_NX; i++) {
            x[i] = next[i];
        }
    }
}

/* The plan on the orbit of a 40/28.7 feed after some periods. */
static void start(bioreactor_solver_t *s, double *x)
{
    for (int period = 0; period < PERIODS; period++) {
        x[3] = x[4] = 0.0;
        for (int k = 0; k < BIOREACTOR_N; k++) {
            s->u[k][0] = k < HIGH ? 40.0 : 28.7;
            for (int i = 0; i < BIOREACTOR_NX; i++) {
                s->x[k][i] = x[i];
            }
            plant(s, x, s->u[k], 2.4, 1);
        }
    }
    for (int i = 0; i < BIOREACTOR_NX; i++) {
        s->x[BIOREACTOR_N][i] = x[i];
        x[i] = s->x[0][i];
    }
}

int main(int argc, char **argv)
{
    static bioreactor_solver_t s;
    double x[BIOREACTOR_NX] = {5.8, 18.0, 20.5, 0.0, 0.0}, u[BIOREACTOR_NU], feed = 0.0;
    (void)bioreactor_init(&s);
    start(&s, x);
    for (int n = 0; n < SAMPLES; n++) {
        for (int i = 0; n == JUMP && i + 1 < argc; i++) {
            x[i] *= atof(argv[i + 1]);
        }
        x[3] = x[4] = 0.0;
        sample(&s, x, u);
        feed += n >= SAMPLES - LAST ? u[0] / LAST : 0.0;
        plant(&s, x, u, 2.4, PARTS);
    }
    printf("%.17g\n", feed);
    return 0;
}
