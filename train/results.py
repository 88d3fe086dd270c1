"""Files of a run: settings before training, figures and exports after it, each written as a whole."""

import importlib.metadata
import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from typing import Any, cast

import torch
from lightning import Trainer
from lightning.pytorch.loggers import TensorBoardLogger

from torchpi.control.trained import STATE
from torchpi.diagnosis.forward_stage import ForwardStage, identify_stage
from torchpi.export import export_files
from torchpi.files import config_file, write_text
from torchpi.identification import inverse_errors
from torchpi.identification.monotone import Monotone, monotone
from torchpi.identification.recipe import MOST_PREVIEW
from torchpi.report.training import TrainingReport
from torchpi.report.what_was_run import Provenance

from .data import HELDOUT_SHARE, RecordingsData
from .module import InverseTraining
from .pictures import record_fits, saturation, weights_against_rate
from .run_folder import RunFolder
from .sensor_zero import fit_zeros, on_bound
from .tracking import tracking_notes

PACKAGES = ("torchpi", "torch", "lightning", "numpy", "scipy", "numba")


def write_settings(
    folder: RunFolder, command: str, config: str, data: RecordingsData, seed: int, stage_file: str | None
) -> None:
    """Write config.yaml and run.json, which suffice to repeat the run and to check that it is the same."""
    records = data.load()
    stage = (
        {stage_file: sha256(config_file(stage_file, "stage").read_bytes()).hexdigest()} if stage_file else {}
    )
    facts = {
        "command": command,
        "seed": seed,
        "data_sha256": {
            recording.source: recording.sha256 for recording in [*records.train, *records.heldout]
        }
        | stage,
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
        "machine": f"{platform.system()} {platform.machine()}",
    }
    write_text(folder.config, config)
    write_text(folder.facts, json.dumps(facts, indent=2, ensure_ascii=False) + "\n")


def write_results(
    folder: RunFolder, trainer: Trainer, model: InverseTraining, data: RecordingsData
) -> dict[str, Any]:
    """Judge the best checkpoint, write all files, and return the metrics."""
    best = torch.load(folder.best, map_location="cpu", weights_only=True)
    model.cpu().compensator.load_state_dict(best[STATE])
    metrics: dict[str, Any] = judge(model, data) | judge_tracking(model)
    metrics["how"] = how(model, data, int(best["epoch"]) + 1, trainer.current_epoch)
    if not data.simulation:
        identified = forward_stage(data)
        identified.stage.save(folder.stage)
        metrics["stage"] = stage_metrics(identified)
    export_files(model.compensator, folder.compensator.with_suffix(""))
    export_files(model.baseline, folder.baseline.with_suffix(""), ["torchscript"])
    _write_report(folder, model, metrics)
    _log_hyper_parameters(trainer, model, metrics)
    # Written last, so that a run folder with metrics is complete.
    write_text(folder.metrics, json.dumps(metrics, indent=2, ensure_ascii=False) + "\n")
    return metrics


def judge(model: InverseTraining, data: RecordingsData) -> dict[str, dict[str, float]]:
    """Return the errors under the keys of metrics.json."""
    train, heldout = model.errors(model.split)
    zeros = fit_zeros(model.compensator, model.split.zero)
    loaded = inverse_errors(model.compensator, model.split.heldout, loading_excluded=True, zeros_um=zeros)
    return {
        "train": train.as_dict(),
        "heldout": heldout.as_dict(),
        "baseline_lstsq": model.baseline_errors().as_dict(),
        "baseline_plays": model.baseline_errors(model.plays_baseline).as_dict(),
        "loading_excluded": loaded.as_dict(),
    }


def forward_stage(data: RecordingsData) -> ForwardStage:
    """Identify the stage from the training recordings, judged on the same samples as the compensator."""
    records, split = data.load(), data.split(0)
    heldout, counted = (records.heldout or records.train)[0], split.heldout[0].counted
    train = records.train if records.heldout else [heldout.split_tail(1 - counted.start / len(heldout))[0]]
    found = identify_stage(train, heldout, judged=counted, skip_s=data.skip_s)
    return found


def stage_metrics(identified: ForwardStage) -> dict[str, Any]:
    """Return the effects of the identified stage and its error on the held-out samples."""
    stage = identified.stage
    assert stage.identified is not None
    return {
        "heldout": stage.identified.heldout,
        "heldout_rms_um": stage.identified.heldout_rms_um,
        "heldout_max_um": stage.identified.heldout_max_um,
        "effects": {one.kind.name: one.values for one in stage.effects},
    }


def judge_tracking(model: InverseTraining) -> dict[str, Any]:
    """Return errors of the held-out motions through the stage, for a compensator identified on its plain
    hysteresis (`plain`), on the stage itself (`before`), and for the one trained through it (`after`)."""
    if model.tracking is None:
        return {}
    after = model.tracking.errors(model.compensator)["heldout"]
    return {"tracking": {name: asdict(e) for name, e in (model.untrained | {"after": after}).items()}}


