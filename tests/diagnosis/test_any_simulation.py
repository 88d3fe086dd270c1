"""A third-party simulation: what it lacks is named if the data tell, and what they cannot tell is listed."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest

from tests.diagnosis import simulations
from tests.diagnosis.simulations import FS_HZ, NOISE_UM, recorded, stage
from torchpi.cli.predict import predict
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.posterior import HALF, Believed
from torchpi.diagnosis.simulation import with_untried
from torchpi.errors import RecordingError, SimulationError
from torchpi.recordings.recording import Recording
from torchpi.simulators import Simulate, Simulator
from torchpi.stage import Stage
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.hysteresis_asymmetry import HysteresisAsymmetry
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

SOME = (AmplifierLag, Delay, HysteresisAsymmetry, Creep, Resonance, SecondMode, SensorLag)


def with_column(recordings: list[Recording], simulate: Simulate) -> list[Recording]:
    """Return the recordings with the output of a simulation as a column."""
    return [replace(one, simulated=simulate(one.u, one.fs_hz)) for one in recordings]


def compared(how: str, recordings: list[Recording], simulate: Simulate, effects: tuple = SOME) -> Diagnosis:
    """Diagnose with the simulation given as a function or as a column."""
    if how == "function":
        return diagnose(recordings, simulate, effects=effects)
    return diagnose(with_column(recordings, simulate), "column", effects=effects)


def names(found: Diagnosis) -> list[str]:
    return sorted(effect.name for effect in found.effects)


each_way = pytest.mark.parametrize("how", ["function", "column"])


@each_way
def test_a_correct_simulation_lacks_nothing(how: str) -> None:
    found = compared(how, recorded(stage()), simulations.right)
    assert found.verdict == "nothing_missing" and found.effects == ()
    assert found.retuned.heldout_rms_um < 1.1 * NOISE_UM


@each_way
def test_creep_that_a_simulation_lacks_is_found(how: str) -> None:
    found = compared(how, recorded(stage(creep=True)), simulations.right)
    assert names(found) == ["creep"] and found.verdict == "explained"
    assert found.effects[0].parameters[0].value == pytest.approx(0.02, rel=0.05)


@each_way
def test_a_mode_at_the_wrong_frequency_is_replaced_by_one_at_the_right_frequency(how: str) -> None:
    found = compared(how, recorded(stage(), 4000), simulations.wrong_mode)
    assert names(found) == ["resonance"] and found.verdict == "explained"
    values = {one.name: one.value for one in found.effects[0].parameters}
    assert found.effects[0].form == "in place of the simulation's"
    assert values["frequency_hz"] == pytest.approx(300.0, rel=0.01)
    assert values["replaced_frequency_hz"] == pytest.approx(270.0, rel=0.05)


@each_way
def test_hysteresis_with_wrong_weights_is_named_with_static_effects_as_alternatives(how: str) -> None:
    effects = (InputNonlinearity, *SOME)
    found = compared(how, recorded(stage(mode=False)), simulations.wrong_hysteresis, effects)
    assert names(found) == ["hysteresis_operator"] and found.verdict == "explained"
    hidden = {"hysteresis_asymmetry"} | ({"input_nonlinearity"} if how == "column" else set())
    assert hidden <= set(found.effects[0].alternatives)


@pytest.mark.long
def test_a_lag_before_a_simulation_is_found_if_the_simulation_can_be_called() -> None:
    found = compared("function", recorded(stage(cutoff_hz=100.0)), simulations.right)
    assert names(found) == ["amplifier_lag"] and found.verdict == "explained"
    assert found.effects[0].parameters[0].value == pytest.approx(100.0, rel=0.02)
    assert found.augmented.heldout_rms_um < 1.1 * NOISE_UM


def test_a_lag_before_a_recorded_output_is_listed_as_an_alternative_to_one_behind_it() -> None:
    found = compared("column", recorded(stage(cutoff_hz=100.0)), simulations.right)
    lags = [effect for effect in found.effects if effect.name in ("sensor_lag", "delay")]
    assert len(lags) == 1 and "amplifier_lag" in lags[0].alternatives
    assert found.verdict == "partly_explained"
    (note,) = (note for note in found.notes if note.startswith("Not tried"))
    assert "amplifier_lag" in note and "only the output is known" in note


def test_a_delay_behind_a_recorded_output_is_found() -> None:
    late = [replace(one, y=np.r_[one.y[:3], one.y[:-3]]) for one in recorded(stage())]
    found = compared("column", late, simulations.right)
    assert names(found) == ["delay"] and found.stage.alignment in (0, 1)
    # One of the four samples is the stage's own delay; the timing convention may account for one.
    delay_s = 1 / FS_HZ * (4 - found.stage.alignment)
    assert found.effects[0].parameters[0].value == pytest.approx(delay_s, rel=0.02)


def counted(simulate: Simulate, calls: list[int]) -> Simulate:
    def count(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
        calls.append(len(u_v))
        return simulate(u_v, fs_hz)

    return count


def test_effects_behind_a_simulation_need_no_further_calls() -> None:
    """Each recording is simulated once, and one of them again to check that the output repeats."""
    calls: list[int] = []
    diagnose(
        recorded(stage(creep=True)),
        counted(simulations.right, calls),
        effects=(Creep, Delay, Resonance, SensorLag),
    )
    assert len(calls) == 3


def test_worker_processes_give_the_same_result_with_an_importable_simulation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recordings, some = recorded(stage(), 1000), (Creep, AmplifierLag, Resonance)
    here = diagnose(recordings, simulations.wrong_mode, effects=some)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        there = diagnose(recordings, simulations.wrong_mode, effects=some, executor=pool)
    assert here.effects == there.effects and here.augmented == there.augmented


def test_only_a_simulation_that_can_be_pickled_is_sent_to_other_processes() -> None:
    assert Simulator.of(simulations.right).travels and not Simulator.of(lambda u, fs_hz: u).travels


def test_the_identified_stage_predicts_by_calling_the_same_simulation(tmp_path: object) -> None:
    recordings = recorded(stage(creep=True), 2000)
    found = diagnose(recordings, simulations.wrong_mode, effects=(Creep, Resonance, SensorLag))
    found.stage.save(f"{tmp_path}/stage.pt")
    loaded = Stage.load(f"{tmp_path}/stage.pt")
    assert loaded.simulation == "tests.diagnosis.simulations:wrong_mode"
    trace = found.traces[0]
    attached = loaded.with_simulation(Simulator.of(simulations.wrong_mode))
    y = predict(attached, trace.u, {})
    assert np.std(y - trace.y) < 1.3 * NOISE_UM


def test_the_identified_stage_predicts_from_a_recorded_simulation_output() -> None:
    recordings = with_column(recorded(stage(creep=True), 2000), simulations.right)
    found = diagnose(recordings, "column", effects=(Creep, Resonance, SensorLag))
    assert found.stage.aux_names == ("simulated_um",)
    simulated = recordings[0].simulated
    assert simulated is not None
    y = predict(found.stage, recordings[0].u, {"simulated_um": simulated})
    assert np.std(y - recordings[0].y) < 1.3 * NOISE_UM


def noisy(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
    return u_v + np.random.default_rng().standard_normal(len(u_v))


def failing(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
    raise ZeroDivisionError("no spring\nat all")


@pytest.mark.parametrize(
    ("simulate", "error", "text"),
    [
        (lambda u, fs: u[1:], SimulationError, r"found an output of shape \(399,\), expected \(400,\)"),
        (lambda u, fs: np.stack([u, u], 1), SimulationError, r"shape \(400, 2\), expected \(400,\)"),
        (
            lambda u, fs: np.where(u > 5, np.nan, u),
            SimulationError,
            "found nan at sample .*, expected finite",
        ),
        (lambda u, fs: 1e-3 * u, RecordingError, "expected both in V and µm"),
        (noisy, SimulationError, "found outputs for the same voltage that differ"),
        (failing, SimulationError, "simulations?.*found ZeroDivisionError: no spring, with 400 samples"),
        ("volume", SimulationError, "found 'volume', expected a stage, a function or 'column'"),
        ("column", RecordingError, "multisine: found no simulated output, expected a column simulated_um"),
    ],
)
def test_an_invalid_simulation_is_refused_in_one_line(
    simulate: Callable | str, error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text) as raised:
        diagnose(recorded(stage(), 400), simulate)
    assert "\n" not in str(raised.value)


def test_a_simulated_output_that_is_not_finite_is_refused() -> None:
    recordings = with_column(recorded(stage(), 400), simulations.right)
    assert recordings[1].simulated is not None
    recordings[1].simulated[7] = np.inf
    with pytest.raises(RecordingError, match="triangles: simulated_um: found inf at sample 7"):
        diagnose(recordings, "column")


def test_a_hysteresis_beside_a_lag_behind_a_recorded_output_is_merged_into_the_lag() -> None:
    def believed(name: str, explained_um2: float) -> Believed:
        return Believed(name, 0.9, (), explained_um2, (), HALF)

    found = with_untried(
        [believed("hysteresis_operator", 3.0), believed("sensor_lag", 2.0), believed("creep", 1.0)],
        (SensorLag, Creep),
        (AmplifierLag,),
    )
    assert [(one.name, one.explained_um2) for one in found] == [("sensor_lag", 5.0), ("creep", 1.0)]
    assert {"amplifier_lag", "hysteresis_operator"} <= {*found[0].alternatives}
