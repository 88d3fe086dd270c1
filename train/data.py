"""Training and held-out data: recordings from files, or of the simulated stage."""

import copy
import warnings
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from lightning import LightningDataModule
from torch.utils.data import DataLoader

from torchpi.errors import ConfigError, RecordingError, RecordingWarning
from torchpi.identification import InversePair, inverse_pair
from torchpi.identification.pair import seen_ahead
from torchpi.operators.motion import Motion
from torchpi.recordings.identity import check_one_rate
from torchpi.recordings.recording import Recording, RecordingOptions, read_recording
from torchpi.stage import Stage

from .simulation import Simulation, simulate
from .tracking import Follow
from .windows import Window, windows

HELDOUT_SHARE = 0.3


class Split(NamedTuple):
    """Records with input and output exchanged, for an inverse.

    Attributes:
        train: Records that are fitted.
        heldout: Records that are only judged, on the samples of `counted`.
        zero: The held-out records with `counted` where the zero of the sensor is fitted; may be empty.
    """

    train: list[InversePair]
    heldout: list[InversePair]
    zero: list[InversePair]


class RecordingsData(LightningDataModule):
    """Recordings of voltage and displacement, all at one sample rate: some to train on, some held out.

    Args:
        recordings: Files to train on: CSV with columns time_s,input_v,output_um, or any kind and columns
            with the options below.
        heldout: Files used only for validation. By default the last of several recordings is held out,
            or the last 30 % of a single one.
        simulate: Excitations of a simulated stage to use instead of files.
        follow: Motions to track in training, with model.stage.
        bandwidth_hz: Bandwidth of the motion, for its rates; by default found from each recording.
        evaluate_s: [start, stop]: evaluate only this stretch of the held-out records, s.
        zero_s: [start, stop]: fit the sensor zero of the held-out records on this stretch, s.
        window_samples: Train on windows of this many samples, with the state carried over, instead of
            whole records at once (with model.optimizer adam).
        reading: How the files are read.
    """

    def __init__(
        self,
        recordings: list[str] | str | None = None,
        heldout: list[str] | str | None = None,
        simulate: Simulation | None = None,
        follow: Follow | None = None,
        bandwidth_hz: float | None = None,
        evaluate_s: tuple[float, float] | None = None,
        zero_s: tuple[float, float] | None = None,
        window_samples: int | None = None,
        **reading: Any,
    ) -> None:
        super().__init__()
        options = RecordingOptions(**reading)
        if recordings and simulate:
            raise ConfigError(
                "data.recordings: found files beside data.simulate, expected one of the two; "
                "--config recorded is the recipe for files"
            )
        if not recordings and not simulate:
            raise ConfigError(
                "data.recordings: found none, expected at least one file, such as "
                "--data.recordings '[slow.csv, fast.csv]'"
            )
        if window_samples is not None and window_samples < 1:
            raise ConfigError(f"data.window_samples: found {window_samples}, expected at least 1, or null")
        self.paths, self.heldout_paths, self.simulation = _paths(recordings), _paths(heldout), simulate
        # The skipped start sets the state, so it is read but not counted.
        self.reading, self.skip_s = options.with_changes(skip_s=0.0), options.skip_s
        self.bandwidth_hz = bandwidth_hz
        self.evaluate_s = evaluate_s
        self.zero_s = zero_s
        self.window_samples = window_samples
        self.follow = follow or Follow()
        self.follow.check()
        self.stage: Stage | None = None  # stage of the model; if there is one, it is simulated
        self.preview = 0  # look-ahead of the model, once it is built
        self.records: Records | None = None
        self.whole: dict[Recording, InversePair] = {}  # without look-ahead

    def setup(self, stage: str) -> None:
        self.load()

    def load(self) -> "Records":
        """Read and check all recordings, once."""
        if self.records is None:
            train, heldout = self._read()
            check_one_rate([*train, *heldout])
            self.records = Records(train, heldout)
            self.split(self.preview)
        return self.records

    def of_stage(self, stage: Stage) -> "RecordingsData":
        """Return a copy with the same excitations, simulated with another stage."""
        other = copy.copy(self)
        other.stage, other.records = stage, None
        return other

    def split(self, preview: int) -> Split:
        """Return the records for an inverse with this preview."""
        records = self.load()
        if records.heldout:
            train = [self._pair(recording, preview) for recording in records.train]
            whole = [self._pair(recording, preview) for recording in records.heldout]
        else:
            pair = self._pair(records.train[0], preview)
            first, last = pair.counted.start, pair.counted.stop
            border = first + round((1 - HELDOUT_SHARE) * (last - first))
            train = [_until(pair._replace(counted=slice(first, border)))]
            whole = [pair._replace(counted=slice(border, last))]
        return Split(
            train,
            [self._stretch(pair, self.evaluate_s, "evaluate_s") for pair in whole],
            [self._stretch(pair, self.zero_s, "zero_s") for pair in whole] if self.zero_s else [],
        )

    def train_dataloader(self) -> DataLoader[list[Window]]:
        """Return all records in one batch, or each window as a batch, in order."""
        each = list(windows(self.split(self.preview).train, self.window_samples))
        return _batches([each] if self.window_samples is None else [[window] for window in each])

    def val_dataloader(self) -> DataLoader[Split]:
        """Return everything in one batch."""
        return _batches([self.split(self.preview)])

    def _read(self) -> tuple[list[Recording], list[Recording]]:
        if self.simulation:
            train, heldout = simulate(self.simulation, self.stage)
        else:
            train = [read_recording(path, self.reading) for path in self.paths]
            heldout = [read_recording(path, self.reading) for path in self.heldout_paths]
        for recording in heldout:
            same = [other.source for other in train if other.sha256 == recording.sha256]
            if same:
                raise RecordingError(
                    f"{recording.source}: held out, but identical to {same[0]}, which is "
                    "trained on; leave one out"
                )
        if not heldout and len(train) > 1:
            heldout = [train.pop()]
        if not heldout:
            warnings.warn(
                f"{train[0].source}: a single recording, its last {100 * HELDOUT_SHARE:.0f} % are held out; "
                "a second recording would test the fit on a different motion (data.heldout)",
                RecordingWarning,
                stacklevel=2,
            )
        return train, heldout

    def _pair(self, recording: Recording, preview: int) -> InversePair:
        # Cached: the rates of a long record take longer than many fits to it, and no look-ahead changes them.
        if recording not in self.whole:
            self.whole[recording] = inverse_pair(recording, 0, self.bandwidth_hz, self.skip_s)
        return seen_ahead(self.whole[recording], preview, recording.source)

    def _stretch(self, pair: InversePair, seconds: tuple[float, float] | None, option: str) -> InversePair:
        """Return the record up to the end of a stretch, with only the stretch counted."""
        if seconds is None:
            return _until(pair)
        first, last = (round(second / pair.sample_period_s) for second in seconds)
        if not 0 <= first < last or first >= pair.counted.stop:
            end_s = pair.counted.stop * pair.sample_period_s
            raise ConfigError(
                f"data.{option}: found {list(seconds)} s, expected a start and a later stop inside the "
                f"held-out '{pair.name}', 0 to {end_s:.4g} s"
            )
        return _until(pair._replace(counted=slice(first, min(last, pair.counted.stop))))


@dataclass(frozen=True)
class Records:
    """Training and held-out recordings; if `heldout` is empty, the tail of the only one is held out."""

    train: list[Recording]
    heldout: list[Recording] = field(default_factory=list)


def _paths(given: list[str] | str | None) -> list[str]:
    return [given] if isinstance(given, str) else given or []


def _batches(ready: list[Any]) -> DataLoader[Any]:
    """Return a loader that gives each item unchanged as a batch, in order."""
    return DataLoader(ready, batch_size=None, collate_fn=_as_it_is)  # type: ignore[arg-type]


def _as_it_is(batch: Any) -> Any:
    return batch


def _until(pair: InversePair) -> InversePair:
    """Return the record up to its last counted sample."""
    stop = pair.counted.stop
    motion = Motion(*(signal[:, :stop] for signal in pair.motion))
    return pair._replace(motion=motion, u=pair.u[:, :stop])
