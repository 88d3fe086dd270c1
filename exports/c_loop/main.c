/* A control loop with an exported compensator: loop [TRAJECTORY.csv]
 *
 * For `torchpi export RUN --to c --output exports/demo`; put your name in place of `demo`. Prints the desired
 * displacement and the voltage of each tick, and at last the time of a step. In place of printf stands the
 * converter. A trajectory is a CSV with the columns time_s,yd_um, sampled at the compensator's period.
 */
#include "demo.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define LONGEST 1000000

static double yd[LONGEST + demo_PREVIEW], u[LONGEST];

/* The motion that is wanted, known ahead: a 5 Hz sine, 0 ... 4 um. */
static size_t generated(size_t samples)
{
    for (size_t k = 0; k < samples; k++) {
        yd[k] = 2 - 2 * cos(2 * 3.14159265358979323846 * 5 * (double)k * demo_SAMPLE_PERIOD_S);
    }
    return samples;
}

static size_t from_file(const char *path)
{
    char line[256];
    size_t samples = 0;
    FILE *file = fopen(path, "r");
    if (file == NULL || fgets(line, sizeof line, file) == NULL) {
        fprintf(stderr, "loop: %s: no such file, or empty, want columns time_s,yd_um\n", path);
        exit(2);
    }
    while (samples < LONGEST && fgets(line, sizeof line, file) != NULL) {
        double time_s;
        if (sscanf(line, "%lf,%lf", &time_s, &yd[samples]) != 2) {
            fprintf(stderr, "loop: %s: row %lu: want time_s,yd_um\n", path, (unsigned long)samples + 2);
            exit(2);
        }
        samples++;
    }
    fclose(file);
    return samples;
}

int main(int argc, char **argv)
{
    const size_t samples = argc > 1 ? from_file(argv[1]) : generated(2000);
    demo_state state;

    /* After the last sample the trajectory rests. */
    for (size_t k = samples; samples > 0 && k < samples + demo_PREVIEW; k++) {
        yd[k] = yd[samples - 1];
    }

    demo_reset(&state);
    const clock_t start = clock();
    for (size_t tick = 0; tick < samples; tick++) {
        u[tick] = demo_step(&state, yd[tick + demo_PREVIEW]);
    }
    const clock_t end = clock();

    for (size_t tick = 0; tick < samples; tick++) {
        printf("%.6f s  %.6f um  %.17g V\n", (double)tick * demo_SAMPLE_PERIOD_S, yd[tick], u[tick]);
    }
    fprintf(stderr, "%lu steps, %.3f us each\n", (unsigned long)samples,
            samples > 0 ? 1e6 * (double)(end - start) / CLOCKS_PER_SEC / (double)samples : 0.0);
    return 0;
}
