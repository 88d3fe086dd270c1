"""Recordings survive writing and reading, and what is wrong with one is said before anything is computed."""

import hashlib
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.excitation import (
    hold,
    multisine,
    paper_multisine,
    sine_5hz,
    stairs,
    triangles,
)
from torchpi.recording import (
    Recording,
    check_recording,
    read_recording,
    read_signal,
    write_recording,
)
from torchpi.recording_faults import dropouts

DATA = Path(__file__).parents[1].parent / "shared" / "data"
FS_HZ = 10_000.0

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not beside this checkout")


def stage(u: np.ndarray, noise_um: float = 0.002, seed: int = 0) -> np.ndarray:
    """Something like a piezo stage: plays by their definition, in NumPy, and a little noise."""
    y = 0.4 * u
    for r in (0.2, 0.6, 1.5):
        h = np.empty_like(u)
        state = 0.0
        for k, x in enumerate(u):
            state = max(x - r, min(x + r, state))
            h[k] = state
        y = y + 0.12 * h
    return y + noise_um * np.random.default_rng(seed).standard_normal(len(u))


def record(u: np.ndarray, y: np.ndarray | None = None, fs_hz: float = FS_HZ, **aux: np.ndarray) -> Recording:
    y = stage(u) if y is None else y
    return Recording("rec", np.arange(len(u)) / fs_hz, u, y, fs_hz, aux, "rec.csv")


