"""`torchpi train fit`: a LightningCLI that creates no files before the recordings have been checked.

In a checkout `python -m train fit` is the same. A wheel contains this package as `torchpi.train`, so its
modules use relative imports.
"""

import argparse
import logging
import shlex
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import jsonargparse
from lightning import Trainer
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI

from torchpi.cli.command_line import run_command
from torchpi.errors import ConfigError, RecordingWarning, TorchpiError

from . import console, multi_axis, oscillator, results
from .data import RecordingsData
from .module import InverseTraining
from .own_kind import config_with
from .parser import TrainParser
from .run_folder import RunFolder, check_continues, claim, new_run, run_to_continue
from .trainer import TrainerOptions, make_trainer

DESCRIPTION = """\
Train a direct inverse compensator on recordings of a piezo stage: voltage in, displacement out.

  torchpi train fit --config demo
  torchpi train fit --config recorded --data.recordings '[slow.csv, fast.csv, other.csv]'
  torchpi train fit --config recorded --output runs/recorded --ckpt_path last

A config is a file, or the name of a built-in one: demo, recorded, through_stage, piezo_stack.
The last of several recordings is held out for validation and not fitted. The run folder contains
compensator.pt and compensator.json to deploy, report.html, metrics.json, the resolved config.yaml,
checkpoints, and events for `tensorboard --logdir runs`.
"""


PROGRAM = "python -m train"


def main(
    arguments: Sequence[str] | None = None,  # by default those of this process
) -> int:
    """Run the command and return its exit code, which is 2 for invalid input."""
    return run_command(lambda: fit(arguments), "torchpi")


