"""The noise floor is read off rests, the converter off the readings."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import FS_HZ, creep, multisine, record, stairs
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnose import converter
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import Hypothesis
from torchpi.diagnosis.noise import noise_floor_um
from torchpi.diagnosis.nominal import plain
from torchpi.diagnosis.records import prepare
from torchpi.diagnosis.search import Search
from torchpi.recordings.recording import Recording


@pytest.mark.parametrize("noise_um", [4e-4, 4e-3, 0.05])
def test_the_floor_of_stairs_is_the_noise_though_the_stage_creeps(noise_um: float) -> None:
    one = record(stairs(8000), after=lambda x, fs_hz: creep(x, fs_hz, 0.02), noise_um=noise_um)
    assert noise_floor_um(prepare([one])) == pytest.approx(noise_um, rel=0.05)


def test_where_nothing_rests_there_is_no_floor() -> None:
    assert noise_floor_um(prepare([record(multisine(4000))])) is None


def test_a_rest_of_one_recording_serves_all() -> None:
    moving, resting = record(multisine(4000)), record(np.zeros(2000), noise_um=0.01, name="rest")
    assert noise_floor_um(prepare([moving, resting])) == pytest.approx(0.01, rel=0.1)


def read_by(lsb_um: float, one: Recording) -> Recording:
    y = lsb_um * np.floor(one.y / lsb_um + 0.5)
    return Recording(one.name, one.t, one.u, y, one.fs_hz)


def test_an_input_that_was_measured_repeats_though_its_last_digits_do_not() -> None:
    rng = np.random.default_rng(5)
    once = multisine(2000)
    one = record(np.tile(once, 3), noise_um=0.02)
    noisy = Recording(one.name, one.t, one.u + 1e-4 * rng.standard_normal(len(one.u)), one.y, one.fs_hz)
    assert noise_floor_um(prepare([noisy])) == pytest.approx(0.02, rel=0.1)


def test_the_floor_falls_to_what_a_fit_leaves_in_the_rests_and_never_rises() -> None:
    records = prepare([record(stairs(8000), noise_um=0.02)])
    search = Search(Chain(records), print, floor_um=noise_floor_um(records))
    one = fit(search.chain, Hypothesis(plain(search.seen)))
    noise = 0.005 * np.random.default_rng(1).standard_normal(8000)
    for scale in (1.0, 5.0):
        search.see_the_floor_in(replace(one, residuals=(scale * noise,)))
        assert search.floor == pytest.approx(0.005, rel=0.05)


@pytest.mark.parametrize("noise_um", [0.0, 2e-3, 0.03])
def test_the_step_of_a_converter_is_read_off_the_readings(noise_um: float) -> None:
    recordings = [
        read_by(0.0123, record(multisine(3000, seed=s), noise_um=noise_um, name=str(s))) for s in (0, 1)
    ]
    step, notes = converter(prepare(recordings))
    assert step == pytest.approx(0.0123, rel=1e-6)
    assert notes == ("All readings lie on a lattice of 12.3 nm.",)


def test_readings_without_steps_have_no_converter() -> None:
    assert converter(prepare([record(multisine(3000))])) == (0.0, ())


def test_one_recording_off_the_lattice_is_enough_against_it() -> None:
    recordings = [read_by(0.0123, record(multisine(3000))), record(multisine(3000, seed=1), name="b")]
    assert converter(prepare(recordings)) == (0.0, ())


def test_a_lattice_is_part_of_the_floor() -> None:
    """At rest every reading is the same: the floor is the uniform error of one step."""
    still = Recording("still", np.arange(2000) / FS_HZ, np.zeros(2000), np.full(2000, 0.0246), FS_HZ)
    assert noise_floor_um(prepare([still]), 0.0123) == pytest.approx(0.0123 / np.sqrt(12))
