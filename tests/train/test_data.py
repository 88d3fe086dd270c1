"""Which recordings and samples are held out, and which are counted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.train.conftest import recording, write
from torchpi.errors import RecordingWarning
from train.data import RecordingsData


def test_the_last_of_several_recordings_is_held_out(recordings: list[str]) -> None:
    split = RecordingsData(recordings=recordings).split(0)
    assert [pair.name for pair in split.train] == ["r0", "r1"]
    assert [pair.name for pair in split.heldout] == ["r2"]
    assert split.zero == []


def test_named_records_are_held_out_and_all_others_train(recordings: list[str]) -> None:
    split = RecordingsData(recordings=recordings[:2], heldout=recordings[2:]).split(0)
    assert [pair.name for pair in split.train] == ["r0", "r1"]
    assert [pair.name for pair in split.heldout] == ["r2"]


def test_the_end_of_a_single_recording_is_held_out_with_a_warning(recordings: list[str]) -> None:
    data = RecordingsData(recordings=recordings[0], skip_s=0.1)
    with pytest.warns(RecordingWarning, match="last 30 %"):
        split = data.split(2)
    train, heldout = split.train[0], split.heldout[0]
    assert train.counted == slice(100, 729)
    assert heldout.counted == slice(729, 998)
    assert train.u.shape == (1, 729)  # without the held-out samples
    assert heldout.u.shape == (1, 998)  # from the start, to carry the state


def test_one_interval_is_evaluated_and_another_gives_the_zero(recordings: list[str]) -> None:
    data = RecordingsData(recordings=recordings, evaluate_s=(0.5, 0.8), zero_s=(0.1, 0.3))
    split = data.split(0)
    assert split.heldout[0].counted == slice(500, 800)
    assert split.zero[0].counted == slice(100, 300)
    assert split.zero[0].u.shape == (1, 300)


def test_the_first_sample_can_be_the_zero(recordings: list[str]) -> None:
    recorded, zeroed = (
        RecordingsData(recordings=recordings, zero=zero).load() for zero in ("recorded", "first")
    )
    for before, after in zip(recorded.train, zeroed.train, strict=True):
        np.testing.assert_array_equal(after.y, before.y - before.y[0])


def test_a_record_that_starts_far_from_zero_is_reported_with_the_remedy(
    recordings: list[str], tmp_path: Path
) -> None:
    made = recording("shifted", 1)
    shifted = write(tmp_path, replace(made, y=made.y - 96.0))
    with pytest.warns(RecordingWarning, match=r"shifted\.csv: starts at -96 µm .* option zero \(first\)"):
        RecordingsData(recordings=[*recordings, shifted]).load()
    RecordingsData(recordings=[*recordings, shifted], zero="first").load()
    RecordingsData(recordings=recordings).load()
