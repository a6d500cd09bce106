/* Replays a recorded closed loop as a process: one line per sample, the status of prepare(), that of feedback(), and u
 * in words of 32 bits, all hexadecimal. Contract: recording.h holds the inputs. */
#include "recording.h"

#include <stdint.h>
#include <stdio.h>
#include <string.h>

static solver_t solver;

static void sample(int k)
{
    real_t u[OUTPUTS];
    uint32_t words[sizeof u / sizeof(uint32_t)];
    before_sample(&solver, k);
    const status_t prepared = PREPARE(&solver);
    const status_t fed = CONTROL(&solver, recorded_x[k], u);
    (void)memcpy(words, u, sizeof u);
    printf("%x %x", (unsigned)prepared, (unsigned)fed);
    for (size_t i = 0; i < sizeof words / sizeof words[0]; i++) {
        printf(" %lx", (unsigned long)words[i]);
    }
    printf("\n");
}

int main(void)
{
    if (CALL(init)(&solver) != (status_t)0) {
        return 1;
    }
    for (int k = 0; k < SAMPLES; k++) {
        sample(k);
    }
    return 0;
}
