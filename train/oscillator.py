"""`python -m train fit --config …` for an oscillator with hysteresis: one stage.pt for all recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchpi.errors import ConfigError, RecordingError, is_number
from torchpi.identification.bouc_wen_oscillator import (
    IdentifiedOscillator,
    OscillatorOptions,
    identify_oscillator,
)
from torchpi.recordings.force import read_force_recording
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.recording import Recording
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator

from .own_kind import files_named, leave, settings_of, whole_number

SECTION = "oscillator"
OWN = ("recordings", "periods", "heldout")
READING = (*OWN, *(field.name for field in fields(RecordingOptions) if field.name != "skip_s"))
"""`skip_s` is left out, because every recording begins at rest."""


def fit(arguments: Sequence[str], config: Path) -> None:
    """Identify the oscillator, judge it on the held-out samples, and write stage.pt and metrics.json.

    Raises:
        ConfigError: An option or a key is unknown, or a value has another type.
        RecordingError: A recording cannot be used.
        ArtifactError: The output folder is in use or cannot be written to.
    """
    known = [field.name for field in fields(OscillatorOptions)]
    settings, folder = settings_of(arguments, config, SECTION, [*READING, *known])
    named = files_named(config, settings.get("recordings"))
    periods, share = whole_number(config, "periods", settings.get("periods", 1)), settings.get("heldout", 0.0)
    if not is_number(share) or not 0 <= share < 1:
        raise ConfigError(f"{config}: heldout: found {share!r}, expected a number from 0 to below 1")
    options = OscillatorOptions(**{name: settings[name] for name in known if name in settings})
    reading = RecordingOptions(
        **{name: settings[name] for name in READING if name in settings and name not in OWN}
    )
    recordings = [read_force_recording(one, reading) for one in named]
    fitted = [counted(one, periods, float(share)) for one in recordings]
    found = identify_oscillator(recordings, fitted, options, log=print)
    oscillator = found.oscillator
    metrics = {
        "train": judged(oscillator, recordings, fitted, periods),
        "heldout": judged(oscillator, recordings, [~counts for counts in fitted], periods) if share else [],
        "parameters": parameters(found),
        "between_samples_rms_um": found.rms_um,
    }
    leave(folder, oscillator, metrics, {SECTION: settings})
    show(metrics)
    mode = f"mode at {oscillator.frequency_hz:.4g} Hz, damping ratio {oscillator.damping_ratio:.3g}"
    print(f"{folder / 'stage.pt'}: {mode}, force between samples {oscillator.between}")


def counted(recording: Recording, periods: int, share: float) -> np.ndarray:
    """Return which samples are fitted, (time,), bool: all but the last share of each period.

    Raises:
        RecordingError: The recording does not hold whole periods.
    """
    if len(recording) % periods:
        raise RecordingError(
            f"{recording.name}: found {len(recording)} samples, expected a multiple of {periods} periods"
        )
    length = len(recording) // periods
    return np.arange(len(recording)) % length < length - round(share * length)


def judged(
    oscillator: BoucWenOscillator, recordings: Sequence[Recording], counts: Sequence[np.ndarray], periods: int
) -> list[dict[str, Any]]:
    """Return the rms error from rest, µm, and that of the motion over the samples that count.

    With three or more periods, the noise is estimated from the differences between all periods but the first,
    and the error of their mean is given beside its noise.
    """
    found = []
    for one, those in zip(recordings, counts, strict=True):
        error = one.y - oscillator.simulate(torch.from_numpy(one.u)[None])[0].numpy()
        entry = {"name": one.name, "rms_um": _rms(error[those]), "motion_rms_um": float(one.y[those].std())}
        if periods > 2:
            later = those.reshape(periods, -1)[0]
            steady = error.reshape(periods, -1)[1:, later]
            mean = steady.mean(0)
            noise = float(np.sqrt(np.square(steady - mean).sum() / (steady.size - mean.size)))
            entry["noise_rms_um"] = noise
            entry["mean_period_rms_um"] = _rms(mean)
            entry["mean_period_noise_rms_um"] = noise / float(np.sqrt(len(steady)))
        found.append(entry)
    return found


def parameters(found: IdentifiedOscillator) -> dict[str, dict[str, float | None]]:
    """Return the parameters with half the widths of their 95 % intervals."""
    return {
        name: {"value": value, "half_width_95": found.half_widths[name]}
        for name, value in found.oscillator.values._asdict().items()
    }


def show(metrics: Mapping[str, Any]) -> None:
    """Print one line for each parameter and each recording."""
    for name, one in metrics["parameters"].items():
        width = one["half_width_95"]
        interval = "not fitted" if width is None else f"± {width:.2g} (95 %)"
        print(f"{name:>25}  {one['value']:.6g} {interval}")
    for part in ("train", "heldout"):
        for one in metrics[part]:
            line = f"{part:>8}  {one['name']:<24} {one['rms_um']:.4f} µm rms"
            if "noise_rms_um" in one:
                line += f", noise {one['noise_rms_um']:.4f} µm"
            line += f", motion {one['motion_rms_um']:.1f} µm"
            if "noise_rms_um" in one:
                mean, its_noise = one["mean_period_rms_um"], one["mean_period_noise_rms_um"]
                line += f"; mean period {mean:.4f} µm, its noise {its_noise:.4f} µm"
            print(line)


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(error))))
