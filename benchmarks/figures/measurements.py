"""How each figure is measured: what is run, and how the values are read from its results."""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks import mirror_folds as folds
from benchmarks import multi_axis_steps, profile_demo, readme_check
from benchmarks.figures.pages import ROOT
from tests.diagnosis import simulations
from torchpi.commission.commission import commission, followed
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.excitation.limits import DriveLimits
from torchpi.excitation.sets import diagnostic_excitations
from torchpi.excitation.signals import sine_5hz
from torchpi.identification import inverse_pair
from torchpi.identification.multi_axis.properties import loop_of, static_gain_of
from torchpi.loop.result import COMPENSATED, WITHOUT
from torchpi.recordings.options import RecordingOptions
from torchpi.stage import Stage
from torchpi.stage.multi_axis import MultiAxisStage

DATA = ROOT.parent / "shared" / "data"
DEFAULT_STAGE = ROOT / "configs" / "stage" / "default.yaml"
NM = 1e3  # in a micrometre
MIRROR_PEAK_V = 0.3


def default_stage() -> dict[str, float]:
    """Reach and loop of the built-in stage, from 0 to 10 V at 5 Hz."""
    stage = Stage.from_yaml(DEFAULT_STAGE).requires_grad_(False)
    _, u = sine_5hz(0.6, stage.sample_rate_hz)
    y = stage(torch.tensor(u)[None])[0][0].numpy()
    period = round(stage.sample_rate_hz / 5)
    # The last loop. At low frequency the displacement lags its command by 1.85 samples.
    u, y = u[2 * period - 2 : 3 * period - 2], y[2 * period :]
    at = np.linspace(0.1, 9.9, 200)
    up = np.interp(at, u[: period // 2], y[: period // 2])
    down = np.interp(at, u[period // 2 :][::-1], y[period // 2 :][::-1])
    return {"stage_reach_um": y.max(), "stage_loop_percent": 100 * (down - up).max() / np.ptp(y)}


def diagnostic_set() -> dict[str, float]:
    """Total duration of the excitations for a diagnosis, with the limits in the README."""
    limits = DriveLimits(0.0, 10.0, 2000.0, 10_000.0, 200.0)
    samples = sum(len(u) for _, u in diagnostic_excitations(limits).values())
    return {"diagnostic_set_s": samples / limits.sample_rate_hz}


def piezo_stack() -> dict[str, float]:
    """Held-out errors of the recipe of configs/piezo_stack.yaml and of its two baselines, offline."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        run("-m", "train", "fit", "--config", "configs/piezo_stack.yaml", "--output", str(folder),
            "--data.recordings", json.dumps([str(DATA / "piezo_stack" / "Model_Vi_Do.dat")]),
            "--data.heldout", json.dumps([str(DATA / "piezo_stack" / "Test_Vi_Do_Di.dat")]),
            "--trainer.figures_every=0")  # fmt: skip
        metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    if metrics["how"]["on_bound"]:
        raise ValueError(f"piezo_stack: found {metrics['how']['on_bound']} on its bound, expected none")
    two_stage, plays = (metrics[f"baseline_{name}"]["rms_um"] for name in ("lstsq", "plays"))
    rms = metrics["heldout"]["rms_um"]
    return {
        "piezo_stack_um": rms,
        "piezo_stack_percent": metrics["heldout"]["rms_percent"],
        "piezo_stack_two_stage_um": two_stage,
        "piezo_stack_plays_um": plays,
        "piezo_stack_ratio": rms / min(two_stage, plays),
        "piezo_stack_forward_um": metrics["stage"]["heldout_rms_um"],
    }


def bouc_wen() -> dict[str, float]:
    """Residual on the held-out quarters, and parameters, of the recipe of configs/bouc_wen.yaml."""
    with tempfile.TemporaryDirectory() as temporary:
        config, folder = Path(temporary) / "bouc_wen.yaml", Path(temporary) / "run"
        content = (ROOT / "configs" / "bouc_wen.yaml").read_text(encoding="utf-8")
        config.write_text(content.replace("../shared/data", str(DATA)), encoding="utf-8")
        run("-m", "train", "fit", "--config", str(config), "--output", str(folder))
        metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    (heldout,) = metrics["heldout"]
    found = {
        "bouc_wen_heldout_um": heldout["rms_um"],
        "bouc_wen_noise_um": heldout["noise_rms_um"],
        "bouc_wen_mean_um": heldout["mean_period_rms_um"],
        "bouc_wen_mean_noise_um": heldout["mean_period_noise_rms_um"],
    }
    for name, parameter in (
        ("mass", "mass_kg"), ("damping", "damping_n_s_m"), ("stiffness", "stiffness_n_m"),
        ("alpha", "hysteretic_stiffness_n_m"), ("dissipation", "dissipation"), ("hardening", "hardening"),
    ):  # fmt: skip
        one = metrics["parameters"][parameter]
        found |= {f"bouc_wen_{name}": abs(one["value"]), f"bouc_wen_{name}_half": one["half_width_95"]}
    return found


def mirror() -> dict[str, float]:
    """Run configs/mirror.yaml with a realisation of each amplitude held out; its inverse and steps too."""
    heldout = ["100mV_train 4", "200mV_train 4", "300mV_train 5"]
    with tempfile.TemporaryDirectory() as temporary:
        config, folder = Path(temporary) / "mirror.yaml", Path(temporary) / "mirror"
        content = (ROOT / "configs" / "mirror.yaml").read_text(encoding="utf-8")
        content = content.replace("../shared/data", str(DATA)).replace("heldout: []", f"heldout: {heldout}")
        config.write_text(content, encoding="utf-8")
        began = time.monotonic()
        run("-m", "train", "fit", "--config", str(config), "--output", str(folder))
        found = {"mirror_fit_s": time.monotonic() - began}
        metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        exported = Path(temporary) / "exports" / "mirror"
        run("-m", "torchpi", "export", str(folder), "--output", str(exported))
        run("-m", "torchpi", "run", f"{exported}.json")
        tracked = json.loads((exported / "loop.json").read_text(encoding="utf-8"))["random"]
        random, steps = np.random.default_rng(0), exported.parent
        found["mirror_step_us"] = multi_axis_steps.in_c(steps / "mirror_forward.c", 1000, random)
        found["mirror_inverse_us"] = multi_axis_steps.in_c(steps / "mirror.c", 1000, random)
        stage = MultiAxisStage.load(folder / "stage.pt")
    for level, one in zip((100, 200, 300), metrics["heldout"], strict=True):
        found |= {f"mirror_{level}_um": one["rms_um"], f"mirror_{level}_noise_um": one["noise_rms_um"]}
    found |= {
        "mirror_tracking_percent": max(tracked["error_percent"]),
        "mirror_coupling_percent": np.max(tracked["coupling_percent"]),
        "mirror_linear_tracking_percent": max(tracked["linear_error_percent"]),
        "mirror_linear_coupling_percent": np.max(tracked["linear_coupling_percent"]),
    }
    for number in (1, 2, 3):
        found[f"mirror_loop_{number}_percent"] = 100 * loop_of(stage, number, MIRROR_PEAK_V).width
    gain = static_gain_of(stage, MIRROR_PEAK_V)
    found |= {f"mirror_gain_{o + 1}_{i + 1}": abs(float(gain[o, i])) for o in range(3) for i in range(3)}
    return {name: float(value) for name, value in found.items()}


def mirror_folds() -> dict[str, float]:
    """Errors of the mirror with every realisation left out in turn."""
    with tempfile.TemporaryDirectory() as temporary:
        levels = folds.measured(Path(temporary))
    found: dict[str, float] = {}
    for name, level in levels.items():
        number = name.removesuffix("mV")
        found[f"mirror_median_{number}_um"] = level.median_um
        found[f"mirror_worst_{number}_um"], found[f"mirror_worst_noise_{number}_um"] = level.worst
    return found


def mirror_without() -> dict[str, float]:
    """Errors of the mirror fitted without its middle amplitude, and of a model-free interpolation there."""
    with tempfile.TemporaryDirectory() as temporary:
        level = folds.measured(Path(temporary), folds.FOLDS[3:4], "200mV")["200mV"]
    between = folds.Between.of(folds.recorded(), "200mV")
    return {
        "mirror_without_um": level.median_um,
        "mirror_without_worst_um": level.worst[0],
        "mirror_without_not_linear_um": level.not_linear_um[0],
        "mirror_between_um": between.missed_um,
        "mirror_between_percent": 100 * between.share,
    }


def commissioning() -> dict[str, float]:
    """`torchpi commission` on the README's recordings, and its compensator on the true stage."""
    with readme_recordings() as paths:
        start = time.perf_counter()
        outcome = commission(
            paths,
            paths[0].parent / "commissioned",
            RecordingOptions(),
            "torchpi commission",
            log=lambda line: None,
        )
        seconds = time.perf_counter() - start
    pairs = [inverse_pair(one, 0, None, 0.0) for one in (*outcome.train, outcome.heldout)]
    *trained_um_s, heldout_um_s = (float(pair.motion.yd_dot.abs().max()) for pair in pairs)
    true = Stage.from_yaml(DEFAULT_STAGE).requires_grad_(False)
    on_true = followed(outcome.compensator, true, outcome.heldout, pairs[-1], None)
    beyond = outcome.loop.compensated.beyond_trained_share
    if beyond is None:
        raise ValueError("commission: found no share of samples beyond the training, expected one")
    return {
        "commission_without_nm": NM * outcome.without_um,
        "commission_with_nm": NM * outcome.with_um,
        "commission_stage_nm": NM * outcome.identified.heldout_rms_um,
        "commission_true_nm": NM * on_true.compensated.on_true.whole.rms_um,
        "commission_heldout_um_s": heldout_um_s,
        "commission_trained_um_s": max(trained_um_s),
        "commission_beyond_percent": 100 * beyond,
        "commission_s": seconds,
    }


def demo() -> dict[str, float]:
    """The demo's three commands: tracking on the fast trajectory, and where the processor time goes."""
    with tempfile.TemporaryDirectory() as temporary:
        spent = profile_demo.profiled(Path(temporary))
        loops = json.loads((Path(temporary) / "demo" / "loop.json").read_text(encoding="utf-8"))
    total_s = sum(sum(phases.values()) for phases in spent.values())
    drives = next(loop["drives"] for loop in loops["trajectories"] if loop["name"] == "fast")
    errors = {label: drives[label]["true_displacement"]["whole"] for label in drives}
    imports_s = sum(phases["starting Python, imports"] for phases in spent.values())
    pages_s = sum(spent[name]["page with its figures"] for name in ("fit", "run"))
    shares = {
        "training": spent["fit"]["training"],
        "pages": pages_s + spent["fit"]["figures in TensorBoard"],
        "imports": imports_s,
        "loop": spent["run"]["loop, sample by sample"],
    }
    return {
        "demo_without_max_percent": errors[WITHOUT]["max_percent"],
        "demo_without_nm": NM * errors[WITHOUT]["rms_um"],
        "demo_two_stage_nm": NM * errors["two-stage"]["rms_um"],
        "demo_nm": NM * errors[COMPENSATED]["rms_um"],
        "demo_s": total_s,
        **{f"demo_{name}_percent_of_time": 100 * seconds / total_s for name, seconds in shares.items()},
        "demo_rest_percent_of_time": 100 * (1 - sum(shares.values()) / total_s),
    }


def recipe(*options: str) -> list[dict[str, float]]:
    """Run benchmarks/recipe.py and return its rows."""
    with tempfile.TemporaryDirectory() as temporary:
        output = Path(temporary) / "recipe.json"
        run("benchmarks/recipe.py", *options, "--output", str(output))
        rows: list[dict[str, float]] = json.loads(output.read_text(encoding="utf-8"))
    return rows


def recipe_seed_1() -> dict[str, float]:
    """Ratios of the recipe's error to its better baseline's on real and simulated recordings."""
    ratios = [row["ratio"] for row in recipe()]
    return {
        "recipe_cases": len(ratios),
        "recipe_median": float(np.median(ratios)),
        "recipe_largest": max(ratios),
    }


def recipe_seed_2() -> dict[str, float]:
    """The same ratios on simulated stages that were not used for tuning."""
    ratios = sorted((row["ratio"] for row in recipe("--seeds", "2", "--only", "seed 2")), reverse=True)
    return {
        "recipe_other_cases": len(ratios),
        "recipe_other_worse": sum(ratio > 1.01 for ratio in ratios),
        "recipe_other_largest": ratios[0],
        "recipe_other_second": ratios[1],
    }


def recipe_single() -> dict[str, float]:
    """The same ratios for training on single records."""
    rows = recipe("--first_seed", "601", "--seeds", "8", "--only", "one sine,two sines")
    ratios = [row["ratio"] for row in rows]
    return {
        "recipe_single_cases": len(ratios),
        "recipe_single_worse": sum(ratio > 1 for ratio in ratios),
        "recipe_single_median": float(np.median(ratios)),
        "recipe_single_largest": max(ratios),
    }


def peers() -> dict[str, float]:
    """Held-out errors of the peers that need no package beyond those that torchpi needs."""
    printed = run("benchmarks/peers/compare.py", "--only", "torchpi,lstsq")
    rows = dict(re.findall(r"^\| ([^|]+) \|(?:[^|]*\|){2} ([\d.]+) \(", printed, re.MULTILINE))
    return {
        "peers_joint_v": float(rows["torchpi, joint"]),
        "peers_two_stage_v": float(rows["torchpi, two stages"]),
        "peers_lstsq_v": float(rows["lstsq on play states"]),
    }


def other_simulation() -> dict[str, float]:
    """Diagnoses against a simulation that can only be called, and against its recorded output."""
    recordings = simulations.recorded(simulations.stage(creep=True, cutoff_hz=100.0), samples=4000)
    calls = []

    def simulate(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
        calls.append(len(u_v))
        return simulations.wrong_mode(u_v, fs_hz)

    called = diagnose(recordings, simulate)
    column = diagnose([replace(one, simulated=simulate(one.u, one.fs_hz)) for one in recordings], "column")
    return {
        "simulation_calls": len(calls) - len(recordings),
        **corrections("called", called, "amplifier_lag", {"resonance", "creep"}),
        **corrections("column", column, "sensor_lag", set()),
    }


def corrections(how: str, found: Diagnosis, lag: str, others: set[str]) -> dict[str, float]:
    """Parameters and errors of one diagnosis of `other_simulation`, which must name these effects."""
    expected = {lag} | others
    named = {effect.name for effect in found.effects}
    if named != expected:
        raise ValueError(
            f"simulation, {how}: found {sorted(named)}, expected {sorted(expected)}, as on the page"
        )
    values = {
        effect.name: {one.name: float(one.value) for one in effect.parameters} for effect in found.effects
    }
    told = {
        "lag_hz": (lag, "cutoff_hz", 1.0),
        "creep_percent": ("creep", "per_decade", 100.0),
        "mode_hz": ("resonance", "frequency_hz", 1.0),
        "replaced_hz": ("resonance", "replaced_frequency_hz", 1.0),
    }
    return {
        f"simulation_{how}_{key}": scale * values[name][number]
        for key, (name, number, scale) in told.items()
        if name in named
    } | {
        f"simulation_{how}_given_nm": NM * found.nominal.heldout_rms_um,
        f"simulation_{how}_retuned_nm": NM * found.retuned.heldout_rms_um,
        f"simulation_{how}_augmented_nm": NM * found.augmented.heldout_rms_um,
    }


@contextmanager
def readme_recordings() -> Iterator[list[Path]]:
    """Make the recordings of the README's `torchpi simulate` lines in a folder that is removed afterwards."""
    lines, _ = readme_check.readme_lines((ROOT / "README.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as temporary:
        paths = []
        for words in lines:
            at = words.index("--output") + 1
            path = Path(temporary) / words[at]
            run("-m", "torchpi", *words[:at], str(path), *words[at + 1 :])
            paths.append(path)
        yield paths


def run(*words: str) -> str:
    """Run Python with these arguments in the checkout, in a process that ends with this one; return its
    output.

    Raises:
        ChildProcessError: It failed; the message has the end of its output.
    """
    command = [sys.executable, "-m", "benchmarks.figures.child", str(os.getpid()), *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        ending = " ".join((done.stderr or done.stdout).split())[-300:]
        raise ChildProcessError(f"python {' '.join(words[:3])}: found exit code {done.returncode}: {ending}")
    return done.stdout
