/* Reference kernel for times: 30 Cholesky factorisations of a 20 x 20 matrix, each with a substitution: dense loops of
 * multiplications, additions, divisions and square roots, as in a sample. Prints the least time of 2000 runs, us. */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <time.h>

enum { SIZE = 20, COUNT = 30, RUNS = 2000 };

static void solve(double A[SIZE][SIZE], double x[SIZE])
{
    for (int j = 0; j < SIZE; j++) {
        for (int i = j; i < SIZE; i++) {
            double sum = i == j ? SIZE : 1.0 / (1.0 + i + j);
            for (int k = 0; k < j; k++) {
                sum -= A[i][k] * A[j][k];
            }
            A[i][j] = i == j ? sqrt(sum) : sum / A[j][j];
        }
        x[j] = 1.0;
        for (int k = 0; k < j; k++) {
            x[j] -= A[j][k] * x[k];
        }
        x[j] /= A[j][j];
    }
}

int main(void)
{
    static double A[SIZE][SIZE], x[SIZE];
    double best = 1e9;
    for (int run = 0; run < RUNS; run++) {
        struct timespec start, end;
        clock_gettime(CLOCK_MONOTONIC, &start);
        for (int k = 0; k < COUNT; k++) {
            solve(A, x);
        }
        clock_gettime(CLOCK_MONOTONIC, &end);
        const double taken = 1e6 * (double)(end.tv_sec - start.tv_sec) + 1e-3 * (double)(end.tv_nsec - start.tv_nsec);
        best = taken < best ? taken : best;
    }
    printf("%.3f %.17g\n", best, x[SIZE - 1]);
    return 0;
}
