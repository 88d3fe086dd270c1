"""The parts of training against independent computations of the same numbers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.train.conftest import recording, write
from torchpi.identification import InversePair, inverse_pair
from torchpi.identification.projection import RIDGE
from torchpi.identification.recipe import spread_thresholds
from torchpi.operators.motion import Motion
from train.data import RecordingsData
from train.module import InverseTraining
from train.sensor_zero import fit_zero
from train.trainer import WholeCheckpoints
from train.windows import windows


def built(recordings: list[str], **settings: Any) -> InverseTraining:
    module = InverseTraining(plays=5, degree=2, **settings)
    module.build(RecordingsData(recordings=recordings, skip_s=0.05))
    return module


@pytest.mark.parametrize("samples", [1, 7, 333, 5000])
def test_losses_of_windows_with_carried_state_add_up_to_that_of_whole_records(
    recordings: list[str], samples: int
) -> None:
    module = built(recordings, optimizer="adam", creep_time_constants_s=[0.1], preview=1)
    losses = []
    with torch.no_grad():
        module.compensator.creep_gains.fill_(-0.02)
        for cut in (samples, None):
            batches = [module.training_step([window], 0) for window in windows(module.split.train, cut)]
            losses.append(sum(float(loss) for loss in batches if loss is not None))
    assert losses[0] == pytest.approx(losses[1], rel=1e-12)
    if samples == 7:  # the loss is scaled to 1 at the start, where the creep gains are 0
        with torch.no_grad():
            module.compensator.creep_gains.zero_()
            whole = [module.training_step([window], 0) for window in windows(module.split.train, None)]
        assert float(sum(whole)) == pytest.approx(1.0, rel=1e-12)


@given(samples=st.integers(1, 40), first=st.integers(0, 29), length=st.integers(1, 30))
def test_windows_count_every_counted_sample_once(samples: int, first: int, length: int) -> None:
    time = torch.arange(30.0)[None]
    pair = InversePair("r", Motion(time, time, time), time, slice(first, min(first + length, 30)), 1e-3)
    cut = list(windows([pair], samples))
    assert [window.begins for window in cut] == [True] + [False] * (len(cut) - 1)
    assert torch.equal(torch.cat([window.u for window in cut], 1), time)
    counted = torch.cat([window.u[:, window.counted] for window in cut], 1)
    assert torch.equal(counted, time[:, pair.counted])


@pytest.mark.parametrize("rate", ["none", "linear", "neural"])
def test_projected_weights_are_the_least_squares_solution(recordings: list[str], rate: str) -> None:
    module = built(recordings, rate=rate, offset=True)
    batch = list(windows(module.split.train, None))
    loss = module._projected_loss(batch).item()
    columns, wanted = [], []
    with torch.no_grad():
        for window in batch:
            h, _ = module.compensator.play_states(window.motion)
            basis = module.compensator.weights.basis(window.motion.yd_dot)
            each = (h[..., :, None] * basis[..., None, :]).flatten(2)
            columns.append(torch.cat([each, torch.ones_like(each[..., :1])], 2)[0, window.counted])
            wanted.append(window.u[0, window.counted])
        features, u = torch.cat(columns), torch.cat(wanted)
        # With the ridge as additional rows, the same minimum is found without the normal equations.
        size = features.square().mean(0).sqrt()
        penalty = (RIDGE * len(features)) ** 0.5 * torch.eye(len(size), dtype=torch.float64)
        rows = torch.cat([features / size, penalty])
        wanted_rows = torch.cat([u, torch.zeros(len(size), dtype=torch.float64)])[:, None]
        best = torch.linalg.lstsq(rows, wanted_rows, driver="gelsd").solution / size[:, None]
        least = float((features @ best - u[:, None]).square().mean()) / module.scale
    assert loss == pytest.approx(least, rel=1e-6)


def test_the_gradient_of_the_projected_loss_matches_finite_differences(recordings: list[str]) -> None:
    module = built(recordings, lead=1, creep_time_constants_s=[0.05], rate="linear", offset=True)
    batch = list(windows(module.split.train, None))
    compensator = module.compensator
    with torch.no_grad():  # away from the start, where some slopes vanish
        compensator.scaled_lead.fill_(0.3)
        compensator.creep_gains.fill_(-0.03)
    module._projected_loss(batch).backward()
    for parameter in (compensator.scaled_lead, compensator.creep_gains, compensator.saturation.scaled):
        for index in range(parameter.numel()):
            step, losses = 1e-4, []
            for sign in (1, -1):
                with torch.no_grad():
                    parameter[index] += sign * step
                    losses.append(module._projected_loss(batch).item())
                    parameter[index] -= sign * step
            slope = (losses[0] - losses[1]) / (2 * step)
            assert parameter.grad is not None
            assert float(parameter.grad[index]) == pytest.approx(slope, rel=1e-2, abs=1e-6)


def test_weights_that_are_solved_for_are_not_optimised(recordings: list[str]) -> None:
    module = built(recordings, offset=True)
    searched = {
        id(parameter) for group in module.configure_optimizers().param_groups for parameter in group["params"]
    }
    assert searched == {id(module.compensator.saturation.scaled)}
    adam = built(recordings, offset=True, optimizer="adam").configure_optimizers()
    assert sum(len(group["params"]) for group in adam.param_groups) == 3


def test_the_zero_of_a_sensor_is_estimated(recordings: list[str]) -> None:
    data = RecordingsData(recordings=recordings)
    module = InverseTraining(plays=5, degree=2)
    module.build(data)
    pair = inverse_pair(data.load().heldout[0])
    at_rest = fit_zero(module.compensator, pair)
    shifted = pair._replace(motion=pair.motion._replace(yd=pair.motion.yd + 0.25))
    assert abs(at_rest) < 0.05
    assert fit_zero(module.compensator, shifted) == pytest.approx(at_rest + 0.25, abs=2e-3)


@given(plays=st.integers(1, 60), span=st.floats(0.01, 1000))
def test_thresholds_start_at_zero_and_are_denser_near_it(plays: int, span: float) -> None:
    r = torch.tensor(spread_thresholds(plays, span), dtype=torch.float64)
    assert r[0] == 0 and len(r) == plays and bool((r <= 0.5 * span).all())
    assert bool((r.diff() > 0).all()) and bool((r.diff().diff() > 0).all())


def test_a_kill_during_writing_leaves_the_previous_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "last.ckpt"
    WholeCheckpoints().save_checkpoint({"epoch": 1}, path)

    def killed(checkpoint: Any, temporary: Path) -> None:
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr("train.trainer.save_tensors", killed)
    with pytest.raises(KeyboardInterrupt):
        WholeCheckpoints().save_checkpoint({"epoch": 2}, path)
    assert torch.load(path, weights_only=True) == {"epoch": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == ["last.ckpt"]


@pytest.mark.parametrize("more", [0, 3])
def test_preview_auto_equals_the_delay_of_the_displacement_in_samples(more: int, tmp_path: Path) -> None:
    files = []
    for seed in range(3):
        made = recording(f"r{seed}", seed)
        later = np.concatenate([np.zeros(more), made.y])[: len(made)]
        files.append(write(tmp_path, replace(made, y=later)))
    # The stage of these tests has a delay of one sample itself.
    assert built(files, preview="auto").compensator.preview == 1 + more
