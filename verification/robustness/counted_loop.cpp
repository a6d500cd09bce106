// Counts the operations of every sample of a recorded loop: additions, multiplications, divisions, roots and calls of math.h.
// Compile as C++ with -DNAME=<prefix> -DMACRO=<PREFIX> -DPACKAGE='"<prefix>.c"', the package's real type being counted.
// Input: how many rows are opened, their numbers; then per sample 1 y... y_N... or 0, and the measured state.
// Prints per sample, prepare and feedback or step: status, these operations, all with comparisons and signs, u0...
#include "counting.hpp"
#include PACKAGE
#include <stdio.h>

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#undef API // the package's own short name
#define API(name) JOIN(NAME, name)
#define SIZE(name) JOIN(MACRO, name)

static API(_solver_t) solver;

static bool take(int n, counted *out)
{
    double value;
    for (int i = 0; i < n; i++) {
        if (scanf("%lf", &value) != 1) {
            return false;
        }
        out[i] = counted(value);
    }
    return true;
}

static bool take_set_point()
{
    int given = 0;
    counted y[SIZE(_NY) + SIZE(_NY_N) + 1];
    if (scanf("%d", &given) != 1 || (given && !take(SIZE(_NY) + SIZE(_NY_N), y))) {
        return false;
    }
#if SIZE(_NY) > 0 // setters of data that the problem lacks do not exist
    if (given) {
        API(_set_reference)(&solver, SIZE(_ALL), y);
    }
#endif
#if SIZE(_NY_N) > 0
    if (given) {
        API(_set_terminal_reference)(&solver, y + SIZE(_NY));
    }
#endif
    return true;
}

static void open_rows()
{
    int rows = 0, row = 0;
    if (scanf("%d", &rows) != 1) {
        return;
    }
    while (rows-- > 0 && scanf("%d", &row) == 1) {
#if SIZE(_NR) > 0
        API(_set_bounds)(&solver, row, SIZE(_ALL), counted(-INFINITY), counted(INFINITY));
#endif
    }
}

int main()
{
    counted x[SIZE(_NX)], u[SIZE(_NU)];
    API(_init)(&solver);
    open_rows();
    while (take_set_point() && take(SIZE(_NX), x)) {
        counted::reset();
#ifdef ONE_CALL // the algorithm has no phases
        const int prepared = 0, status = (int)API(_step)(&solver, x, u);
#else
        const int prepared = (int)API(_prepare)(&solver);
        const int status = (int)API(_feedback)(&solver, x, u);
#endif
        const long operations = counted::add + counted::mul + counted::div + counted::sqrt + counted::call;
        printf("%d %ld %ld", prepared ? prepared : status, operations, operations + counted::other);
        for (int j = 0; j < SIZE(_NU); j++) {
            printf(" %.17g", u[j].value);
        }
        printf("\n");
    }
    return 0;
}
