"""A compensator from recordings in memory: fit, predict, track, export, in the manner of scikit-learn.

The procedure is that of `torchpi commission`: cross-validation selects the form of the inverse, a forward
stage is identified from the same recordings, and both are judged on the last recording, which is held out.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import torch

from torchpi.commission.commission import check_together, selected
from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.reach import check_reached
from torchpi.control.step import CompensatorStream
from torchpi.control.trained import load_compensator, to_checkpoint
from torchpi.diagnosis.forward_stage import identify_stage
from torchpi.errors import (
    ArtifactError,
    ConfigError,
    RecordingError,
    RecordingWarning,
    is_number,
    is_whole,
    kind_of,
)
from torchpi.export import made_files, safety_card, write_together
from torchpi.export.formats import Files, without_suffix
from torchpi.export.torchscript import script, warm
from torchpi.files import as_path, save_tensors
from torchpi.identification import InverseErrors, inverse_errors, inverse_pair
from torchpi.identification.recipe import RECORDED
from torchpi.identification.selection import Form
from torchpi.loop import run_loop
from torchpi.notebook.given import given_recordings
from torchpi.notebook.tracked import Tracked
from torchpi.recordings.checks import check_recording, check_values
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.readers.memory import MemorySource
from torchpi.recordings.recording import Recording
from torchpi.report.notebook import compensator_html
from torchpi.stage import Stage
from torchpi.stage.beside import NAME as STAGE
from torchpi.stage.beside import exported_stage

Signal = npt.NDArray[np.float64]  # shape: (time,)
LEAST_MOTION = 2e-3
"""Fraction of the reach; a smaller motion may be given in another unit."""


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Compensator:
    """Maps a desired displacement to the voltage that produces it on the stage of the recordings.

    Attributes:
        inverse: The direct inverse, a `torch.nn.Module`.
        stage: The forward stage identified from the same recordings; None if there is none.
        errors: Errors of the inverse on the held-out recording; None if it was loaded.
        form: Form selected by cross-validation; None if it was loaded.

    Raises:
        ConfigError: There is no inverse, or settings of a fit are given; `fit` and `load` make a compensator.

    Example:
        >>> import numpy as np
        >>> from torchpi import Compensator, Recording, Stage
        >>> from torchpi.excitation.signals import make_excitation
        >>> rig = Stage.from_yaml("default")  # in place of your own stage
        >>> recordings = []
        >>> for seed, kind in enumerate(("sine_5hz", "multisine", "multisine")):
        ...     t, u = make_excitation(kind, rig.sample_rate_hz, 0.5, seed)
        ...     _, y = rig.simulate(u[None])
        ...     recordings.append(Recording.from_arrays(t, u, y[0], name=f"{kind} {seed}"))
        >>> compensator = Compensator.fit(recordings)  # the last one is held out
        >>> compensator.errors.rms_percent < 2
        True
    """

    inverse: DirectInverse
    stage: Stage | None = None
    errors: InverseErrors | None = None
    form: Form | None = None

    def __init__(
        self,
        inverse: DirectInverse | None = None,
        stage: Stage | None = None,
        errors: InverseErrors | None = None,
        form: Form | None = None,
        **settings: Any,
    ) -> None:
        """Wrap an existing inverse; `fit` and `load` make one."""
        if settings or not isinstance(inverse, DirectInverse):
            found = ", ".join(settings) if settings else kind_of(inverse)
            raise ConfigError(
                f"Compensator: found {found}, expected a DirectInverse: Compensator.fit(recordings, …) "
                "makes a compensator from recordings, Compensator.load(path) reads one"
            )
        vars(self).update(inverse=inverse, stage=stage, errors=errors, form=form)
        # `fit` on an instance would return another one and leave this one unchanged, so it is refused.
        vars(self)["fit"] = _refuse_to_refit

    @classmethod
    def fit(
        cls,
        recordings: Sequence[Recording],
        *,
        preview: int | None = None,
        skip_s: float = 0.0,
        min_voltage_v: float | None = None,
        max_voltage_v: float | None = None,
    ) -> "Compensator":
        """Identify the inverse and a forward stage, which takes some seconds for 10,000 samples.

        Args:
            recordings: Two or more of one stage, at the sample rate of the control loop. The last one is held
                out for validation.
            preview: Largest number of samples by which the trajectory is known ahead; 0 if it is not. By
                default as many as the delay of the stage in the recordings.
            skip_s: Start-up transient of each recording, s, that sets the state but is not fitted.
            min_voltage_v, max_voltage_v: Limits of the voltage; by default those of the recordings.

        Raises:
            RecordingError: There are fewer than two recordings, two are the same, sample rates differ, or one
                allows no model.
            ConfigError: A limit is not a finite voltage, a number of samples or seconds is negative, or the
                method is called on a fitted compensator.
        """
        RecordingOptions(skip_s=skip_s)  # raises the same errors as for a file
        if preview is not None and not (is_whole(preview) and preview >= 0):
            raise ConfigError(
                f"preview: found {preview!r}, expected a number of samples that is not negative"
            )
        for key, value in (("min_voltage_v", min_voltage_v), ("max_voltage_v", max_voltage_v)):
            if value is not None and not (is_number(value) and math.isfinite(value)):
                raise ConfigError(f"{key}: found {value!r}, expected a voltage in V")
        checked = [_checked(recording) for recording in given_recordings(recordings)]
        check_together(checked)
        pairs = [inverse_pair(recording, 0, None, skip_s) for recording in checked]
        richest = RECORDED if preview is None else replace(RECORDED, previews=range(preview + 1))
        selection = selected(checked, pairs, richest, min_voltage_v, max_voltage_v)
        inverse = selection.compensator.requires_grad_(False)
        *train, heldout = checked
        return cls(
            inverse,
            identify_stage(train, heldout, skip_s=skip_s).stage,
            _errors(inverse, heldout, skip_s),
            selection.steps[-1].form,
        )

    @classmethod
    def load(cls, path: str | Path) -> "Compensator":
        """Load a folder written by `save`, `torchpi train fit` or `torchpi commission`.

        Raises:
            ArtifactError: The folder has no compensator, or it is not as it was written.
        """
        stage = as_path(path) / STAGE
        inverse = load_compensator(path).requires_grad_(False)
        return cls(inverse, Stage.load(stage) if stage.is_file() else None)

    def save(self, folder: str | Path) -> None:
        """Write the compensator and its stage into a folder, for `load` and for `torchpi export`.

        Example:
            >>> compensator.save("mine")
            >>> bool((Compensator.load("mine").predict(reference) == compensator.predict(reference)).all())
            True
        """
        checkpoint = as_path(folder) / "checkpoints" / "best.ckpt"
        files: Files = {checkpoint: partial(save_tensors, to_checkpoint(self.inverse))}
        if self.stage is not None:
            files[Path(folder) / STAGE] = self.stage.write
        write_together(files)

    @property
    def sample_rate_hz(self) -> float:
        """Sample rate of the recordings, of `predict`, and of the control loop."""
        return 1.0 / self.inverse.sample_period_s

    @property
    def preview(self) -> int:
        """Number of samples by which the desired trajectory is seen ahead."""
        return self.inverse.preview

    def predict(
        self,
        reference_um: npt.ArrayLike,  # (time,), µm
    ) -> Signal:  # (time,), V
        """Return the voltage at each sample for a desired displacement, from the de-energised state.

        The exported file gives the same numbers, sample by sample. It looks `preview` samples ahead, with the
        last value held beyond the end, and stays within its voltage limits.

        Raises:
            RecordingError: The shape or type is wrong, a value is not finite, or the displacement cannot be
                reached within the voltage limits.

        Warns:
            RecordingWarning: Samples exceed the displacements or rates of the recordings, or the motion is so
                small that it may be in another unit.

        Example:
            >>> seconds = np.arange(2000) / compensator.sample_rate_hz
            >>> reference = (4 - 3 * np.cos(2 * np.pi * 10 * seconds)) * np.minimum(1, seconds / 0.05)
            >>> compensator.predict(reference).shape
            (2000,)
        """
        yd = _signal(reference_um)
        low_um, high_um = self._reached_um
        check_reached("reference_um", yd, (low_um, high_um), "compensator")
        largest_um = float(np.abs(yd).max())
        if 0 < largest_um < LEAST_MOTION * (high_um - low_um):
            _warn(
                f"reaches only {largest_um:.3g} µm of the range {low_um:.3g} to {high_um:.3g} µm; "
                "if it is in mm, multiply by 1000"
            )
        ahead = yd[np.minimum(np.arange(len(yd)) + self.preview, len(yd) - 1)]
        self._step.reset()
        with torch.no_grad():
            u = self._step.block(torch.from_numpy(ahead)).numpy().copy()
        held, outside = self._step.held_inputs, self._step.outside_range
        self._step.reset()
        if held or outside:
            _warn(
                f"{held + outside} of {len(yd)} samples lie beyond the recorded displacements or rates, "
                f"{held} of them were held back; scale or slow the trajectory, or record such motions"
            )
        return u

    def track(
        self,
        reference_um: npt.ArrayLike,  # (time,), µm
        stage: Stage | str | Path | None = None,
        *,
        name: str = "reference",
        max_slew_v_s: float = math.inf,
    ) -> Tracked:
        """Follow a desired displacement in a simulated control loop, with and without compensation.

        Args:
            reference_um: Desired displacement at the sample rate of the compensator.
            stage: The stage to drive, its file, or the name of one of torchpi's own, `default`; by default
                the stage identified from the same recordings.
            name: Name of the trajectory in figures.
            max_slew_v_s: Slew-rate limit of the amplifier, V/s; the result names where it is reached.

        Raises:
            RecordingError: The reference has another shape or type, is not finite, constant or out of range.
            ArtifactError: There is no stage, or its sample rate differs.
            ConfigError: No stage has this name, or the slew rate is not positive.

        Example:
            >>> result = compensator.track(reference)
            >>> 3 * result.rms_um < result.without.on_true.whole.rms_um
            True
            >>> figure = result.plot()
        """
        given = Stage.load(stage) if isinstance(stage, str | Path) else stage
        plant = self.stage if given is None else given
        if plant is None:
            raise ArtifactError("stage: found none, expected one: this compensator was loaded without one")
        result = run_loop(
            self._step,
            plant,
            _signal(reference_um),
            fs_hz=self.sample_rate_hz,
            name=name,
            max_slew_v_s=max_slew_v_s,
        )
        return Tracked(**vars(result))

    def errors_on(self, recording: Recording, skip_s: float = 0.0) -> InverseErrors:
        """Compute the errors of the voltage over a recording, offline, in V, µm and per cent.

        Raises:
            RecordingError: Not one recording, one that no model can be judged on, or of another sample rate.
            ConfigError: The start-up transient is negative.
        """
        RecordingOptions(skip_s=skip_s)  # raises the same errors as for a file
        given = given_recordings(recording)
        if len(given) != 1:
            raise RecordingError(f"recording: found {len(given)} recordings, expected one")
        checked = _checked(given[0])
        if not math.isclose(checked.fs_hz, self.sample_rate_hz, rel_tol=1e-6):
            raise RecordingError(
                f"{checked.source or checked.name}: sampled at {checked.fs_hz:g} Hz, "
                f"expected {self.sample_rate_hz:g} Hz, the compensator's rate; resample it"
            )
        return _errors(self.inverse, checked, skip_s)

    def export(
        self, path: str | Path, to: str | Sequence[str] = ("torchscript", "c", "json", "page")
    ) -> list[Path]:
        """Write the files for a controller and the stage beside them, all or none; return their paths.

        Args:
            path: Path without suffix, or with that of one of the files; the formats add theirs.
            to: Formats of `torchpi export`, one or several: torchscript, c, fmu, pt2, json, page.

        Raises:
            ConfigError: A format is unknown.
            ArtifactError: The compensator lowers the voltage to raise the stage, the path is none, or a file
                cannot be written.

        Example:
            >>> [file.name for file in compensator.export("exports/mine", to=("torchscript", "json"))]
            ['mine.pt', 'mine.json', 'mine_stage.pt']
        """
        card = safety_card(self.inverse)
        if card.monotone is False:
            raise ArtifactError(f"{path}: {card.monotone_summary}")
        output = without_suffix(path)
        files = made_files(self.inverse, output, to)
        if self.stage is not None:
            files[exported_stage(output)] = self.stage.write
        write_together(files)
        return list(files)

    def __repr__(self) -> str:
        error = "" if self.errors is None else f", held-out error {self.errors.rms_percent:.2g} % rms"
        inverse = self.inverse
        return (
            f"Compensator({self.sample_rate_hz:g} Hz, preview {self.preview}, "
            f"{inverse.min_voltage_v:g}…{inverse.max_voltage_v:g} V{error})"
        )

    def _repr_html_(self) -> str:
        return compensator_html(self.inverse, self.form, self.errors, self.stage)

    @cached_property
    def _reached_um(self) -> tuple[float, float]:
        """Range, µm, of displacements reachable within the voltage limits or present in the recordings."""
        reached, trained = self.inverse.reach(), self.inverse.trained
        low, high = (0.0, 0.0) if trained is None else trained.range_um
        return min(low, reached.low_um), max(high, reached.high_um)

    @cached_property
    def _step(self) -> CompensatorStream:
        """The compiled step as it is exported; between calls it is in the rest state."""
        step = cast(CompensatorStream, script(self.inverse))
        warm(step)
        return step


def _warn(text: str) -> None:
    warnings.warn(f"reference_um: {text}", RecordingWarning, stacklevel=3)


def _refuse_to_refit(*_: object, **__: object) -> None:
    raise ConfigError(
        "fit: found a compensator that is already fitted and cannot be refitted; expected the class: "
        "compensator = Compensator.fit(recordings)"
    )


def _checked(recording: Recording) -> Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # they were shown when the recording was made
        check_recording(recording)
    return recording


def _signal(reference_um: npt.ArrayLike) -> Signal:
    source = MemorySource("reference_um", {"reference_um": reference_um})
    (yd,) = source.read(["reference_um"])
    if not len(yd):
        raise RecordingError("reference_um: 0 samples, expected at least one")
    check_values("reference_um", [("reference_um", yd)], source.place)
    return yd


def _errors(inverse: DirectInverse, recording: Recording, skip_s: float) -> InverseErrors:
    return inverse_errors(inverse, [inverse_pair(recording, inverse.preview, None, skip_s)])