def said(recording: Recording) -> list[str]:
    """The warnings of the check."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_recording(recording)
    return [str(warning.message) for warning in caught]


@pytest.fixture(scope="module")
def multisine_record() -> Recording:
    return record(paper_multisine(0.5)[1])


finite = hnp.arrays(np.float64, 30, elements=st.floats(-1e9, 1e9, allow_subnormal=True), unique=True)


class TestFile:
    @given(x=finite, aux=finite, fs_hz=st.sampled_from([10_000.0, 3_000.0, 9_700.0, 51_200.0, 200.0]))
    def test_what_is_written_is_read_to_the_last_bit(self, tmp_path_factory, x, aux, fs_hz):
        path = tmp_path_factory.mktemp("round") / "a.csv"
        written = record(x, -x, fs_hz, aux_temp_c=aux)
        write_recording(path, written)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)  # a range of 1e9 V is suspicious
            read = read_recording(path)
        for name in ("t", "u", "y"):
            assert getattr(read, name).tobytes() == getattr(written, name).tobytes()
        assert read.aux["aux_temp_c"].tobytes() == aux.tobytes()
        assert read.fs_hz == fs_hz

    def test_the_name_the_path_and_the_hash_are_kept(self, tmp_path, multisine_record):
        path = tmp_path / "first.run.csv"
        write_recording(path, multisine_record)
        read = read_recording(str(path))
        assert (read.name, read.source) == ("first.run", str(path))
        assert read.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        assert path.read_text().startswith("time_s,input_v,output_um\n0.0,")

    def test_a_failed_write_leaves_the_file_that_was_there(self, tmp_path, multisine_record, monkeypatch):
        path = tmp_path / "a.csv"
        write_recording(path, multisine_record)
        before = path.read_bytes()
        monkeypatch.setattr("torchpi.recording.islice", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_recording(path, multisine_record)
        assert path.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]

    @pytest.mark.parametrize(
        ("input_unit", "output_unit", "volts", "um"),
        [("V", "um", 1, 1), ("mV", "nm", 1e3, 1e3), ("kV", "mm", 1e-3, 1e-3), ("V", "m", 1, 1e-6)],
    )
    def test_units_are_converted_at_the_border(self, tmp_path, input_unit, output_unit, volts, um):
        u, y = paper_multisine(0.1)[1], stage(paper_multisine(0.1)[1])
        np.savez(tmp_path / "a.npz", input_v=u * volts, output_um=y * um)
        read = read_recording(tmp_path / "a.npz", fs_hz=FS_HZ, input_unit=input_unit, output_unit=output_unit)
        np.testing.assert_allclose(read.u, u, rtol=1e-14)
        np.testing.assert_allclose(read.y, y, rtol=1e-14)

    def test_an_unknown_unit_names_the_known_ones(self, tmp_path):
        (tmp_path / "a.csv").write_text("time_s,input_v,output_um\n0,1,2\n1,2,3\n")
        with pytest.raises(RecordingError, match="output_unit is 'inch', expected one of um, nm, mm, m"):
            read_recording(tmp_path / "a.csv", output_unit="inch")

    def test_zero_first_counts_from_the_first_sample(self, tmp_path, multisine_record):
        write_recording(tmp_path / "a.csv", multisine_record)
        read = read_recording(tmp_path / "a.csv", zero="first")
        assert read.y[0] == 0
        np.testing.assert_array_equal(read.y, multisine_record.y - multisine_record.y[0])

    def test_one_signal_is_read_alone(self, tmp_path):
        (tmp_path / "a.csv").write_text("time_s,yd_um\n" + "".join(f"{k / 1e4},{k}\n" for k in range(20)))
        signal = read_signal(tmp_path / "a.csv", "yd_um")
        np.testing.assert_array_equal(signal.x, np.arange(20))
        assert (signal.fs_hz, signal.name) == (FS_HZ, "a")
        with pytest.raises(RecordingError, match="--trajectory_column"):
            read_signal(tmp_path / "a.csv", "yd", option="--trajectory_column")

    def test_a_million_rows_are_no_trouble(self, tmp_path):
        import time

        u = sine_5hz(20.0)[1]  # a fifth of a million keeps the test short
        write_recording(tmp_path / "a.csv", record(u, 0.8 * u))
        start = time.perf_counter()
        assert len(read_recording(tmp_path / "a.csv")) == 200_000
        assert time.perf_counter() - start < 5


class TestTime:
    def rows(self, tmp_path: Path, t: np.ndarray) -> Path:
        u = 5 - 5 * np.cos(2 * np.pi * 5 * t)
        path = tmp_path / "a.csv"
        np.savetxt(
            path, np.stack((t, u, 0.8 * u), 1), "%.9g", ",", header="time_s,input_v,output_um", comments=""
        )
        return path

    def test_a_gap_names_the_row_the_step_and_the_option(self, tmp_path):
        path = self.rows(tmp_path, np.delete(np.arange(2000) / FS_HZ, [700, 701]))
        with pytest.raises(RecordingError) as caught:
            read_recording(path)
        text = str(caught.value)
        assert "row 702:" in text  # the header is row 1, the first sample row 2
        assert "step 0.0003 s" in text and "median step 0.0001 s" in text
        assert "the option resample (true)" in text

    def test_resampling_fills_the_gap(self, tmp_path):
        path = self.rows(tmp_path, np.delete(np.arange(2000) / FS_HZ, [700, 701]))
        read = read_recording(path, resample=True)
        assert (len(read), read.fs_hz) == (2000, FS_HZ)
        np.testing.assert_allclose(read.u, 5 - 5 * np.cos(2 * np.pi * 5 * read.t), atol=1e-4)

    def test_a_long_gap_is_filled_but_said(self, tmp_path):
        path = self.rows(tmp_path, np.delete(np.arange(2000) / FS_HZ, np.arange(700, 760)))
        with pytest.warns(RecordingWarning, match="row 702: a gap of 0.0061 s"):
            read_recording(path, resample=True)

    def test_jitter_is_refused_and_resampled(self, tmp_path):
        t = (np.arange(2000) + 0.2 * np.random.default_rng(0).random(2000)) / FS_HZ
        path = self.rows(tmp_path, t)
        with pytest.raises(RecordingError, match=r"row 3: .*resample"):
            read_recording(path)
        assert read_recording(path, resample=True).fs_hz == pytest.approx(FS_HZ, rel=1e-3)

    @pytest.mark.parametrize("resample", [False, True])
    @pytest.mark.parametrize("step", [0, -3])
    def test_time_that_does_not_increase_is_refused(self, tmp_path, step, resample):
        t = np.arange(2000) / FS_HZ
        t[700] = t[699] + step / FS_HZ
        with pytest.raises(RecordingError, match=r"row 702: time goes from 0\.0699 s"):
            read_recording(self.rows(tmp_path, t), resample=resample)

    def test_a_rate_beside_stamps_must_agree(self, tmp_path):
        path = self.rows(tmp_path, np.arange(2000) / FS_HZ)
        assert read_recording(path, fs_hz=10_000).fs_hz == FS_HZ
        with pytest.raises(RecordingError, match="10000 Hz, but fs_hz is 5000 Hz"):
            read_recording(path, fs_hz=5000)
        read = read_recording(path, fs_hz=5000, resample=True)
        assert (read.fs_hz, len(read)) == (5000, 1000)
        assert read_recording(path, fs_hz=5000, time_column=None).duration_s == 0.4


class TestRefused:
    def test_too_short(self):
        with pytest.raises(RecordingError, match=r"7 samples, expected at least 20 \(min_samples"):
            check_recording(record(np.arange(7.0)), min_samples=20)

    def test_a_constant_input_unless_it_is_wanted(self):
        recording = record(np.full(1000, 3.0))
        with pytest.raises(RecordingError, match="constant at 3 V"):
            check_recording(recording)
        check_recording(recording, allow_constant_input=True)

    def test_a_flat_sensor(self):
        u = sine_5hz()[1]
        with pytest.raises(RecordingError, match=r"flat at 1\.5 µm"):
            check_recording(record(u, np.full_like(u, 1.5)))

    def test_a_sensor_that_shows_its_last_bits_only(self):
        u = sine_5hz()[1]
        bits = np.random.default_rng(0).integers(0, 3, len(u)) * 0.0003
        with pytest.raises(RecordingError, match="only 3 values"):
            check_recording(record(u, bits))

    @pytest.mark.parametrize("signal", [sine_5hz(1.0)[1], paper_multisine(1.0)[1], triangles(1.0)[1]])
    @pytest.mark.parametrize("seed", range(5))
    def test_an_unplugged_sensor_with_noise_and_hum(self, signal, seed):
        random = np.random.default_rng(seed)
        t = np.arange(len(signal)) / FS_HZ
        y = 0.01 * random.standard_normal(len(signal)) + 1e-3 * np.sin(2 * np.pi * 60 * t) + 0.02 * t
        with pytest.raises(RecordingError, match="does not follow the input"):
            check_recording(record(signal, y))

    def test_a_number_that_is_none(self, multisine_record):
        y = multisine_record.y.copy()
        y[10] = np.inf
        with pytest.raises(RecordingError, match="sample 11: column 'output_um': found inf"):
            check_recording(record(multisine_record.u, y))

    def test_unequal_lengths(self):
        with pytest.raises(RecordingError, match="unequal lengths: t 5, u 5, y 4"):
            record(np.arange(5.0), np.arange(4.0))

    def test_every_refusal_is_one_line_and_names_the_file(self):
        u = sine_5hz()[1]
        for bad in (
            record(u[:3]),
            record(0 * u),
            record(u, 0 * u),
            record(u, np.random.default_rng(0).random(len(u))),
        ):
            with pytest.raises(RecordingError) as caught:
                check_recording(bad)
            assert str(caught.value).startswith("rec.csv: ") and "\n" not in str(caught.value)


SIGNALS = {
    "sine": sine_5hz(1.0),
    "multisine of eq. 13": paper_multisine(0.5),
    "random phases": multisine(2.0),
    "triangles": triangles(3.0),
    "stairs": stairs(2.0),
    "eased stairs": stairs(2.0, rise_s=0.05),
    "hold": hold(1.0),
}


class TestClipping:
    @pytest.mark.parametrize("name", SIGNALS)
    @pytest.mark.parametrize("noise_um", [0.0, 0.003])
    @pytest.mark.parametrize("step", [0.0, 10 / 2**16, 10 / 2**12])
    def test_no_designed_signal_is_called_clipped(self, name, noise_um, step):
        u = SIGNALS[name][1]
        y = stage(u, noise_um)
        if step:
            u, y = np.round(u / step) * step, np.round(y / step) * step
        assert said(record(u, y)) == []

    def test_nor_a_trapezoid_or_a_square_wave(self):
        t = np.arange(20_000) / FS_HZ
        triangle = 2 * np.abs(2 * (t % 1) - 1) - 1
        for u in (np.clip(8 * triangle, -4, 4) + 5, 5 + 4 * np.sign(triangle)):
            y = stage(u)
            assert said(record(u, y - y[0])) == []

    @pytest.mark.parametrize("limit", [0.99, 0.95, 0.8, 0.6])
    @pytest.mark.parametrize("name", ["sine", "multisine of eq. 13", "random phases"])
    def test_a_clipped_input_is_said_with_its_share(self, name, limit):
        _t, u = SIGNALS[name]
        clipped = np.minimum(u, limit * u.max())
        share = 100 * np.mean(clipped == clipped.max())
        (text,) = said(record(clipped))
        assert "clipping" in text and f"{share:.2g} %" in text and "input" in text and "amplitude" in text

    @pytest.mark.parametrize("limit", [0.98, 0.9, 0.7])
    @pytest.mark.parametrize("name", ["sine", "multisine of eq. 13", "random phases", "triangles"])
    def test_a_clipped_sensor_is_said_with_its_share(self, name, limit):
        u = SIGNALS[name][1]
        y = stage(u)
        y = np.minimum(y, limit * y.max())
        (text,) = [line for line in said(record(u, y)) if "clipping" in line]
        share = float(text.split("clipping: ")[1].split(" %")[0])
        assert share == pytest.approx(100 * np.mean(y == y.max()), rel=0.1)
        assert "output" in text and "sensor" in text


class TestDropouts:
    def test_a_frozen_sensor_is_said(self):
        u = sine_5hz()[1]
        y = stage(u)
        y[3020:3080] = y[3020]
        (text,) = said(record(u, y))
        assert "dropouts: 0.59 %" in text and "60 samples, at t = 0.302 s" in text

    def test_a_sensor_slower_than_the_record_is_said(self):
        u = sine_5hz()[1]
        (text,) = said(record(u, np.repeat(stage(u)[::10], 10)))
        assert "dropouts" in text and "own rate" in text


class TestSingleDropouts:
    @pytest.mark.parametrize("name", ["sine", "multisine of eq. 13", "random phases", "triangles", "stairs"])
    @pytest.mark.parametrize("noise_um", [0.0, 0.003, 0.03])
    @pytest.mark.parametrize("step", [0.0, 10 / 2**12])
    def test_zeros_among_readings_are_found_and_nothing_else(self, name, noise_um, step):
        y = stage(SIGNALS[name][1], noise_um)
        y = np.round(y / step) * step if step else y
        assert not len(dropouts(y))
        lost = np.arange(500, len(y) - 500, 97)
        lost = lost[y[lost] > 1.0]
        y[lost] = 0.0
        found = dropouts(y)
        assert set(found) <= set(lost) and len(found) >= 0.98 * len(lost)

    def test_noise_alone_makes_none(self):
        false = sum(len(dropouts(np.random.default_rng(k).standard_normal(3000))) > 0 for k in range(100))
        assert false <= 1  # one in a thousand records is allowed for

    @given(
        hnp.arrays(np.float64, st.integers(0, 40), elements=st.floats(-1e12, 1e12, allow_subnormal=True)),
    )
    def test_any_signal_has_an_answer(self, y):
        found = dropouts(y)
        assert np.all((found > 0) & (found < len(y) - 1)) and np.all(np.diff(found) > 0)

    def test_the_warning_counts_them_and_names_their_rows(self, tmp_path, multisine_record):
        y = multisine_record.y.copy()
        y[[1000, 2000, 2500]] = 0.0
        write_recording(tmp_path / "a.csv", record(multisine_record.u, y))
        with pytest.warns(
            RecordingWarning, match=r"3 single wrong readings .*row 1002: 0 µm .*rows? 2002, row 2502"
        ):
            read_recording(tmp_path / "a.csv")


class TestExtremes:
    @pytest.mark.parametrize("value", [1e160, -1e160, 1e13, 9.9e37])
    @pytest.mark.parametrize("column", ["time_s", "input_v", "output_um"])
    def test_an_impossible_value_is_refused_by_file_row_and_column(
        self, tmp_path, multisine_record, value, column
    ):
        table = {"time_s": multisine_record.t, "input_v": multisine_record.u, "output_um": multisine_record.y}
        table[column] = table[column].copy()
        table[column][70] = value
        np.savetxt(
            tmp_path / "a.csv",
            np.stack(list(table.values()), 1),
            "%.17g",
            ",",
            header=",".join(table),
            comments="",
        )
        with pytest.raises(
            RecordingError, match=rf"a\.csv: row 72: column '{column}': found {value:g}".replace("+", r"\+")
        ):
            read_recording(tmp_path / "a.csv")

    def test_ranges_and_steps_too_small_are_refused(self, tmp_path, multisine_record):
        with pytest.raises(RecordingError, match=r"input moves by only 9\.63e-300"):
            check_recording(record(1e-300 * multisine_record.u))
        t = 1e-300 * np.arange(len(multisine_record))
        np.savez(tmp_path / "a.npz", time_s=t, input_v=multisine_record.u, output_um=multisine_record.y)
        with pytest.raises(RecordingError, match=r"sample 2: time step 1e-300 s, expected at least 1e-12 s"):
            read_recording(tmp_path / "a.npz")

    def test_a_gap_that_would_fill_the_memory_is_refused(self, tmp_path, multisine_record):
        t = multisine_record.t.copy()
        t[-1] = 1e9
        np.savez(tmp_path / "a.npz", time_s=t, input_v=multisine_record.u, output_um=multisine_record.y)
        with pytest.raises(RecordingError, match="a gap of 1e\\+09 s"):
            read_recording(tmp_path / "a.npz", resample=True)


class TestWhichIsWhich:
    @pytest.mark.parametrize("name", ["sine", "multisine of eq. 13", "random phases", "triangles"])
    def test_swapped_columns_and_a_turned_sensor_are_said_with_the_remedy(self, name):
        u = SIGNALS[name][1]
        y = stage(u)
        assert said(record(u, y)) == []
        assert any("comes before the input" in line and "input_column" in line for line in said(record(y, u)))
        assert any(
            "falls where the input rises" in line and "output_unit" in line for line in said(record(u, -y))
        )
        assert not any("comes before" in line for line in said(record(u, -y)))

    def test_a_start_away_from_zero_is_said_with_the_remedy(self, multisine_record):
        (text,) = said(record(multisine_record.u, multisine_record.y + 30))
        assert "starts at 30" in text and "zero (first)" in text


class TestUnits:
    @pytest.mark.parametrize(("factor", "unit"), [(1e-6, "m"), (1e-3, "mm"), (1e3, "nm")])
    def test_an_unlikely_stroke_names_the_unit_it_may_be_in(self, multisine_record, factor, unit):
        (text,) = said(record(multisine_record.u, multisine_record.y * factor))
        assert f"give output_unit {unit}" in text

    def test_an_unlikely_voltage_names_the_unit_it_may_be_in(self, multisine_record):
        (text,) = said(record(multisine_record.u * 1e3, multisine_record.y))
        assert "give input_unit mV" in text


class TestMethods:
    def test_a_slice_keeps_the_stamps_and_meets_its_edges(self, multisine_record):
        part = multisine_record.slice(0.1, 0.3)
        assert len(part) == 2000
        assert part.t[0] == multisine_record.t[1000]
        np.testing.assert_array_equal(part.u, multisine_record.u[1000:3000])
        with pytest.raises(RecordingError, match="no samples from 7 s to 9 s"):
            multisine_record.slice(7, 9)

    @given(st.floats(0.01, 0.99))
    def test_head_and_tail_are_the_whole(self, fraction):
        whole = record(np.arange(100.0), np.arange(100.0), aux_v=np.arange(100.0))
        head, tail = whole.split_tail(fraction)
        assert len(tail) == round(100 * fraction)
        for name in ("t", "u", "y"):
            joined = np.concatenate((getattr(head, name), getattr(tail, name)))
            np.testing.assert_array_equal(joined, getattr(whole, name))
        np.testing.assert_array_equal(np.concatenate((head.aux["aux_v"], tail.aux["aux_v"])), whole.u)

    @pytest.mark.parametrize("fraction", [0.0, 1.0, -0.5, 2.0])
    def test_a_split_leaves_something_to_both(self, multisine_record, fraction):
        with pytest.raises(RecordingError, match="fraction between 0 and 1"):
            multisine_record.split_tail(fraction)

    @pytest.mark.parametrize("to_hz", [5_000.0, 20_000.0, 12_800.0, 8_192.0, 9_999.7, 7_777.123])
    def test_resampling_gives_the_signal_at_the_new_times(self, to_hz):
        _t, u = paper_multisine(0.5)
        new = record(u, 0.8 * u, aux_v=u).resampled(to_hz)
        truth = 5 + sum(a * np.sin(2 * np.pi * f * new.t - np.pi / 2) for f, a in ((20, 1), (50, 2), (80, 2)))
        assert new.fs_hz == to_hz
        assert abs(new.duration_s - 0.5) < 2 / to_hz + 1e-4
        for signal in (new.u, new.y / 0.8, new.aux["aux_v"]):
            error = np.abs(signal - truth)
            assert error.max() < 0.03  # at the ends, where the record's curvature is unknown
            assert error[200:-200].max() < 2e-3

    def test_resampling_down_does_not_fold(self):
        t = np.arange(20_000) / FS_HZ
        noise = np.sin(2 * np.pi * 3_900 * t)
        down = record(10 * t, 8 * t + noise).resampled(4_000.0)
        assert np.abs(down.y - 8 * down.t)[100:-100].max() < 0.01

    def test_the_text_of_a_recording_says_what_it_is(self, multisine_record):
        assert repr(multisine_record).startswith(
            "Recording('rec', 5,000 samples at 10000 Hz, 0.5 s, u 0…9.63"
        )


@needs_data
class TestRealRecordings:
    def test_piezo_stack(self):
        train = read_recording(
            DATA / "piezo_stack" / "Model_Vi_Do.dat", input_column=1, output_column=5, fs_hz=200, zero="first"
        )
        assert (len(train), train.fs_hz, train.y[0]) == (8027, 200, 0)
        assert np.ptp(train.u) == pytest.approx(3.6)
        assert np.ptp(train.y) == pytest.approx(49.42, abs=0.01)
        held_out = read_recording(
            DATA / "piezo_stack" / "Test_Vi_Do_Di.dat",
            input_column=1,
            output_column=5,
            fs_hz=200,
            zero="first",
        )
        assert len(held_out.slice(56, 70.5)) == 2900

    def test_steering_mirror(self):
        recording = read_recording(
            DATA / "steering_mirror" / "train.npz",
            input_column="u_300mV_train[:,0,0,0]",
            output_column="y_300mV_train[:,0,0,0]",
            fs_hz=6400,
            output_unit="m",
        )
        assert len(recording) == 8192
        assert 0.1 < np.ptp(recording.y) < 100

    def test_bouc_wen(self):
        pytest.importorskip("h5py")
        with pytest.warns(RecordingWarning, match="output_unit"):
            recording = read_recording(
                DATA / "bouc_wen" / "train.h5",
                input_column="multisine/u",
                output_column="multisine/y",
                fs_hz="multisine/fs",
            )
        assert (len(recording), recording.fs_hz) == (40_960, 750)
