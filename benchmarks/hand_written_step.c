#include "hand_written_step.h"

#include <math.h>
#include <string.h>

#define DEGREE 4

static const double period_s = 1e-4;
static const double rate_scale_um_s = 800.0;
static const double c[DEGREE] = {1.40, -7.62e-2, 1.45e-2, -7.53e-4};
static const double r[PLAYS] = {0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0};
static const double b[PLAYS] = {1.10, -0.21, 0.04, -0.13, 0.02, -0.07, 0.03, -0.05, 0.01, -0.02};
static const double k[PLAYS] = {0.012, -0.003, 0.004, 0.001, -0.002, 0.006, -0.001, 0.002, -0.004, 0.003};

void hand_reset(hand_state *state)
{
    memset(state, 0, sizeof *state);
}

double hand_step(hand_state *state, double yd)
{
    if (isfinite(yd)) {
        state->last = yd;
    } else {
        state->held++;
        yd = state->last;
    }
    if (!state->started) {
        state->started = 1;
        state->y1 = yd;
        state->y2 = yd;
    }
    const double rate = (3.0 * (yd - state->y1) - (state->y1 - state->y2)) / (2.0 * period_s);
    state->y2 = state->y1;
    state->y1 = yd;

    double s = 0.0;
    for (int i = DEGREE - 1; i >= 0; i--) {
        s = (s + c[i]) * yd;
    }
    const double z = rate / rate_scale_um_s;
    double u = 0.0;
    for (int i = 0; i < PLAYS; i++) {
        double h = state->h[i];
        if (h > s + r[i]) {
            h = s + r[i];
        }
        if (h < s - r[i]) {
            h = s - r[i];
        }
        state->h[i] = h;
        u += (b[i] + k[i] * z) * h;
    }
    return u < 0.0 ? 0.0 : u > 10.0 ? 10.0 : u;
}
