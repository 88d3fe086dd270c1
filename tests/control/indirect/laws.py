"""Laws that every compensator of this package obeys, as tests to inherit."""

import copy
import math

import numpy as np
import torch

from torchpi.excitation.trajectory import load_trajectory
from torchpi.export.torchscript import script
from torchpi.loop import run_loop
from torchpi.operators.motion import Motion, backward_motion
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.paper.fig7_plant import Fig7Plant


class DeployedLaws:
    """Laws of a compensator; a test class that inherits them defines how to build it, at 0.1 ms."""

    def compensator(self):
        raise TypeError(f"{type(self).__name__} must define compensator()")

    def test_stream_gives_the_same_bits_as_the_record(self, motion: Motion) -> None:
        compensator = self.compensator()
        expected = compensator(motion)[0].detach().tolist()
        stream = compensator.stream()
        assert [stream.step(yd) for yd in motion.yd[0].tolist()] == expected

    def test_scripted_stream_gives_the_same_bits_in_steps_and_in_a_block_after_a_reset(
        self, motion: Motion
    ) -> None:
        compensator = self.compensator()
        expected = compensator(motion)[0].detach()
        scripted = script(compensator)
        assert [scripted.step(yd) for yd in motion.yd[0].tolist()] == expected.tolist()
        scripted.reset()
        assert torch.equal(scripted.block(motion.yd[0]), expected)

    def test_windows_with_carried_state_give_the_same_bits(self, motion: Motion) -> None:
        compensator = self.compensator()
        whole, final = compensator.voltage(motion)
        first, state = compensator.voltage(Motion(*(part[:, :777] for part in motion)))
        second, state = compensator.voltage(Motion(*(part[:, 777:] for part in motion)), state)
        assert torch.equal(torch.cat([first, second], 1), whole)
        assert torch.equal(state, final)

    def test_an_input_that_is_not_finite_is_replaced_by_the_last_one_and_counted(self) -> None:
        stream, clean = self.compensator().stream(), self.compensator().stream()
        for yd, stands_in in ((1.0, 1.0), (1.1, 1.1), (math.nan, 1.1), (math.inf, 1.1), (1.2, 1.2)):
            assert stream.step(yd) == clean.step(stands_in)
        assert stream.held_inputs == 2

    def test_the_stream_may_include_the_reference_filter(self) -> None:
        compensator, reference = self.compensator(), ReferenceFilter(1e-4)
        yr = 2 + torch.sin(torch.linspace(0, 9, 500, dtype=torch.float64))[None]
        expected = compensator(reference(yr))[0].detach()
        stream = compensator.stream(reference)
        assert stream.has_reference_filter
        assert torch.equal(stream.block(yr[0]), expected)

    def test_it_runs_in_the_loop_on_the_fast_trajectory_of_the_paper(self) -> None:
        compensator = self.compensator()
        fast = load_trajectory("fast", fs_hz=1e4)
        result = run_loop(compensator.stream(), Fig7Plant(), fast.yd[:1500], fs_hz=1e4, name=fast.name)
        u = compensator(backward_motion(torch.from_numpy(_ahead(fast.yd[:1500], compensator.preview)), 1e-4))
        np.testing.assert_array_equal(result.compensated.u, u[0].detach().numpy())

    def test_output_stays_within_its_limits(self, motion: Motion) -> None:
        compensator = copy.deepcopy(self.compensator())
        free = compensator(motion).detach()
        low, high = free.quantile(0.2).item(), free.quantile(0.8).item()
        compensator.min_voltage_v, compensator.max_voltage_v = low, high
        assert torch.equal(compensator(motion), free.clamp(low, high))
        assert torch.equal(compensator.stream().block(motion.yd[0]), free[0].clamp(low, high))


def _ahead(yd: np.ndarray, preview: int) -> np.ndarray:
    return yd[np.minimum(np.arange(len(yd)) + preview, len(yd) - 1)][None]
