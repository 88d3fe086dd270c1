/* Generated and hand-written steps in one C loop, in turn: time_c_steps BLOCKS. Prints, for each, the time of a
 * step in every block of 100 steps, in ns, one a line; or where the two differ, and exit code 1. Compiled with
 * -DOLDER, the step of an older version as well. */
#define _POSIX_C_SOURCE 199309L

#include "generated.h"
#include "hand_written_step.h"
#ifdef OLDER
#include "older.h"
#endif

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define STEPS 100

static double now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    const long blocks = argc > 1 ? atol(argv[1]) : 1000;
    static double yd[STEPS], of_generated[STEPS], of_hand[STEPS];
    generated_state generated;
    hand_state hand;
    generated_reset(&generated);
    hand_reset(&hand);
#ifdef OLDER
    static double of_older[STEPS];
    older_state older;
    older_reset(&older);
#endif
    for (long block = 0; block < blocks; block++) {
        for (int i = 0; i < STEPS; i++) {
            const double k = (double)(block * STEPS + i);
            yd[i] = 4.0 - 3.5 * cos(0.02 * k) + 0.3 * sin(0.31 * k);
        }
        const double start = now_ns();
        for (int i = 0; i < STEPS; i++) {
            of_generated[i] = generated_step(&generated, yd[i]);
        }
        const double between = now_ns();
        for (int i = 0; i < STEPS; i++) {
            of_hand[i] = hand_step(&hand, yd[i]);
        }
        const double end = now_ns();
#ifdef OLDER
        for (int i = 0; i < STEPS; i++) {
            of_older[i] = older_step(&older, yd[i]);
        }
        const double end_of_older = now_ns();
#endif
        for (int i = 0; i < STEPS; i++) {
            if (of_generated[i] != of_hand[i]) {
                printf("sample %ld: generated %.17g V, by hand %.17g V\n", block * STEPS + i, of_generated[i],
                       of_hand[i]);
                return 1;
            }
        }
        printf("%.4f %.4f", (between - start) / STEPS, (end - between) / STEPS);
#ifdef OLDER
        printf(" %.4f", (end_of_older - end) / STEPS);
#endif
        printf("\n");
    }
    return 0;
}
