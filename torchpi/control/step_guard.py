"""The guard before and after every deployed step: no input may harm the stage or the state.

Before the equations, `accept` decides which desired displacement is used:

    inside the trained range, and no faster than trained       used as it is
    inside the accepted range, in a step that is not too long   used, counted in `outside_range`
    a jump                                      held until four more samples confirm it, then followed at the
                                                largest accepted rate and counted in `outside_range`
    outside the accepted range, inf, NaN        replaced by the last accepted one, counted in `held_inputs`
    a sudden step, longer than the one before   used as far as the turning points so far, and counted in
    by more than a trained one, and what        `held_inputs` where it lies beyond them, until four samples in
    follows it                                  a row have made no such step
    a sharp step, longer than the one before    used beyond the turning points so far by no more than that,
    by more than 4 trained accelerations make   and counted in `held_inputs`
    it, or 1 % of the trained range
    a first sample outside the trained range    held until four more samples confirm it

Wide plays remember the outermost turning points of a motion until they are reset, including any stray sample
beyond them: only samples that agree with their neighbours may set a new one. Thus every input of the
equations is finite, bounded, and of bounded rate, and held samples leave no trace in the memory of hysteresis
and creep. The derivatives of a lead are formed from four samples and would amplify a jump, or the step after
a held sample, many times before it reaches the plays. Therefore `smooth` counts the samples since the last
one that was held or moved faster than trained, and leads wait for four of them. Meanwhile the plays' input
keeps its value, as far as the lead of the trained rates and accelerations allows: without a lead it could
pass the turning points of the motion, which wide plays never forget. Likewise, a lead sets no turning point
where the acceleration exceeds the trained one.

After the equations, `emit` limits the voltage and, on request, its change, and counts this in
`limited_outputs`. States do not wind up: beyond the trained range, except for one per cent, only what the
voltage limits can reach is accepted, so that there is no saturated stretch for the states to integrate.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torchpi.control.reach import Reach
from torchpi.control.trained_motions import TrainedMotions

BEYOND_RANGE = 0.25  # of the trained range, accepted on either side of it: 1.5 times the trained range
BEYOND_RATE = 4.0  # accepted multiple of the largest trained rate and, beyond turning points, acceleration
NOISE = 0.01  # of the trained range, accepted beyond it whatever the reach, and from sample to sample
CONFIRMATIONS = 4  # samples that lie within an accepted step of the one before
BEYOND_REACH = 2.0  # accepted multiple of the largest displacement within reach if the training is not known

# Numbers that stay double in C compiled for float, so that comparisons come out alike in both.
IN_DOUBLE = frozenset(
    "yd aim_v last_input last_sample start_trained_um lowest_um highest_um change_um last_change_um "
    "taken_um longest_um further_um sharp_um step_um start_um least_accepted_um largest_accepted_um "
    "least_trained_um largest_trained_um trained_step_um largest_step_um least_um largest_um middle_um "
    "voltage_v start_v min_voltage_v max_voltage_v max_change_v last_voltage slower_v faster_v bounded_v "
    "least_v largest_v least_trained_um_s2 largest_trained_um_s2".split()
)

# Called for few samples, so kept out of line in C: compilers would otherwise take the step to be large.
OUT_OF_LINE = frozenset(["accept_beyond", "within_turning_points"])


@dataclass(frozen=True)
class StepLimits:
    """Limits that the guard applies.

    Attributes:
        accepted_um: Least and largest desired displacement that is accepted, µm.
        largest_step_um: Longest step from one accepted sample to the next, µm.
        trained_um: Trained range, µm; the accepted one if the training is not known.
        trained_step_um: Longest step from sample to sample at the trained rates, µm.
        sharp_um: Longest accepted change from one step to the next where the next sets a turning point, µm.
        min_voltage_v: Lower output limit.
        max_voltage_v: Upper output limit.
        max_change_v: Largest change of the output from sample to sample; None for any.
    """

    accepted_um: tuple[float, float]
    largest_step_um: float
    trained_um: tuple[float, float]
    trained_step_um: float
    sharp_um: float
    min_voltage_v: float
    max_voltage_v: float
    max_change_v: float | None = None


def step_limits(
    sample_period_s: float,
    voltages_v: tuple[float, float],
    reach: Reach,
    typical_um: float = 0.0,
    trained: TrainedMotions | None = None,
    max_slew_v_s: float | None = None,
) -> StepLimits:
    """Return the limits of a step for this training, or for an unknown one.

    Args:
        sample_period_s: T.
        voltages_v: Output limits.
        reach: Displacements that are reached within them.
        typical_um: A typical displacement, used if the training is not known.
        trained: Ranges of the training; None if they are not known.
        max_slew_v_s: Largest rate of the output voltage, V/s; None for any.
    """
    change = None if max_slew_v_s is None else max_slew_v_s * sample_period_s
    if trained is None:
        largest = BEYOND_REACH * max(abs(reach.low_um), abs(reach.high_um), abs(typical_um))
        return StepLimits(
            (-largest, largest),
            2 * largest,
            (-largest, largest),
            2 * largest,
            2 * largest,
            *voltages_v,
            change,
        )
    low, high = trained.range_um
    span = high - low
    accepted = (
        max(low - BEYOND_RANGE * span, min(low - NOISE * span, reach.low_um)),
        min(high + BEYOND_RANGE * span, max(high + NOISE * span, reach.high_um)),
    )
    trained_step = max(map(abs, trained.rates_um_s)) * sample_period_s
    longest = min(max(BEYOND_RATE * trained_step, NOISE * span), accepted[1] - accepted[0])
    trained_step = min(trained_step, longest)
    sharp = trained_step
    if trained.accelerations_um_s2 is not None:
        turned = max(map(abs, trained.accelerations_um_s2)) * sample_period_s**2
        sharp = min(max(BEYOND_RATE * turned, NOISE * span), trained_step)
    return StepLimits(accepted, longest, trained.range_um, trained_step, sharp, *voltages_v, change)


class GuardedStep(nn.Module):
    """The guard of a deployed step, and what every one of them offers.

    A subclass provides `motion` or an equivalent, `reset`, `step`, and `at_rest`.
    """

    def __init__(self, limits: StepLimits) -> None:
        super().__init__()
        self.least_accepted_um = limits.accepted_um[0]  # um, inputs below are held
        self.largest_accepted_um = limits.accepted_um[1]  # um, inputs above are held
        self.largest_step_um = limits.largest_step_um  # um, from one sample to the next
        self.least_trained_um = limits.trained_um[0]  # um
        self.largest_trained_um = limits.trained_um[1]  # um
        self.trained_step_um = limits.trained_step_um  # um, from one sample to the next
        self.sharp_um = limits.sharp_um  # um, from one step to the next
        self.min_voltage_v = limits.min_voltage_v  # V
        self.max_voltage_v = limits.max_voltage_v  # V
        self.limits_change = limits.max_change_v is not None
        self.max_change_v = limits.max_change_v if limits.max_change_v is not None else 0.0  # V, in a period
        self.enough = CONFIRMATIONS
        self.start_um = min(max(0.0, limits.accepted_um[0]), limits.accepted_um[1])
        self.start_v = min(max(0.0, limits.min_voltage_v), limits.max_voltage_v)
        self.start_trained_um = min(max(self.start_um, self.least_trained_um), self.largest_trained_um)
        self.reset_guard()

    def reset_guard(self) -> None:
        """Reset to rest; `lowest_um`, `highest_um` are the extremes so far of inputs in the trained range."""
        self.started = False
        self.confirmed = self.enough
        self.smooth = 4
        self.last_sample = self.start_um
        self.last_change_um = 0.0
        self.last_input = self.start_um
        self.lowest_um = self.start_trained_um
        self.highest_um = self.start_trained_um
        self.last_voltage = self.start_v
        self.held_inputs = 0
        self.outside_range = 0
        self.limited_outputs = 0

    def accept(self, yd: float) -> None:
        """Store the desired displacement that is used in `last_input`."""
        step_um = yd - self.last_input
        # Every comparison with NaN is false: NaN is not taken here, and held below.
        if (
            self.smooth >= 4
            and yd >= self.lowest_um
            and yd <= self.highest_um
            and step_um <= self.trained_step_um
            and step_um >= -self.trained_step_um
        ):
            self.last_change_um = step_um
            self.last_input = yd
            self.started = True
        else:
            self.accept_beyond(yd)

    def accept_beyond(self, yd: float) -> None:
        """Accept a sample beyond the turning points so far or the trained rates, or one soon after."""
        if self.smooth >= 4:
            self.last_sample = self.last_input
        if yd >= self.least_accepted_um and yd <= self.largest_accepted_um:
            change_um = yd - self.last_sample
            longest_um = abs(self.last_change_um) + self.trained_step_um
            if abs(change_um) > min(longest_um, self.largest_step_um):
                self.confirmed = 0
            elif self.confirmed < self.enough:
                self.confirmed += 1
            step_um = yd - self.last_input
            trained = yd >= self.least_trained_um and yd <= self.largest_trained_um
            if not self.started and (trained or self.confirmed >= self.enough):
                # The trajectory rested here before its first sample.
                self.started = True
                self.confirmed = self.enough
                change_um = 0.0
                step_um = 0.0
            if self.started and abs(step_um) <= self.largest_step_um:
                self.take(yd, step_um, change_um)
            elif self.confirmed < self.enough:
                self.held_inputs += 1
            else:
                longest_um = self.largest_step_um if step_um > 0.0 else -self.largest_step_um
                self.take(self.last_input + longest_um, step_um, change_um)
            if self.confirmed == 0 or abs(step_um) > self.trained_step_um or self.last_input != yd:
                self.smooth = 0
            elif self.smooth < 4:
                self.smooth += 1
            self.last_change_um = change_um
            self.last_sample = yd
        else:
            self.held_inputs += 1
            self.smooth = 0

    def take(self, yd: float, step_um: float, change_um: float) -> None:
        """Use a sample, but a sudden one no further beyond the turning points so far than trained."""
        taken_um = yd
        further_um = abs(self.last_change_um) + self.sharp_um
        if self.confirmed < self.enough or abs(change_um) > further_um:
            further_um = further_um if self.confirmed >= self.enough else 0.0
            least_um = self.last_input - further_um
            largest_um = self.last_input + further_um
            least_um = self.lowest_um if self.lowest_um < least_um else least_um
            largest_um = self.highest_um if self.highest_um > largest_um else largest_um
            taken_um = least_um if yd < least_um else taken_um
            taken_um = largest_um if yd > largest_um else taken_um
        if (
            self.confirmed >= self.enough
            and taken_um >= self.least_trained_um
            and taken_um <= self.largest_trained_um
        ):
            self.lowest_um = taken_um if taken_um < self.lowest_um else self.lowest_um
            self.highest_um = taken_um if taken_um > self.highest_um else self.highest_um
        if taken_um != yd:
            self.held_inputs += 1
        elif (
            yd < self.least_trained_um or yd > self.largest_trained_um or abs(step_um) > self.trained_step_um
        ):
            self.outside_range += 1
        self.last_input = taken_um

    def emit(self, u: float) -> None:
        """Store the voltage in `last_voltage`, kept within the limits."""
        least_v = self.min_voltage_v
        largest_v = self.max_voltage_v
        if self.limits_change:
            slower_v = self.last_voltage - self.max_change_v
            faster_v = self.last_voltage + self.max_change_v
            least_v = slower_v if slower_v > least_v else least_v
            largest_v = faster_v if faster_v < largest_v else largest_v
        # max and min of NaN differ between Python and TorchScript; here NaN becomes the least.
        bounded_v = u if u > least_v else least_v
        bounded_v = bounded_v if bounded_v < largest_v else largest_v
        if bounded_v != u:
            self.limited_outputs += 1
        self.last_voltage = bounded_v

    @torch.jit.export
    def reset_at(self, yd: float) -> float:
        """Start from a stage that rests at `yd`; return the voltage that keeps it there.

        The stage is taken to have come there from the de-energised state, and to have rested until its creep
        was over. A `yd` that is not accepted keeps the state de-energised, and counts in `held_inputs`.
        """
        self.reset()  # type: ignore[operator]
        if yd >= self.least_accepted_um and yd <= self.largest_accepted_um:
            self.last_input = yd  # no jump from the de-energised state
        self.accept_beyond(yd)
        u: float = self.at_rest(self.last_input)  # type: ignore[operator]
        self.last_voltage = u
        self.emit(u)
        self.limited_outputs = 0
        return self.last_voltage

    @torch.jit.export
    def reset_at_voltage(self, voltage_v: float) -> float:
        """Start from a stage that rests under `voltage_v`; return the displacement at which it rests.

        As in `reset_at`; a voltage outside the limits keeps the state de-energised, and counts likewise.
        """
        within = voltage_v >= self.min_voltage_v and voltage_v <= self.max_voltage_v
        aim_v = voltage_v if within else self.start_v
        least_um = self.least_accepted_um
        largest_um = self.largest_accepted_um
        for _ in range(60):
            middle_um = 0.5 * (least_um + largest_um)
            u: float = self.at_rest(middle_um)  # type: ignore[operator]
            if u < aim_v:
                least_um = middle_um
            else:
                largest_um = middle_um
        self.reset_at(largest_um)
        if not within:
            self.held_inputs += 1
        self.last_voltage = aim_v
        return self.last_input

    @torch.jit.export
    def block(self, yd: Tensor) -> Tensor:
        u = torch.empty_like(yd)
        for i in range(len(yd)):
            # fill_, because TorchScript rounds to float32 on the way through u[i] = … or torch.tensor.
            u[i].fill_(self.step(float(yd[i])))  # type: ignore[operator]
        return u
