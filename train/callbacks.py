"""Display during training: a line of progress, and figures in TensorBoard."""

from collections.abc import Callable, Mapping
from typing import Any, cast

from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from . import console
from .module import CHOSEN_BY, TRACKING_TAG, InverseTraining
from .pictures import record_fits, weights_against_rate


class EpochProgress(Callback):
    """One progress bar over all epochs, with the current errors."""

    def __init__(self, epochs: int) -> None:
        self.epochs = epochs
        self.progress: Progress | None = None
        self.task = TaskID(0)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.progress = Progress(
            TextColumn("training"),
            BarColumn(20),
            TextColumn("epoch {task.completed:.0f}/{task.total:.0f}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[errors]}"),
            console=console.CONSOLE,
        )
        self.task = self.progress.add_task("", total=self.epochs, completed=trainer.current_epoch, errors="")
        self.progress.start()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        logged = trainer.callback_metrics
        tracking = f"{TRACKING_TAG}/train" in logged
        key, unit = (TRACKING_TAG, "nm") if tracking else ("error_v", "mV")
        train, heldout = (1e3 * float(logged[f"{key}/{part}"]) for part in ("train", "heldout"))
        assert self.progress is not None
        self.progress.update(
            self.task,
            completed=trainer.current_epoch + 1,
            errors=f"rms {train:.3g} {unit}, held out {heldout:.3g} {unit}",
        )

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._stop()

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        self._stop()

    def _stop(self) -> None:
        if self.progress is not None:
            self.progress.stop()
            self.progress = None


class RunEvents(TensorBoardLogger):
    """Events in the folder of the run, after which TensorBoard names it.

    The epoch and the quantity that selects it get no chart.
    """

    def log_metrics(self, metrics: Mapping[str, float], step: int | None = None) -> None:
        charted = {name: value for name, value in metrics.items() if name not in ("epoch", CHOSEN_BY)}
        super().log_metrics(charted, step)

    def save(self) -> None:
        self.experiment.flush()  # writes no hparams.yaml, because config.yaml has the settings


class TensorBoardFigures(Callback):
    """Loops, traces with residual, spectrum of the residual, weights against rate; and the charts."""

    def __init__(self, every: int) -> None:
        self.every = every
        self.drawn_at = -1

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        charts = {
            "rms error, V": "error_v",
            "largest error, V": "largest_error_v",
            "rms error, µm": "error_um",
        }
        if cast(InverseTraining, pl_module).tracking:
            charts = {"tracking error, µm": TRACKING_TAG, **charts}
        board: Any = cast(TensorBoardLogger, trainer.logger).experiment
        lines = {
            title: ["Multiline", [f"^{key}/train$", f"^{key}/heldout$"]] for title, key in charts.items()
        }
        board.add_custom_scalars({"training and held out": lines})

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if self.every > 0 and trainer.current_epoch % self.every == 0:
            self.draw(trainer, pl_module)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if self.drawn_at < trainer.current_epoch:
            self.draw(trainer, pl_module)

    def draw(self, trainer: Trainer, pl_module: LightningModule) -> None:
        # Imported here, because Matplotlib takes half a second to import and is needed only here.
        from torchpi.report import training_figures

        model = cast(InverseTraining, pl_module)
        board: Any = cast(TensorBoardLogger, trainer.logger).experiment
        heldout = record_fits(model)[0]
        figures: dict[str, Callable[..., Any]] = {
            "loop": training_figures.loop_figure,
            "trace": training_figures.traces_figure,
            "residual spectrum": training_figures.spectrum_figure,
        }
        for name, draw in figures.items():
            board.add_figure(name, draw(heldout), trainer.current_epoch)
        weights = weights_against_rate(model)
        if weights is not None:
            figure = training_figures.weights_figure(weights)
            board.add_figure("weights against rate", figure, trainer.current_epoch)
        self.drawn_at = trainer.current_epoch
