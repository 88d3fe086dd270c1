"""The trained model: a direct inverse compensator, by backpropagation through time over recordings."""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, cast

import torch
from lightning import LightningModule
from lightning.pytorch.core.optimizer import LightningOptimizer
from torch import Tensor

from torchpi.control.direct_inverse import MOST_PLAYS, DirectInverse
from torchpi.control.trained import to_checkpoint
from torchpi.errors import ConfigError
from torchpi.identification import (
    InverseErrors,
    TwoStageResult,
    fit_joint,
    fit_two_stage,
    inverse_errors,
    searched_parameters,
)
from torchpi.identification.projection import projected_loss
from torchpi.identification.recipe import MOST_PREVIEW, Recipe
from torchpi.identification.selection import Form, Richest, Selection
from torchpi.identification.two_stage import fit_weights
from torchpi.operators.rate_weights import RateHead
from torchpi.recordings.identity import recordings_sha256
from torchpi.stage import Stage

from .coordinates import Coordinates
from .data import RecordingsData, Split
from .preview import find_preview
from .sensor_zero import fit_zeros
from .tracking import Tracking, TrackingErrors
from .windows import Window, windows

CHOSEN_BY = "chosen_by"
"""Logged error that selects the epoch, on a separate stretch if there is one. It has no chart."""
TAGS = {
    "error_um": "rms_um",
    "error_v": "rms_v",
    "largest_error_um": "max_um",
    "largest_error_v": "max_v",
}
"""Errors by their names in TensorBoard, which sorts them by name."""
TRACKING_TAG = "error_tracking_um"


class Start(NamedTuple):
    """Starting point of training, and the baselines that it must beat.

    Attributes:
        compensator: Compensator at the optimum of two-stage least squares, or as selected.
        baseline: The same in the form of the paper.
        plays: Plain least squares on plays of the displacement, with an offset.
        two_stage: Result of the fit of the baseline.
        split: The records for the look-ahead of the compensator.
        paper_split: The records without look-ahead.
        selection: Steps by which the form was selected, if it was.
    """

    compensator: DirectInverse
    baseline: DirectInverse
    plays: DirectInverse
    two_stage: TwoStageResult
    split: Split
    paper_split: Split
    selection: Selection | None


