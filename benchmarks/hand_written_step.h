/* The step of eq. 8 as one writes it by hand, to compare the generated one with. */
#ifndef HAND_WRITTEN_STEP_H
#define HAND_WRITTEN_STEP_H

#define PLAYS 10

typedef struct {
    double h[PLAYS];
    double y1, y2, last;
    unsigned long held;
    int started;
} hand_state;

void hand_reset(hand_state *state);
double hand_step(hand_state *state, double yd);

#endif
