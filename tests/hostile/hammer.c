/* Steps of an exported compensator `demo` under hostile inputs: hammer STEPS. Exit code 1 for a voltage that is
 * not finite or not within the limits. */
#include "demo.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t state = 88172645463325252u;

static uint64_t random_bits(void) /* xorshift64, Marsaglia 2003 */
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static double uniform(void)
{
    return (double)(random_bits() >> 11) / 9007199254740992.0;
}

static double hostile(double yd)
{
    const uint64_t bits = random_bits();
    double any;
    switch (random_bits() % 16) {
    case 0:
        memcpy(&any, &bits, sizeof any);
        return any;
    case 1:
        return uniform() < 0.5 ? 0.0 : -0.0;
    case 2:
        return 5e-324;
    case 3:
        return (uniform() - 0.5) * 1e3;
    case 4:
        return (uniform() - 0.5) * 1e308;
    case 5:
        return -2.0 + 12.0 * uniform();
    default:
        return yd;
    }
}

int main(int argc, char **argv)
{
    const long steps = argc > 1 ? atol(argv[1]) : 100000;
    demo_state step;
    double yd = 0.0, rate = 0.1;
    demo_reset(&step);
    for (long k = 0; k < steps; k++) {
        yd += rate;
        rate = yd > 8.0 ? -0.1 : yd < 0.0 ? 0.1 : rate;
        if (random_bits() % 5000 == 0) {
            (void)demo_reset_at(&step, hostile(yd));
        }
        if (random_bits() % 5000 == 0) {
            (void)demo_reset_at_voltage(&step, hostile(yd));
        }
        const double u = demo_step(&step, hostile(yd));
        if (!(u >= demo_MIN_VOLTAGE_V && u <= demo_MAX_VOLTAGE_V)) {
            printf("step %ld: %.17g V\n", k, u);
            return 1;
        }
    }
    return 0;
}
