"""What to know before a compensator drives a stage: its reach, rates, current and monotonicity."""

from dataclasses import asdict, dataclass
from typing import Any

from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.trained_motions import Interval
from torchpi.errors import ConfigError
from torchpi.identification.monotone import monotone


@dataclass(frozen=True)
class Load:
    """What the amplifier drives.

    Args:
        capacitance_uf: Capacitance of the piezo, µF; None if unknown.
        amplifier_gain: Voltage at the piezo per volt from the controller.

    Raises:
        ConfigError: A value is not positive.

    Example:
        >>> from torchpi.export import Load
        >>> Load(capacitance_uf=2.0, amplifier_gain=10.0).current_ma(rate_v_s=500.0)
        10.0
    """

    capacitance_uf: float | None = None
    amplifier_gain: float = 1.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value is not None and not 0 < value < float("inf"):
                raise ConfigError(f"{name}: found {value}, expected a positive number")

    def current_ma(self, rate_v_s: float) -> float | None:
        """Return i = C du/dt at the piezo, mA, for a rate of the controller's voltage, V/s."""
        if self.capacitance_uf is None:
            return None
        return 1e-3 * self.capacitance_uf * self.amplifier_gain * rate_v_s


@dataclass(frozen=True)
class SafetyCard:
    """The safety card; unknown entries are None.

    Attributes:
        sample_period_s: The period at which the step must be called.
        preview: Number of samples by which the desired displacement is given ahead.
        reachable_um: Displacements of slow motions within the output limits, from the de-energised state.
        remanence_um: The lowest displacement after a full excursion, without de-energising.
        reachable_from_remanence_um: Displacements of slow motions starting from that remanence.
        output_limits_v: Voltage limits, inside the step.
        max_slew_v_s: Limit on the rate of the output, inside the step.
        trained_range_um: Displacements of the training data.
        trained_rates_um_s: Signed rates of the training data.
        trained_accelerations_um_s2: Accelerations of the training data.
        trained_voltages_v: Voltages of the trained motions.
        trained_voltage_rates_v_s: Rates of these voltages, from sample to sample.
        capacitance_uf: Capacitance of the load, as given.
        amplifier_gain: Gain of the amplifier, as given.
        current_ma: Peak current of the trained motions into the given capacitance.
        current_at_slew_limit_ma: Current at `max_slew_v_s`.
        monotone: Whether the inverse rises everywhere over the trained range and rates.
        monotone_summary: The same result as a sentence.
        accepted_um: Inputs outside this interval are replaced by the last accepted input.
        accepted_rate_um_s: Faster jumps are held first, then followed at this rate.
    """

    sample_period_s: float
    preview: int
    reachable_um: Interval
    remanence_um: float
    reachable_from_remanence_um: Interval
    output_limits_v: Interval
    max_slew_v_s: float | None
    trained_range_um: Interval | None
    trained_rates_um_s: Interval | None
    trained_accelerations_um_s2: Interval | None
    trained_voltages_v: Interval | None
    trained_voltage_rates_v_s: Interval | None
    capacitance_uf: float | None
    amplifier_gain: float
    current_ma: float | None
    current_at_slew_limit_ma: float | None
    monotone: bool | None
    monotone_summary: str
    accepted_um: Interval
    accepted_rate_um_s: float

    def as_json(self) -> dict[str, Any]:
        """Return lists and numbers by name; the names include the units."""
        return {
            name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()
        }


def safety_card(compensator: DirectInverse, load: Load | None = None) -> SafetyCard:
    """Return the safety card of a compensator, for a load if it is known.

    Args:
        compensator: The trained compensator; for an untrained one some entries are None.
        load: What the amplifier drives; without its capacitance no current is stated.

    Example:
        >>> from torchpi import DirectInverse
        >>> from torchpi.export import Load, safety_card
        >>> compensator = DirectInverse(1e-4, thresholds=[0.0], max_slew_v_s=500.0)
        >>> card = safety_card(compensator, Load(capacitance_uf=2.0))
        >>> (card.output_limits_v, card.current_at_slew_limit_ma)
        ((0.0, 10.0), 1.0)
    """
    load = load or Load()
    trained, limits, reach = compensator.trained, compensator.step_limits(), compensator.reach()
    peak_v_s = max(map(abs, trained.voltage_rates_v_s)) if trained else None
    rises = monotone(compensator, trained.range_um, trained.rates_um_s) if trained else None
    return SafetyCard(
        sample_period_s=compensator.sample_period_s,
        preview=compensator.preview,
        reachable_um=(reach.low_um, reach.high_um),
        remanence_um=reach.remanence_um,
        reachable_from_remanence_um=(reach.remanence_um, reach.high_um),
        output_limits_v=(compensator.min_voltage_v, compensator.max_voltage_v),
        max_slew_v_s=compensator.max_slew_v_s,
        trained_range_um=trained.range_um if trained else None,
        trained_rates_um_s=trained.rates_um_s if trained else None,
        trained_accelerations_um_s2=trained.accelerations_um_s2 if trained else None,
        trained_voltages_v=trained.voltages_v if trained else None,
        trained_voltage_rates_v_s=trained.voltage_rates_v_s if trained else None,
        capacitance_uf=load.capacitance_uf,
        amplifier_gain=load.amplifier_gain,
        current_ma=load.current_ma(peak_v_s) if peak_v_s is not None else None,
        current_at_slew_limit_ma=(
            load.current_ma(compensator.max_slew_v_s) if compensator.max_slew_v_s is not None else None
        ),
        monotone=bool(rises) if rises is not None else None,
        monotone_summary=str(rises) if rises is not None else "the trained range and rates are not known",
        accepted_um=limits.accepted_um,
        accepted_rate_um_s=limits.largest_step_um / compensator.sample_period_s,
    )
