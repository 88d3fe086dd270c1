"""A stage whose modes are excited by every input: the missing inputs and the shared modes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, ss2tf

from tests.diagnosis.plants import Signal
from tests.diagnosis.prepared import prepared
from torchpi.cli.predict import predict
from torchpi.diagnosis import diagnose
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnosis import NamedEffect
from torchpi.diagnosis.fit import ROUGH, fit
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import plain
from torchpi.diagnosis.modal import driven_modes
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.score import Weighting
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.mechanics.modal import ModalResonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode

FS_HZ, FINER, SAMPLES = 4000.0, 8, 4000
NOISE_UM = 0.01
MODES = ((310.0, 0.012), (520.0, 0.03), (560.0, 0.015))
RESIDUES = {
    "input_v": (1.2, 0.9, -0.4),
    "aux_2": (0.7, -0.5, 0.6),
    "aux_3": (-0.4, 0.0, 0.9),
    "aux_dead": (0.0, 0.0, 0.0),
}
"""Static gain of each mode, µm/V."""


def noise_like(seed: int) -> Signal:
    """Return a random-phase signal up to 1500 Hz, half a volt rms, from 0 V."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    lines = slice(1, int(1500 * SAMPLES / FS_HZ))
    spectrum[lines] = np.exp(2j * np.pi * rng.uniform(size=SAMPLES // 2 + 1))[lines]
    u = np.fft.irfft(spectrum, SAMPLES)
    return 0.5 * u / u.std() * np.minimum(1, np.arange(SAMPLES) / 100)


def plays(v: Signal) -> Signal:
    """A light hysteresis: a straight line and four plays."""
    thresholds, weights = np.array([0.0, 0.1, 0.25, 0.5, 0.8]), np.array([0.9, 0.04, 0.03, 0.03, 0.02])
    y, state = np.zeros(len(v)), np.zeros(5)
    for k, one in enumerate(v):
        state = np.maximum(one - thresholds, np.minimum(one + thresholds, state))
        y[k] = weights @ state
    return y


def rung(u: Signal, residues: tuple[float, ...]) -> Signal:
    """Σ r ω²/(s² + 2ζω s + ω²), in finer steps with a linearly interpolated input."""
    total, t = np.zeros(len(u)), np.arange(len(u) * FINER) / FINER
    fine = np.interp(t, np.arange(len(u)), u)
    for (f, damping), r in zip(MODES, residues, strict=True):
        w = 2 * np.pi * f
        a, b = [[0.0, 1.0], [-w * w, -2 * damping * w]], [[0.0], [w * w]]
        mode = tuple(np.array(part) for part in (a, b, [[r, 0.0]], [[0.0]]))
        over, under = ss2tf(*cont2discrete(mode, 1 / FS_HZ / FINER, "foh")[:4])
        total += lfilter(over[0], under, fine)[::FINER]
    return total


def recorded(seed: int, names: tuple[str, ...]) -> Recording:
    """Return one recording in which all inputs act at once."""
    u, noise = noise_like(10 * seed), np.random.default_rng(seed).standard_normal(SAMPLES)
    aux = {name: noise_like(10 * seed + k) for k, name in enumerate(names, 1)}
    y = rung(plays(u), RESIDUES["input_v"]) + NOISE_UM * noise
    y += sum(rung(signal, RESIDUES[name]) for name, signal in aux.items())
    return Recording(f"run {seed}", np.arange(SAMPLES) / FS_HZ, u, y, FS_HZ, aux)


def frequencies_hz(effects: dict[str, NamedEffect]) -> list[float]:
    return sorted(
        float(parameter.value)
        for name in ("resonance", "second_mode")
        for parameter in effects[name].parameters
        if parameter.name.startswith("frequency_hz")
    )


def test_a_single_mode_starts_within_its_bounds_from_a_shared_mode_beyond_them() -> None:
    """The share of a mode that other axes excite too may be of any size."""
    shared = EffectTerm(ModalResonance, {"frequency_hz": 300.0, "damping_ratio": 0.02, "share": -2.2})
    single = EffectTerm(SecondMode, {"frequency_hz": 10.0, "damping_ratio": 0.1, "share": 0.05})
    assert single.from_where(shared).shared == {"frequency_hz": 300.0, "damping_ratio": 0.02, "share": -0.9}
    SecondMode(1e-3, **single.from_where(shared).shared)  # raises beyond the bounds


def test_a_line_that_nothing_drives_costs_no_mode() -> None:
    """A pole without damping imitates the line, and no stage has such a mode."""
    one = recorded(1, ("aux_2", "aux_3"))
    records = prepared([replace(one, y=one.y + 0.2 * np.sin(2 * np.pi * 731.3 * one.t))])
    chain = Chain(records)
    now = fit(chain, Hypothesis(plain(seen(records))))
    chain.weighting = Weighting.of(records, now.residuals, None)
    ((_, with_modes),) = driven_modes(chain, now, [now], ROUGH)
    found = [m.shared["frequency_hz"] for m in with_modes.hypothesis.members if m.effect.rings]
    assert sorted(found) == pytest.approx([f for f, _ in MODES], rel=2e-3)


@pytest.mark.long
def test_active_inputs_and_shared_modes_are_found_and_an_unseen_recording_is_predicted() -> None:
    one = diagnose([recorded(seed, ("aux_2", "aux_3", "aux_dead")) for seed in (1, 2)])
    effects = {effect.name: effect for effect in one.effects}
    assert set(effects) == {"cross_coupling", "resonance", "second_mode"}
    assert min(effect.probability for effect in one.effects) > 0.95
    assert one.stage.aux_names == ("aux_2", "aux_3")
    assert frequencies_hz(effects) == pytest.approx([f for f, _ in MODES], rel=2e-3)
    assert one.augmented.heldout_rms_um < 1.15 * NOISE_UM < 0.03 * one.retuned.heldout_rms_um
    other = recorded(3, ("aux_2", "aux_3"))
    y = predict(one.stage, other.u, other.aux)
    assert np.std(other.y - y) < 1.2 * NOISE_UM


MIRROR = Path(__file__).parents[3] / "shared" / "data" / "steering_mirror" / "train.npz"


@pytest.mark.long
@pytest.mark.skipif(not MIRROR.is_file(), reason="the recordings of the steering mirror are not here")
def test_the_two_missing_voltages_and_the_modes_of_a_real_steering_mirror_are_found() -> None:
    signals = np.load(MIRROR)
    volts, metres = (signals[f"{kind}_300mV_train"].astype(np.float64) for kind in ("u", "y"))
    u = volts[:, :, 0].transpose(2, 0, 1).reshape(-1, 3)
    y = 1e6 * metres[:, 0, 0].T.ravel()
    aux = {"aux_u2": u[:, 1], "aux_u3": u[:, 2]}
    one = diagnose([Recording("run 0", np.arange(len(y)) / 6400, u[:, 0], y, 6400.0, aux)])
    effects = {effect.name: effect for effect in one.effects}
    assert set(effects) == {"cross_coupling", "resonance", "second_mode"}
    assert one.stage.aux_names == ("aux_u2", "aux_u3")
    modes = np.array(frequencies_hz(effects))
    for f in (636.0, 806.0, 921.0, 990.0, 1682.0, 2123.0, 2276.0, 2309.0, 2540.0):
        assert np.abs(modes / f - 1).min() < 5e-3, f
    # Nonlinear distortion, 3.5 % of 3.7 µm, is not modal.
    assert one.augmented.heldout_rms_um < 0.2 < 3.4 < one.retuned.heldout_rms_um
    assert one.unexplained_share < 0.01
