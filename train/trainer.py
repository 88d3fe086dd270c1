"""The Lightning trainer of a run: few options, early stopping, complete best and last checkpoints."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightning import Trainer
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import EarlyStopping, ModelCheckpoint
from lightning.pytorch.plugins.io import TorchCheckpointIO

from torchpi.cli.workers import available_cores
from torchpi.errors import ConfigError
from torchpi.files import save_tensors, write_atomically

from .callbacks import EpochProgress, RunEvents, TensorBoardFigures
from .module import CHOSEN_BY
from .run_folder import RunFolder

MOST_NODES = 1000
OWN = ("callbacks", "logger", "plugins")
"""Arguments of lightning.Trainer that are objects and that every run sets itself."""


@dataclass
class TrainerOptions:
    """Duration and display of the training.

    Args:
        max_epochs: Maximum number of epochs; with lbfgs one epoch is `model.iterations` iterations.
        patience: Stop after this many epochs without a smaller held-out error.
        figures_every: Number of epochs between figures in TensorBoard; the last epoch always has them.
        progress: Show a progress bar.
        lightning: Further options of lightning.Trainer, by name.
    """

    max_epochs: int = 60
    patience: int = 10
    figures_every: int = 20
    progress: bool = True
    lightning: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        for name in ("max_epochs", "patience"):
            if getattr(self, name) < 1:
                raise ConfigError(f"trainer.{name}: found {getattr(self, name)}, expected at least 1")


def make_trainer(options: TrainerOptions, folder: RunFolder) -> Trainer:
    """Return a trainer that writes into `folder`, which need not exist yet."""
    for name in OWN:
        if name in (options.lightning or {}):
            raise ConfigError(
                f"trainer.lightning.{name}: found a value, expected none: each run sets its own"
            )
    if (device := (options.lightning or {}).get("accelerator", "cpu")) != "cpu":
        why = "recordings and compiled kernels stay on the CPU, where sequences in float64 are fastest"
        raise ConfigError(f"trainer.lightning.accelerator: found {device!r}, expected 'cpu': {why}")
    for name, most in (("devices", available_cores()), ("num_nodes", MOST_NODES)):  # each is a process
        given = (options.lightning or {}).get(name, 1)
        count = len(given) if isinstance(given, list) else given
        if str(count).isdigit() and int(count) > most:
            raise ConfigError(f"trainer.lightning.{name}: found {count}, expected at most {most}")
    progress = [EpochProgress(options.max_epochs)] if options.progress else []
    settings: dict[str, Any] = dict(
        max_epochs=options.max_epochs,
        accelerator="cpu",
        devices=1,
        logger=RunEvents(folder.path, name="", version="", default_hp_metric=False),
        callbacks=[
            *progress,
            TensorBoardFigures(options.figures_every),
            EarlyStopping(CHOSEN_BY, patience=options.patience, check_finite=True),
            ModelCheckpoint(
                folder.checkpoints,
                folder.best.stem,
                CHOSEN_BY,
                enable_version_counter=False,
                save_on_train_epoch_end=True,
            ),
            ModelCheckpoint(
                folder.checkpoints,
                folder.last.stem,
                enable_version_counter=False,
                save_on_train_epoch_end=True,
            ),
        ],
        plugins=[WholeCheckpoints()],
        # The records are few and in memory, and `EpochProgress` is the only line of progress.
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        log_every_n_steps=1,
    )
    try:
        return Trainer(**settings | (options.lightning or {}))
    except (MisconfigurationException, TypeError, ValueError) as error:
        raise ConfigError(f"trainer: {' '.join(str(error).split())}") from error


class WholeCheckpoints(TorchCheckpointIO):
    """Replaces the previous checkpoint atomically, so that a kill leaves one complete checkpoint."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        with write_atomically(Path(path)) as temporary:
            save_tensors(checkpoint, temporary)
