"""The program that tests the C of a compensator on its target, against the numbers of the Python step."""

import math

from torchpi.control.step import CompensatorStream

SAMPLES = 600
NOT_FINITE = (250, 251, 420)  # samples at which the input is not a number


def selftest(stream: CompensatorStream, name: str) -> str:
    """C text of NAME_selftest.c: exit code 0 if the step gives the recorded numbers."""
    yd = inputs(stream)
    stream.reset()
    u = [stream.step(math.nan if k in NOT_FINITE else sample) for k, sample in enumerate(yd)]
    return f"""\
/* Tests {name}.c against numbers recorded by torchpi: to the last bit, or to 1e-5 of the output range with
 * {name}_FLOAT32. Exit code 0 if they agree.
 *
 *     cc -std=c99 -ffp-contract=off -O2 {name}.c {name}_selftest.c -o {name}_selftest
 */
#include "{name}.h"

#include <stdio.h>

#define SAMPLES {SAMPLES}

#ifdef {name}_FLOAT32
static const double tolerance_v = 1e-5 * ({name}_MAX_VOLTAGE_V - ({name}_MIN_VOLTAGE_V));
#else
static const double tolerance_v = 0.0;
#endif

static const size_t not_finite[] = {{{", ".join(str(k) for k in NOT_FINITE)}}};

static const double recorded_yd[SAMPLES] = {{ /* um */
{_table(yd)}
}};

static const double recorded_u[SAMPLES] = {{ /* V */
{_table(u)}
}};

static int agrees(const char *what, const double *u)
{{
    int wrong = 0;
    double largest = 0.0;
    for (size_t k = 0; k < SAMPLES; k++) {{
        const double difference = u[k] > recorded_u[k] ? u[k] - recorded_u[k] : recorded_u[k] - u[k];
        wrong += !(difference <= tolerance_v);
        largest = difference > largest ? difference : largest;
    }}
    printf("{name} %s: %s, %d of %d samples differ, by up to %g V\\n", what, wrong ? "FAIL" : "pass", wrong,
           SAMPLES, largest);
    return wrong == 0;
}}

int main(void)
{{
    static double yd[SAMPLES], u[SAMPLES];
    {name}_state state, other;
    volatile double zero = 0.0;
    int good = 1;

    for (size_t k = 0; k < SAMPLES; k++) {{
        yd[k] = recorded_yd[k];
    }}
    for (size_t i = 0; i < sizeof not_finite / sizeof *not_finite; i++) {{
        yd[not_finite[i]] = zero / zero;
    }}
    {name}_reset(&state);
    {name}_reset(&other);
    for (size_t k = 0; k < SAMPLES; k++) {{
        u[k] = {name}_step(&state, yd[k]);
        (void){name}_step(&other, recorded_yd[SAMPLES - 1 - k]);
    }}
    good &= agrees("step", u);
    {name}_reset(&state);
    {name}_block(&state, yd, u, SAMPLES);
    good &= agrees("block", u);
    if (state.held_inputs != {len(NOT_FINITE)}) {{
        printf("{name} held_inputs: FAIL, %lu\\n", (unsigned long)state.held_inputs);
        good = 0;
    }}
    return good ? 0 : 1;
}}
"""


def inputs(stream: CompensatorStream) -> list[float]:
    """Samples in µm that take the output through its range: large and small loops, slow, fast, and rest."""
    amplitude_um = 2.0**-10
    # Doubled until the limits are met, or nothing on the way to them is (a weight may be zero).
    while amplitude_um < 2.0**20 and not _at_a_limit(stream, amplitude_um):
        amplitude_um *= 2.0
    return _motion(amplitude_um)


def _motion(amplitude_um: float) -> list[float]:
    slow = [0.5 - 0.5 * math.cos(math.pi * k / 150) for k in range(SAMPLES - 100)]
    fast = [
        0.12 * math.sin(math.pi * k / 14) + 0.01 * math.sin(math.pi * k / 3) for k in range(SAMPLES - 100)
    ]
    moving = [amplitude_um * (a + b) for a, b in zip(slow, fast, strict=True)]
    return moving + [moving[-1]] * 40 + [sample / 2 for sample in moving[:60]]


def _at_a_limit(stream: CompensatorStream, amplitude_um: float) -> bool:
    stream.reset()
    voltages = [stream.step(sample) for sample in _motion(amplitude_um)[:200:3]]
    return max(voltages) >= stream.max_voltage_v


def _table(values: list[float]) -> str:
    texts = [value.hex() for value in values]
    return "\n".join(f"    {', '.join(texts[i : i + 4])}," for i in range(0, len(texts), 4))
