/* Reads measured states, one per line, and prints the status and the control of one step for each.
 * Compile with -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"'. */
#include <stdio.h>

#include PACKAGE

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#undef API /* the package's own short name */
#define API(name) JOIN(NAME, name)
#define SIZE(name) JOIN(MACRO, name)

static API(_solver_t) solver;

int main(void)
{
    API(_real) x[SIZE(_NX)], u[SIZE(_NU)];
    double value;
    int count = 0;
    API(_init)(&solver);
    while (scanf("%lf", &value) == 1) {
        x[count++] = (API(_real))value;
        if (count == SIZE(_NX)) {
            count = 0;
            printf("%d", (int)API(_step)(&solver, x, u));
            for (int i = 0; i < SIZE(_NU); i++) {
                printf(" %.17g", (double)u[i]);
            }
            printf("\n");
        }
    }
    return 0;
}
