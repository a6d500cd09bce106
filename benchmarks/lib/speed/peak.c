/* Prints the largest rate, in Gflop/s, of independent multiplications and additions in vectors of BYTES bytes. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>

typedef double vector_t __attribute__((vector_size(BYTES)));

enum { CHAINS = 12, PASSES = 20000, RUNS = 200, LANES = BYTES / 8 };

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(void)
{
    vector_t sum[CHAINS], a, b;
    double best = 1e30, check = 0.0;
    for (int i = 0; i < LANES; i++) {
        a[i] = 0.999999 + 1e-9 * i;
        b[i] = 1e-6;
        for (int c = 0; c < CHAINS; c++) {
            sum[c][i] = c + i;
        }
    }
    for (int run = 0; run < RUNS; run++) {
        const double start = seconds();
        for (int pass = 0; pass < PASSES; pass++) {
#pragma GCC unroll 12
            for (int c = 0; c < CHAINS; c++) {
                sum[c] = sum[c] * a + b;
            }
        }
        const double time = seconds() - start;
        best = time < best ? time : best;
    }
    for (int c = 0; c < CHAINS; c++) {
        for (int i = 0; i < LANES; i++) {
            check += sum[c][i];
        }
    }
    printf("%.6f %g\n", 2e-9 * CHAINS * LANES * PASSES / best, check);
    return 0;
}