def how(model: InverseTraining, data: RecordingsData, best_epoch: int, epochs: int) -> dict[str, Any]:
    """Return the conditions under which the metrics were obtained."""
    records = data.load()
    return {
        "heldout": [recording.source for recording in records.heldout]
        or [f"last {100 * HELDOUT_SHARE:.0f} % of {records.train[0].source}"],
        "baseline_lstsq": "on held-out recordings: two-stage least squares (eq. 10, 11), same thresholds "
        "and degree, linear rate, no preview, lead or creep",
        "baseline_plays": "on held-out recordings: least squares on plays of the displacement with an "
        "offset, constant weights, no polynomial, preview, lead or creep",
        "selected": [{"form": str(step.form), "rms_v": step.rms_v} for step in model.selection.steps]
        if model.selection
        else None,
        "on_bound": at_their_bound(model),
        "loading_excluded": "on held-out recordings, from where each first reaches its largest displacement",
        "skip_s": data.skip_s,
        "evaluate_s": data.evaluate_s,
        "zero_s": data.zero_s,
        "zeros_um": fit_zeros(model.compensator, model.split.zero),
        "baseline_zeros_um": fit_zeros(model.baseline, model.paper_split.zero),
        "epoch_chosen_by": chosen_by(model, data),
        "monotone": bool(rises := check_monotone(model)),
        "monotone_summary": str(rises),
        "best_epoch": best_epoch,
        "epochs": epochs,
    }


def at_their_bound(model: InverseTraining) -> list[str]:
    """List in words the fitted numbers that lie at a bound of their search."""
    found = []
    fitted = (
        ("compensator", model.compensator, model.split.zero),
        ("two-stage baseline", model.baseline, model.paper_split.zero),
        ("baseline of plays", model.plays_baseline, model.paper_split.zero),
    )
    for name, compensator, stretches in fitted:
        zeros = fit_zeros(compensator, stretches) or []
        found += [
            f"the zero of {stretch.name}, fitted for the {name}, is {zero_um:.4g} µm, "
            "at the bound of its search"
            for zero_um, stretch in zip(zeros, stretches, strict=True)
            if on_bound(zero_um, stretch)
        ]
    if model.extensions["preview"] == "auto" and model.compensator.preview == MOST_PREVIEW:
        found.append(f"the look-ahead is {MOST_PREVIEW} samples, the largest number tried")
    return found


def chosen_by(model: InverseTraining, data: RecordingsData) -> str:
    """State in words which error selected the epoch."""
    if model.tracking:
        return "tracking of the held-out motions of data.follow"
    if model.selection:
        return "none: fitted by least squares, its form selected on the training records alone"
    return "held-out rms_v" + (" on zero_s, outside the evaluated stretch" if data.zero_s else "")


def check_monotone(model: InverseTraining) -> Monotone:
    """Check whether the compensator is monotone over the displacements and rates of the training."""
    yd = torch.cat([pair.motion.yd[0, pair.counted] for pair in model.split.train])
    rate = torch.cat([pair.motion.yd_dot[0, pair.counted] for pair in model.split.train])
    return monotone(
        model.compensator, (float(yd.min()), float(yd.max())), (float(rate.min()), float(rate.max()))
    )


def _write_report(folder: RunFolder, model: InverseTraining, metrics: dict[str, Any]) -> None:
    from torchpi.report.page import write_training_report

    facts = json.loads(folder.facts.read_text(encoding="utf-8"))
    report = TrainingReport(
        name=folder.path.name,
        metrics={key: row for key, row in metrics.items() if key not in ("how", "tracking", "stage")},
        records=record_fits(model),
        weights=weights_against_rate(model),
        saturation=saturation(model),
        notes=(*notes(metrics["how"]), *tracking_notes(metrics), *stage_notes(metrics)),
    )
    provenance = Provenance(
        facts["command"], facts["seed"], facts["data_sha256"], facts["versions"], facts["machine"]
    )
    write_training_report(report, provenance, folder.report)


def notes(how: dict[str, Any]) -> tuple[str, ...]:
    """Return the notes that a reader of the page needs to interpret the numbers."""
    remarks = [f"Held out: {', '.join(how['heldout'])}."]
    remarks += [f"Careful: {text}." for text in how["on_bound"]]
    if how["selected"]:
        form = how["selected"][-1]["form"]
        remarks.append(f"Form selected by cross-validation over the training recordings: {form}.")
    if not how["monotone"]:
        remarks.append(f"Careful: {how['monotone_summary']}.")
    if how["evaluate_s"]:
        remarks.append("Evaluated from {:g} s to {:g} s of each held-out record.".format(*how["evaluate_s"]))
    if how["zero_s"]:
        remarks.append(
            "The zero of the sensor is arbitrary: one number, fitted from {:g} s to {:g} s. The error is the "
            "offline residual of the inverse on a recording; no stage tracked a motion with it.".format(
                *how["zero_s"]
            )
        )
    return tuple(remarks)


def stage_notes(metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """Describe the identified stage in a sentence, if there is one."""
    if "stage" not in metrics:
        return ()
    found = metrics["stage"]
    effects = ", ".join(name.replace("_", " ") for name in found["effects"]) or "no dynamics"
    return (
        f"stage.pt simulates your stage (hysteresis, {effects}): its error on {found['heldout']}, held out, "
        f"is {1e3 * found['heldout_rms_um']:.3g} nm rms.",
    )


def _log_hyper_parameters(trainer: Trainer, model: InverseTraining, metrics: dict[str, Any]) -> None:
    logger = cast(TensorBoardLogger, trainer.logger)
    parts = ("train", "heldout", "baseline_lstsq")
    shown = {f"result/{part}_rms_um": metrics[part]["rms_um"] for part in parts}
    logger.log_hyperparams(
        {
            key: value if isinstance(value, int | float | str) else str(value)
            for key, value in model.compensator.hyper_parameters.items()
        },
        shown,
    )
    logger.finalize("success")


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed as a package"
