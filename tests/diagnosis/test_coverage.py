"""What recordings cannot show, whatever model is fitted."""

import numpy as np
import pytest

from tests.diagnosis.plants import FS_HZ, NOISE_UM, multisine, record, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.coverage import (
    cannot_be_decided,
    follows_command,
    levels,
    one_motion,
    reason_to_leave_out,
    repeats,
    untested,
)
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.records import seen
from torchpi.stage.effects.actuator.rate_dependent_hysteresis import RateDependentHysteresis

T_S = np.arange(8000) / FS_HZ
SINE_V = 5 - 5 * np.cos(2 * np.pi * T_S)


def test_a_sine_reverses_at_two_levels_and_minor_loops_at_more() -> None:
    assert levels(prepared([record(SINE_V)])) == 2
    assert levels(prepared([record(triangles(8000))])) == 3
    assert levels(prepared([record(multisine(8000))])) > 3


@pytest.mark.parametrize(
    ("line_hz", "follows"),
    [(2.0, True), (2.02, True), (2.4, False), (1.7, False), (10.0, True), (50.0, False)],
)
def test_low_harmonics_of_a_periodic_command_follow_the_command(line_hz: float, follows: bool) -> None:
    repeating = repeats(prepared([record(SINE_V)]))
    assert repeating == [pytest.approx((1.0, 4.0))]
    assert follows_command(line_hz, [1.0], repeating) is follows


@pytest.mark.parametrize("fade", [0.0, 0.3])
def test_a_period_need_not_be_a_whole_number_of_samples(fade: float) -> None:
    triangle = np.abs(np.mod(2.2437 * T_S, 2) - 1) * np.exp(-fade * T_S)
    ((period_s, _),) = repeats(prepared([record(10 * triangle)]))
    assert period_s == pytest.approx(2 / 2.2437, rel=1e-3)


def test_a_command_that_never_repeats_has_no_harmonics() -> None:
    assert repeats(prepared([record(multisine(4000)), record(T_S)])) == [None, None]
    assert not follows_command(2.0, [1.0], [None])


def test_a_line_also_present_in_an_aperiodic_recording_does_not_follow_the_command() -> None:
    repeating = repeats(prepared([record(SINE_V), record(multisine(8000))]))
    assert follows_command(10.0, [1.0, 0.01], repeating)
    assert not follows_command(10.0, [1.0, 0.5], repeating)


def test_a_narrow_range_of_held_out_voltages_loops_or_rates_is_reported() -> None:
    varied, sine, ramp = (
        untested(records, seen(records))
        for records in (
            prepared([record(u)]) for u in (multisine(8000), SINE_V, np.linspace(0.0, 10.0, 4000))
        )
    )
    assert varied == ()
    assert sine == ("loops between two levels", "strokes at one rate")
    (voltages, *rest) = ramp
    assert voltages == "voltages from 8.5 to 10 V of the recorded 0 to 10 V" and not rest


def test_only_going_to_and_fro_without_a_hold_is_one_motion() -> None:
    stairs = np.repeat([0.0, 10.0, 0.0, 10.0], 2000)
    found = [one_motion(prepared([record(u)])) for u in (SINE_V, triangles(8000), multisine(8000), stairs)]
    assert found == [True, False, False, False]


@pytest.mark.parametrize(
    ("voltage_v", "shown"),
    [(SINE_V, False), (np.repeat([0.0, 10.0, 0.0, 10.0], 2000), True), (multisine(8000), True)],
    ids=["sine", "held levels", "multisine"],
)
def test_rate_dependence_shows_at_several_rates_or_in_holds(voltage_v: np.ndarray, shown: bool) -> None:
    records = prepared([record(voltage_v)])
    assert (reason_to_leave_out(RateDependentHysteresis, records, seen(records), 1) is None) is shown


def squared_play(u: np.ndarray) -> np.ndarray:
    """A play of 2 V through a parabola: a Preisach operator that no Prandtl–Ishlinskii operator equals."""
    state = np.zeros(len(u))
    for k in range(1, len(u)):
        state[k] = max(u[k] - 2, min(u[k] + 2, state[k - 1]))
    return 0.012 * state**2


@pytest.mark.parametrize("voltage_v", [SINE_V, triangles(8000)], ids=["one size", "two sizes"])
def test_a_kind_of_hysteresis_is_named_from_loops_of_several_sizes_only(voltage_v: np.ndarray) -> None:
    one_size = levels(prepared([record(voltage_v)])) == 2
    found = diagnose([record(voltage_v, after=lambda x, fs_hz: x + squared_play(voltage_v))])
    open_causes = {one.name: one.probability for one in found.open}
    assert ("hysteresis_operator" in {effect.name for effect in found.effects}) is not one_size
    assert (0.4 < open_causes.get("hysteresis_operator", 0.0) < 0.5) is one_size
    assert any("loops of one size" in note for note in found.notes) is one_size
    assert found.augmented.heldout_rms_um < 1.1 * NOISE_UM


def test_what_one_size_of_loop_cannot_show_is_only_said_of_a_voltage_that_reverses() -> None:
    said = {
        name: " ".join(cannot_be_decided(prepared([record(u)])))
        for name, u in {"sine": SINE_V, "ramp": np.linspace(0.0, 10.0, 4000)}.items()
    }
    assert "loops of one size" in said["sine"] and "never reverses" not in said["sine"]
    assert "loops of one size" not in said["ramp"] and "never reverses" in said["ramp"]


def test_a_curved_sensor_under_a_sine_is_not_named_gain_modulation() -> None:
    def curved(x: np.ndarray, fs_hz: float) -> np.ndarray:
        return x - 4e-3 * (x - 4) ** 2

    found = diagnose([record(SINE_V, after=curved)])
    names = {effect.name for effect in found.effects}
    assert "gain_modulation" not in names
    assert names <= {
        "sensor_nonlinearity",
        "input_nonlinearity",
        "hysteresis_asymmetry",
        "hysteresis_operator",
    }