def fit(
    arguments: Sequence[str] | None = None,
    program: str = PROGRAM,  # as it was called, for help and provenance
) -> None:
    """Run the command line."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    for own_kind in (multi_axis, oscillator):
        config = config_with(own_kind.SECTION, given)
        if config is not None:
            own_kind.fit(given, config)
            return
    quieten()
    FitCLI(given, program)


def quieten() -> None:
    """Suppress selected messages of Lightning and torch, each for the given reason; all others are shown."""
    # Unused devices, the seed (it is in run.json) and advertisements are all reported at level INFO.
    for name in ("lightning.pytorch.utilities.rank_zero", "lightning.fabric.utilities.seed"):
        logging.getLogger(name).setLevel(logging.WARNING)
    for message in (
        # The data are a list in memory, which workers would copy without benefit.
        ".*does not have many workers.*",
        # Full-batch training has one batch per epoch, and we log by epoch.
        ".*The number of training batches.*is smaller than the logging interval.*",
        # The user asked to continue from last.ckpt.
        ".*Checkpoint directory .* exists and is not empty.*",
        # Even on a machine with an accelerator, the CPU is fastest for these kernels.
        ".*GPU available but not used.*",
        # Lightning itself uses a torch function that torch renames.
        ".*isinstance.treespec, LeafSpec.. is deprecated.*",
        # `torchpi train` passes its arguments on.
        ".*LightningCLI's args parameter is intended to run from within Python.*",
        # The error that follows states what is wrong with the checkpoint.
        ".*received a zip file that looks like a TorchScript archive.*",
        # Exports are TorchScript, although it is deprecated.
        ".*torch.jit.*is deprecated.*",
    ):
        warnings.filterwarnings("ignore", message=message)


@contextmanager
def _settings_in_one_line() -> Iterator[None]:
    """Turn the errors that parsers, Lightning and NumPy raise for invalid values into one line."""
    try:
        yield
    except (TorchpiError, OSError, RecursionError):
        raise
    except (TypeError, ValueError, AttributeError, LookupError, OverflowError, AssertionError) as error:
        text = " ".join(str(error).split()) or "a value that cannot be used"
        raise ConfigError(f"settings: {text}") from error


class Formatter(argparse.RawDescriptionHelpFormatter, jsonargparse.DefaultHelpFormatter):
    """Keeps the line breaks of the description."""


class FitCLI(LightningCLI):
    """The command: `fit` only, with the trainer's options that matter here."""

    def __init__(self, arguments: list[str], program: str) -> None:
        self.command = shlex.join([*program.split(), *arguments])
        usage = f"{program} fit --config NAME [options]"
        super().__init__(
            InverseTraining,
            RecordingsData,
            save_config_callback=None,
            seed_everything_default=0,
            parser_class=TrainParser,
            parser_kwargs={
                "prog": program,
                "usage": usage,
                "description": DESCRIPTION,
                "formatter_class": Formatter,
                "fit": {
                    "usage": usage,
                    "description": DESCRIPTION,
                    "formatter_class": Formatter,
                },
            },
            auto_configure_optimizers=False,
            load_from_checkpoint_support=False,
            args=arguments,
        )

    @staticmethod
    def subcommands() -> dict[str, set[str]]:
        own = {"model", "train_dataloaders", "val_dataloaders", "datamodule", "ckpt_path", "weights_only"}
        return {"fit": own}

    def add_default_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument("--seed_everything", type=int, default=0, help="Seed of all random numbers.")

    def add_core_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_lightning_class_args(RecordingsData, "data")
        parser.add_lightning_class_args(InverseTraining, "model")
        parser.add_class_arguments(TrainerOptions, "trainer")

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument(
            "--output",
            type=str | None,
            help="New folder for the run; by default runs/NAME, or the next free one of runs/NAME-2, …",
        )
        parser.add_argument(
            "--ckpt_path",
            type=str | None,
            help="Continue from a checkpoint: 'last' for that of the output folder, or a file.",
        )

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:
        with _settings_in_one_line():
            super().parse_arguments(parser, args)
        # Removed, because Lightning would let the settings of the checkpoint overrule the given ones.
        self.checkpoint: str | None = self.config.fit.pop("ckpt_path", None)

    def before_instantiate_classes(self) -> None:
        config = self.config.fit
        name = Path(str(config.config[0])).stem if config.config else "run"
        if self.checkpoint == "last":
            self.folder: RunFolder = run_to_continue(config.output, name)
        else:
            self.folder = new_run(config.output, name, self.checkpoint)

    def instantiate_classes(self) -> None:
        with _settings_in_one_line():
            super().instantiate_classes()

    def _set_seed(self) -> None:
        with _settings_in_one_line():
            super()._set_seed()

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        options: TrainerOptions = self._get(self.config_init, "trainer")
        return make_trainer(options, self.folder)

    def fit(self, model: InverseTraining, datamodule: RecordingsData) -> None:
        """Read, fit, judge and write; no file is created before the recordings have been checked."""
        config = self.config.fit
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", RecordingWarning)
            with _settings_in_one_line():
                datamodule.stage = model.load_stage()
                datamodule.load()
            model.build(datamodule)
        console.show_data(datamodule, self.folder, [str(warning.message) for warning in caught])
        console.show_start(model)
        resumed = self.folder.last if self.checkpoint == "last" else self.checkpoint
        if resumed:
            check_continues(Path(resumed), model.compensator)
        with claim(self.folder, goes_on=self.checkpoint == "last"):
            results.write_settings(
                self.folder,
                self.command,
                self._parser("fit").dump(config, skip_none=False),
                datamodule,
                int(config.seed_everything),
                model.stage_file,
            )
            try:
                self.trainer.fit(model, datamodule=datamodule, ckpt_path=resumed, weights_only=True)
            except SystemExit as ended:
                # Lightning turns an interrupt or SIGTERM into exit code 1.
                console.show_interrupted(self.folder)
                cause = ended.__context__
                raise (cause if isinstance(cause, KeyboardInterrupt) else KeyboardInterrupt()) from None
            metrics = results.write_results(self.folder, self.trainer, model, datamodule)
            console.show_results(metrics, self.folder)


class _Made(Exception):
    """Raised once the parser exists, because there is nothing to parse."""


class Options(FitCLI):
    """The options of the command, for a shell's completions."""

    def __init__(self) -> None:
        quieten()
        with suppress(_Made):
            super().__init__([], PROGRAM)

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:
        raise _Made

    def parsers(self) -> dict[str, LightningArgumentParser]:
        """Return the parser of each subcommand."""
        return dict(self._subcommand_parsers)
