"""The comparison with peers: rows, table and figure, on a record small enough for a test."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "peers"))

import with_loops
import with_lstsq
import with_sysidentpy
import with_torchpi
from figure import error_against_time
from measure import compare
from page import HEADINGS, page, table
from row import Row
from task import Task, make_task


@pytest.fixture(scope="module")
def task() -> Task:
    return make_task(samples=600, held_out=1, plays=4)


def a_row(**changes: object) -> Row:
    row = Row(with_torchpi.JOINT, 12_000, 0.1234, 2.0, 0.0123, 0.25, 10.0, 5.678)
    return dataclasses.replace(row, **changes)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_table_has_a_line_per_peer_with_percentages_of_the_range() -> None:
    heading, _, line = table([a_row()]).splitlines()
    assert cells(heading) == list(HEADINGS)
    assert cells(line) == ["torchpi, joint", "0.123", "2.00", "0.0123 (0.12)", "0.250 (2.50)", "5.68"]


def test_a_dash_stands_for_a_missing_value() -> None:
    line = table([a_row(compile_s=None, step_us=None, fit_s=1234.5)]).splitlines()[-1]
    assert cells(line)[1:3] == ["1,234", "–"]
    assert cells(line)[-1] == "–"


def test_the_page_states_time_ratios_with_and_without_compilation() -> None:
    slow = a_row(peer=with_lstsq.PEER, fit_s=12.34, compile_s=None, rms_v=0.0246)
    text = page([a_row(), slow], "abc1234")
    assert "lstsq on play states: 100 × its time (5.81 × with compilation), 2.00 × its held-out" in text
    assert with_lstsq.PEER.settings in text
    assert "at commit abc1234" in text and "0.0246<!-- figure: peers_lstsq_v --> (0.25)" in text


def test_torchpi_and_lstsq_are_compared_on_unseen_records(task: Task) -> None:
    rows = compare(task, [with_lstsq.PEER, with_torchpi.JOINT])
    assert [row.rms_v for row in rows] == sorted(row.rms_v for row in rows)
    for row in rows:
        assert 0 < row.rms_v < row.max_v < row.range_v
        assert row.fit_s > 0
        assert row.step_us is not None and row.step_us > 0
    assert {row.peer.name: row.compile_s is None for row in rows} == {
        "torchpi, joint": False,
        "lstsq on play states": True,
    }
    assert len(error_against_time(rows).axes[0].texts) == 2


def test_records_differ_and_start_de_energised(task: Task) -> None:
    (held_out,) = task.held_out
    assert not np.array_equal(held_out.u, task.train.u)
    for pair in (task.train, held_out):
        assert pair.u[0, 0] == 0
        assert pair.u.shape == pair.motion.yd.shape == (1, 600)


def test_streamed_steps_give_the_voltage_of_the_whole_record(task: Task) -> None:
    (held_out,) = task.held_out
    motion = np.stack([part[0, :300].numpy() for part in held_out.motion], 1).tolist()
    for fit in (with_lstsq.PEER.fit, with_loops.fit_scripted):
        fitted = fit(task)
        assert fitted.step is not None
        streamed = [fitted.step(*sample) for sample in motion]
        np.testing.assert_allclose(streamed, fitted.voltage(held_out)[:300], rtol=0, atol=1e-9)


def test_streamed_narx_steps_equal_its_prediction(task: Task) -> None:
    pytest.importorskip("sysidentpy")
    fitted = with_sysidentpy.PEER.fit(task)
    assert fitted.step is not None
    motion = np.stack([part[0, :100].numpy() for part in task.train.motion], 1).tolist()
    streamed = [fitted.step(*sample) for sample in motion]
    np.testing.assert_allclose(streamed, fitted.voltage(task.train)[:100], rtol=0, atol=1e-9)