class InverseTraining(LightningModule):
    """A direct inverse: displacement in, voltage out (Qin et al. 2013, eq. 6 to 8, and extensions).

    Training starts from the paper's two-stage least squares and minimises the mean squared error of the
    voltage over the counted samples, relative to that of the start. With a stage to train through, it starts
    from the identification on that stage and minimises the error of the motion.

    Args:
        select: Select the form by cross-validation over the training recordings: the options below then
            describe the richest form considered, with or without an offset. The selection starts from least
            squares on plays of the displacement and keeps that form if no other generalises better. It cannot
            run backwards over the recorded range and rates. Nothing is left to train.
        stage: Train through this stage, a stage.pt of `torchpi diagnose` or a stage file (YAML), on the
            motions of data.follow.
        thresholds: Thresholds r of the plays, in the unit of S(y), about µm; the first one is 0. By default
            `plays` of them, spread over the range of the recordings, denser near 0.
        plays: Number of thresholds, if none are given.
        degree: Degree of the saturation polynomial S (eq. 4).
        output_degree: Degree of the plays' own output functions, for asymmetric loops; 1 as in the paper.
        rate: How the weights depend on the rate: none (eq. 6), linear (eq. 7) or neural.
        preview: Number of samples by which the desired trajectory is known ahead; 0 as in the paper. It
            compensates the delay of converter, amplifier and sensor. `auto` finds it from the recordings.
        lead: 0, 1 or 2. Compensates the stage's own lag (1) and also its first mode (2).
        creep_time_constants_s: Time constants of relaxations that compensate creep, s, such as [0.1, 1, 10].
            None by default.
        offset: Learn a constant voltage as well, for a sensor whose zero is arbitrary.
        min_voltage_v: Lower limit of the controller's output; by default that of `stage`, or the lowest
            voltage of the recordings.
        max_voltage_v: Upper limit of the controller's output; by default that of `stage`, or the highest.
        hidden: Size of the neural rate head.
        train_thresholds: Train the thresholds too.
        optimizer: lbfgs uses all records at once and is deterministic: best for few parameters.
            adam takes one step per window (data.window_samples), for records too long for memory.
        learning_rate: Learning rate of adam.
        solve_weights: With lbfgs, solve for the weights by least squares for each trial of the others.
        iterations: Number of lbfgs iterations per epoch.
    """

    def __init__(
        self,
        select: bool = False,
        stage: str | None = None,
        thresholds: list[float] | None = None,
        plays: int = 20,
        degree: int = 4,
        output_degree: int = 1,
        rate: RateHead = "linear",
        preview: int | Literal["auto"] = 0,
        lead: Literal[0, 1, 2] = 0,
        creep_time_constants_s: list[float] | None = None,
        offset: bool = False,
        min_voltage_v: float | None = None,
        max_voltage_v: float | None = None,
        hidden: int = 4,
        train_thresholds: bool = False,
        optimizer: Literal["lbfgs", "adam"] = "lbfgs",
        learning_rate: float = 1e-3,
        solve_weights: bool = True,
        iterations: int = 5,
    ) -> None:
        super().__init__()
        if not 1 <= plays <= MOST_PLAYS:
            raise ConfigError(f"model.plays: found {plays}, expected 1 to {MOST_PLAYS}")
        if not learning_rate > 0:
            raise ConfigError(f"model.learning_rate: found {learning_rate:g}, expected a positive number")
        if iterations < 1:
            raise ConfigError(f"model.iterations: found {iterations}, expected at least 1")
        if select:
            for name, found, expected in (
                ("stage", stage, None),
                ("output_degree", output_degree, 1),
                ("train_thresholds", train_thresholds, False),
                ("optimizer", optimizer, "lbfgs"),
            ):
                if found != expected:
                    raise ConfigError(f"model.{name}: found {found} with model.select, expected {expected}")
            if rate == "neural":
                raise ConfigError("model.rate: found neural with model.select, expected none or linear")
        self.selects = select
        # A selected form is already fitted.
        self.automatic_optimization = not select
        self.stage_file = stage
        self.thresholds = thresholds
        self.plays = plays
        self.form: dict[str, Any] = dict(degree=degree, offset=offset)
        self.given_limits = dict(min_voltage_v=min_voltage_v, max_voltage_v=max_voltage_v)
        self.extensions: dict[str, Any] = dict(
            output_degree=output_degree,
            rate=rate,
            preview=preview,
            lead=lead,
            creep_time_constants_s=creep_time_constants_s or [],
            hidden=hidden,
            train_thresholds=train_thresholds,
        )
        self.optimizer_name = optimizer
        self.learning_rate = learning_rate
        self.solves = solve_weights and optimizer == "lbfgs" and stage is None
        self.iterations = iterations
        self.compensator: DirectInverse
        self.baseline: DirectInverse
        self.plays_baseline: DirectInverse
        self.start: TwoStageResult
        self.selection: Selection | None = None
        self.split: Split
        self.paper_split: Split
        self.tracking: Tracking | None = None
        self.untrained: dict[str, TrackingErrors] = {}  # tracking of held-out motions before training
        self.coordinates: Coordinates  # used in training through a stage
        self.step_taken: torch.nn.Parameter
        self.scale = 1.0
        self.carried: Tensor | None = None

    def setup(self, stage: str) -> None:
        """Build the compensator and the baseline for the recordings, once."""
        if not hasattr(self, "compensator"):
            self.build(self.recordings_data())

    def recordings_data(self) -> RecordingsData:
        return cast(RecordingsData, self.trainer.datamodule)  # type: ignore[attr-defined]

    def load_stage(self) -> Stage | None:
        """Load the stage to train through, if there is one."""
        return Stage.load(self.stage_file) if self.stage_file else None

    def build(self, data: RecordingsData) -> None:
        """Build the compensator at the optimum of the paper, and the paper's form of it for comparison."""
        if self.optimizer_name == "lbfgs" and data.window_samples is not None:
            raise ConfigError(
                f"data.window_samples: found {data.window_samples} with model.optimizer lbfgs, "
                "which uses whole records; expected null, or model.optimizer adam"
            )
        start = self.start_on(data)
        data.preview = start.compensator.preview
        self.compensator, self.baseline, self.start = start.compensator, start.baseline, start.two_stage
        self.plays_baseline, self.selection = start.plays, start.selection
        self.split, self.paper_split = start.split, start.paper_split
        if data.stage is None:
            self.scale = self._mean_square()
        else:
            self.build_tracking(data, data.stage)

    def build_tracking(self, data: RecordingsData, stage: Stage) -> None:
        """Build the motions to follow; fit the start jointly, and another compensator on the plain stage."""
        recorded = torch.cat([pair.motion.yd[0, pair.counted] for pair in self.paper_split.train])
        rated = stage.at_sample_rate(1 / self.compensator.sample_period_s)
        self.tracking = Tracking(rated, data.follow, (float(recorded.min()), float(recorded.max())))
        fit_joint(self.compensator, self.split.train)
        self.untrained = {"before": self.tracking.errors(self.compensator)["heldout"]}
        if data.simulation:
            plain = self.start_on(data.of_stage(stage.plain()))
            fit_joint(plain.compensator, plain.split.train)
            self.untrained |= {"plain": self.tracking.errors(plain.compensator)["heldout"]}
        with torch.no_grad():
            self.scale = max(float(self.tracking.loss(self.compensator, {})), 1e-30)
        self.coordinates = self.tracking.coordinates(self.compensator)
        self.step_taken = torch.nn.Parameter(torch.zeros(len(self.coordinates), dtype=torch.float64))

    def start_on(self, data: RecordingsData) -> Start:
        """Return the start: two-stage least squares on these records, the baselines, and any selection."""
        paper_split = data.split(0)
        recipe = Recipe(
            paper_split.train,
            self.plays,
            self.thresholds,
            **self.form,
            **self.limits(data),
            recordings_sha256=recordings_sha256(data.load().train),
        )
        baseline = DirectInverse(**recipe.common, rate="linear")
        two_stage = fit_two_stage(baseline, paper_split.train)
        baseline.requires_grad_(False)
        plays = recipe.of_form(Form())
        fit_weights(plays, paper_split.train)
        plays.requires_grad_(False)
        selection = self.selected(data, recipe) if self.selects else None
        if selection:
            compensator = selection.compensator
            split = data.split(compensator.preview)
        else:
            preview = self.extensions["preview"]
            if preview == "auto":
                preview = find_preview(baseline, lambda ahead: data.split(ahead).train)
            split = data.split(preview)
            compensator = DirectInverse(**recipe.common, **{**self.extensions, "preview": preview})
            fit_two_stage(compensator, split.train)
        return Start(compensator, baseline, plays, two_stage, split, paper_split, selection)

    def selected(self, data: RecordingsData, recipe: Recipe) -> Selection:
        """Select the form that generalises best over these records within the options."""
        preview = self.extensions["preview"]
        richest = Richest(
            previews=range(MOST_PREVIEW + 1) if preview == "auto" else range(preview, preview + 1),
            degree=self.form["degree"],
            lead=self.extensions["lead"],
            creep_time_constants_s=tuple(self.extensions["creep_time_constants_s"]),
            rate=self.extensions["rate"] == "linear",
        )
        return recipe.select(lambda ahead: data.split(ahead).train, richest)

    def limits(self, data: RecordingsData) -> dict[str, float]:
        """Return the limits of the controller's output, V: given, of the stage, or of the recordings."""
        stage, records = data.stage, data.load()
        known = (stage.min_voltage_v, stage.max_voltage_v) if stage else (-math.inf, math.inf)
        voltages = [recording.u for recording in (*records.train, *records.heldout)]
        recorded = min(float(u.min()) for u in voltages), max(float(u.max()) for u in voltages)
        return {
            name: given if given is not None else own if math.isfinite(own) else otherwise
            for (name, given), own, otherwise in zip(self.given_limits.items(), known, recorded, strict=True)
        }

    def training_step(self, batch: Sequence[Window], batch_idx: int) -> Tensor | None:
        if self.selects:
            # Already fitted, but Lightning keeps a checkpoint only after a step of an optimiser.
            cast(LightningOptimizer, self.optimizers()).step()
            return None
        if self.tracking:
            parameters = self.coordinates.parameters(self.step_taken)
            return self.tracking.loss(self.compensator, parameters) / self.scale
        if self.solves:
            return self._projected_loss(batch)
        counted = sum(pair.counted.stop - pair.counted.start for pair in self.split.train)
        losses = []
        for window in batch:
            u, state = self.compensator.voltage(window.motion, None if window.begins else self.carried)
            self.carried = state.detach()
            if window.counted.stop > window.counted.start:
                losses.append((u - window.u)[:, window.counted].square().sum())
        # A window that lies in the start-up transient only sets the state.
        return torch.stack(losses).sum() / (counted * self.scale) if losses else None

    def on_train_epoch_end(self) -> None:
        if self.selects:
            self.trainer.should_stop = True

    def on_train_batch_end(self, outputs: Any, batch: Sequence[Window], batch_idx: int) -> None:
        if self.tracking:
            self.coordinates.put(self.step_taken)
        if self.solves and not self.selects:
            # The last trial of the line search may differ from the point that the optimiser chose.
            with torch.no_grad():
                self._projected_loss(batch)

    def validation_step(self, batch: Split, batch_idx: int) -> None:
        train, heldout = self.errors(batch)
        # If the zero of the sensor is fitted on a separate stretch, that stretch also selects the epoch,
        # so that the judged samples select nothing.
        chosen_by = heldout
        if batch.zero:
            zeros = fit_zeros(self.compensator, batch.zero)
            chosen_by = inverse_errors(self.compensator, batch.zero, zeros_um=zeros)
        loss = {"train": train.rms_v**2, "heldout": heldout.rms_v**2}
        for name, errors in (("train", train), ("heldout", heldout)):
            for tag, key in TAGS.items():
                self.log(f"{tag}/{name}", getattr(errors, key), batch_size=1)
        if self.tracking:
            followed = self.tracking.errors(self.compensator)
            loss = {name: errors.rms_um**2 for name, errors in followed.items()}
            for name, missed in followed.items():
                self.log(f"{TRACKING_TAG}/{name}", missed.rms_um, batch_size=1)
        self.log(CHOSEN_BY, loss["heldout"] if self.tracking else chosen_by.rms_v, batch_size=1)
        for name, square in loss.items():
            self.log(f"loss/{name}", square / self.scale, batch_size=1)

    def errors(self, split: Split) -> tuple[InverseErrors, InverseErrors]:
        """Return the errors of the current compensator on the training and on the held-out records."""
        return (
            inverse_errors(self.compensator, split.train),
            inverse_errors(self.compensator, split.heldout, zeros_um=fit_zeros(self.compensator, split.zero)),
        )

    def baseline_errors(self, baseline: DirectInverse | None = None) -> InverseErrors:
        """Return the errors of the two-stage baseline, or of another, on the held-out records."""
        baseline = baseline or self.baseline
        zeros = fit_zeros(baseline, self.paper_split.zero)
        return inverse_errors(baseline, self.paper_split.heldout, zeros_um=zeros)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        if self.selects:
            return torch.optim.SGD(self.compensator.parameters(), lr=0.0)
        parameters = (
            [self.step_taken]
            if self.tracking
            else searched_parameters(self.compensator, weights_are_solved=self.solves)
        )
        if self.optimizer_name == "adam":
            return torch.optim.Adam(parameters, self.learning_rate)
        return torch.optim.LBFGS(
            parameters,
            max_iter=self.iterations,
            history_size=20,
            tolerance_grad=1e-10,
            tolerance_change=1e-13,
            line_search_fn="strong_wolfe",
        )

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint.update(to_checkpoint(self.compensator))

    def _projected_loss(self, batch: Sequence[Window]) -> Tensor:
        """Return the loss at the weights that are optimal for the other parameters."""
        motions, voltages = [window.motion for window in batch], [window.u for window in batch]
        counted = [window.counted for window in batch]
        return projected_loss(self.compensator, motions, voltages, counted) / self.scale

    def _mean_square(self) -> float:
        """Return the mean squared error of the start, V², before the output limits, as in the loss."""
        with torch.no_grad():
            errors = [
                (self.compensator.voltage(window.motion)[0] - window.u)[:, window.counted]
                for window in windows(self.split.train, None)
            ]
        return max(float(torch.cat(errors, 1).square().mean()), 1e-30)
