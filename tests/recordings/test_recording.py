"""Recordings are read back as written, their time stamps are checked, and bad arguments are refused."""

import hashlib
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from torchpi.errors import ConfigError, RecordingError, RecordingWarning
from torchpi.excitation.signals import (
    paper_multisine,
    sine_5hz,
)
from torchpi.recordings.recording import (
    Recording,
    check_recording,
    read_recording,
    write_recording,
)
from torchpi.recordings.signal import read_signal

DATA = Path(__file__).parents[2].parent / "shared" / "data"
FS_HZ = 10_000.0

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not beside this checkout")


def stage(u: np.ndarray, noise_um: float = 0.002, seed: int = 0) -> np.ndarray:
    """Simulate a simple piezo stage: plays by their definition, in NumPy, and a little noise."""
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
    """Return the warnings of the check."""
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
    def test_a_recording_is_read_back_bit_for_bit_as_written(self, tmp_path_factory, x, aux, fs_hz):
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

    def test_a_failed_write_leaves_the_previous_file(self, tmp_path, multisine_record, monkeypatch):
        path = tmp_path / "a.csv"
        write_recording(path, multisine_record)
        before = path.read_bytes()
        monkeypatch.setattr("torchpi.files.islice", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_recording(path, multisine_record)
        assert path.read_bytes() == before
        assert [file.name for file in tmp_path.iterdir()] == ["a.csv"]

    @pytest.mark.parametrize(
        ("input_unit", "output_unit", "volts", "um"),
        [("V", "um", 1, 1), ("mV", "nm", 1e3, 1e3), ("kV", "mm", 1e-3, 1e-3), ("V", "m", 1, 1e-6)],
    )
    def test_units_are_converted_on_reading(self, tmp_path, input_unit, output_unit, volts, um):
        u, y = paper_multisine(0.1)[1], stage(paper_multisine(0.1)[1])
        np.savez(tmp_path / "a.npz", input_v=u * volts, output_um=y * um)
        read = read_recording(tmp_path / "a.npz", fs_hz=FS_HZ, input_unit=input_unit, output_unit=output_unit)
        np.testing.assert_allclose(read.u, u, rtol=1e-14)
        np.testing.assert_allclose(read.y, y, rtol=1e-14)

    def test_an_unknown_unit_is_refused_with_a_list_of_valid_units(self, tmp_path):
        (tmp_path / "a.csv").write_text("time_s,input_v,output_um\n0,1,2\n1,2,3\n")
        with pytest.raises(RecordingError, match="output_unit is 'inch', expected one of um, nm, mm, m"):
            read_recording(tmp_path / "a.csv", output_unit="inch")

    def test_zero_first_subtracts_the_first_sample(self, tmp_path, multisine_record):
        write_recording(tmp_path / "a.csv", multisine_record)
        read = read_recording(tmp_path / "a.csv", zero="first")
        assert read.y[0] == 0
        np.testing.assert_array_equal(read.y, multisine_record.y - multisine_record.y[0])

    def test_a_single_signal_can_be_read_on_its_own(self, tmp_path):
        (tmp_path / "a.csv").write_text("time_s,yd_um\n" + "".join(f"{k / 1e4},{k}\n" for k in range(20)))
        signal = read_signal(tmp_path / "a.csv", "yd_um")
        np.testing.assert_array_equal(signal.x, np.arange(20))
        assert (signal.fs_hz, signal.name) == (FS_HZ, "a")
        with pytest.raises(RecordingError, match="--trajectory_column"):
            read_signal(tmp_path / "a.csv", "yd", option="--trajectory_column")

    def test_a_file_of_200_000_rows_is_read(self, tmp_path):
        u = sine_5hz(20.0)[1]
        write_recording(tmp_path / "a.csv", record(u, 0.8 * u))
        assert len(read_recording(tmp_path / "a.csv")) == 200_000


class TestTime:
    def rows(self, tmp_path: Path, t: np.ndarray) -> Path:
        u = 5 - 5 * np.cos(2 * np.pi * 5 * t)
        path = tmp_path / "a.csv"
        np.savetxt(
            path, np.stack((t, u, 0.8 * u), 1), "%.9g", ",", header="time_s,input_v,output_um", comments=""
        )
        return path

    def test_a_gap_is_refused_with_row_step_and_option(self, tmp_path):
        path = self.rows(tmp_path, np.delete(np.arange(2000) / FS_HZ, [700, 701]))
        with pytest.raises(RecordingError) as caught:
            read_recording(path)
        text = str(caught.value)
        assert "row 702:" in text  # the header is row 1, the first sample row 2
        assert "step 0.0003 s" in text and "median step 0.0001 s" in text
        assert "the option resample (true)" in text

    def test_resampling_fills_a_gap_and_marks_its_samples_as_not_read(self, tmp_path):
        path = self.rows(tmp_path, np.delete(np.arange(2000) / FS_HZ, [700, 701]))
        read = read_recording(path, resample=True)
        assert (len(read), read.fs_hz) == (2000, FS_HZ)
        np.testing.assert_allclose(read.u, 5 - 5 * np.cos(2 * np.pi * 5 * read.t), atol=1e-4)
        assert read.not_read.tolist() == [700, 701, 702]  # the last responds to a voltage that was filled in
        assert read.slice(0.0650, 0.08).not_read.tolist() == [50, 51, 52]
        assert set(read.resampled(FS_HZ / 2).not_read) >= {350, 351}

    def test_a_long_gap_is_filled_with_a_warning(self, tmp_path):
        path = self.rows(tmp_path, np.delete(np.arange(2000) / FS_HZ, np.arange(700, 760)))
        with pytest.warns(RecordingWarning, match="row 702: a gap of 0.0061 s"):
            read_recording(path, resample=True)

    @pytest.mark.parametrize("missing", [[], [700]])
    def test_jitter_needs_resampling_which_keeps_the_reading_of_every_row(self, tmp_path, missing):
        t = (np.arange(2000) + 0.2 * np.random.default_rng(0).random(2000)) / FS_HZ
        path = self.rows(tmp_path, np.delete(t, missing))
        with pytest.raises(RecordingError, match=r"row 3: .*resample"):
            read_recording(path)
        read = read_recording(path, resample=True)
        assert read.fs_hz == pytest.approx(FS_HZ, rel=1e-3)
        rows = np.loadtxt(path, delimiter=",", skiprows=1)[:, 2]
        assert len(read) == 2000
        np.testing.assert_array_equal(np.delete(read.y, missing), rows)
        np.testing.assert_array_equal(read.readings, rows)
        assert read.not_read.tolist() == ([700, 701] if missing else [])
        late = np.delete(t - np.arange(2000) / FS_HZ, missing)
        found = np.delete(read.late_s, missing)
        np.testing.assert_allclose(found - found.mean(), late - late.mean(), atol=0.01 / FS_HZ)
        np.testing.assert_array_equal(read.slice(0.05, 0.06).late_s, read.late_s[500:600])
        assert read.resampled(FS_HZ / 2).late_s is None

    def test_rows_far_from_any_tick_are_interpolated(self, tmp_path):
        t = (np.arange(2000) + 0.6 * np.random.default_rng(0).random(2000)) / FS_HZ
        path = self.rows(tmp_path, t)
        read = read_recording(path, resample=True)
        rows = np.loadtxt(path, delimiter=",", skiprows=1)[:, 2]
        assert not np.isin(read.y[1:-1], rows).all()
        np.testing.assert_array_equal(read.readings, rows)
        np.testing.assert_array_equal(read.resampled(FS_HZ / 2).readings, rows)
        assert read.not_read.tolist() == []

    def test_resampling_to_a_round_rate_does_not_attenuate_fast_signals(self, tmp_path):
        t = np.cumsum(1 + 0.02 * np.random.default_rng(0).standard_normal(4000)) / 1000.4
        u = 4 - 4 * np.cos(2 * np.pi * 240 * (t - t[0]))
        path = tmp_path / "a.csv"
        header = "time_s,input_v,output_um"
        np.savetxt(path, np.stack((t, u, 0.8 * u), 1), "%.9g", ",", header=header, comments="")
        read = read_recording(path, resample=True)
        assert (read.fs_hz, len(read)) == (1000.0, 4000)
        assert np.std(read.u) == pytest.approx(np.std(u), rel=1e-6)

    @pytest.mark.parametrize("resample", [False, True])
    @pytest.mark.parametrize("step", [0, -3])
    def test_time_that_does_not_increase_is_refused(self, tmp_path, step, resample):
        t = np.arange(2000) / FS_HZ
        t[700] = t[699] + step / FS_HZ
        with pytest.raises(RecordingError, match=r"row 702: time goes from 0\.0699 s"):
            read_recording(self.rows(tmp_path, t), resample=resample)

    def test_a_given_sample_rate_must_agree_with_the_time_stamps(self, tmp_path):
        path = self.rows(tmp_path, np.arange(2000) / FS_HZ)
        assert read_recording(path, fs_hz=10_000).fs_hz == FS_HZ
        with pytest.raises(RecordingError, match="10000 Hz, but fs_hz is 5000 Hz"):
            read_recording(path, fs_hz=5000)
        read = read_recording(path, fs_hz=5000, resample=True)
        assert (read.fs_hz, len(read)) == (5000, 1000)
        assert read_recording(path, fs_hz=5000, time_column=None).duration_s == 0.4


class TestMethods:
    def test_a_slice_keeps_its_time_stamps_and_samples(self, multisine_record):
        part = multisine_record.slice(0.1, 0.3)
        assert len(part) == 2000
        assert part.t[0] == multisine_record.t[1000]
        np.testing.assert_array_equal(part.u, multisine_record.u[1000:3000])
        with pytest.raises(RecordingError, match="no samples from 7 s to 9 s"):
            multisine_record.slice(7, 9)

    @given(st.floats(0.01, 0.99))
    def test_head_and_tail_together_are_the_whole_recording(self, fraction):
        whole = record(np.arange(100.0), np.arange(100.0), aux_v=np.arange(100.0))
        head, tail = whole.split_tail(fraction)
        assert len(tail) == round(100 * fraction)
        for name in ("t", "u", "y"):
            joined = np.concatenate((getattr(head, name), getattr(tail, name)))
            np.testing.assert_array_equal(joined, getattr(whole, name))
        np.testing.assert_array_equal(np.concatenate((head.aux["aux_v"], tail.aux["aux_v"])), whole.u)

    @pytest.mark.parametrize("fraction", [0.0, 1.0, -0.5, 2.0])
    def test_a_split_fraction_that_is_not_between_0_and_1_is_refused(self, multisine_record, fraction):
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

    def test_downsampling_does_not_alias(self):
        t = np.arange(20_000) / FS_HZ
        noise = np.sin(2 * np.pi * 3_900 * t)
        down = record(10 * t, 8 * t + noise).resampled(4_000.0)
        assert np.abs(down.y - 8 * down.t)[100:-100].max() < 0.01

    def test_repr_shows_samples_rate_duration_and_range(self, multisine_record):
        assert repr(multisine_record).startswith(
            "Recording('rec', 5,000 samples at 10000 Hz, 0.5 s, u 0…9.63"
        )


@needs_data
class TestRealRecordings:
    def test_the_piezo_stack_recordings_are_read(self):
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

    def test_the_steering_mirror_recording_is_read(self):
        recording = read_recording(
            DATA / "steering_mirror" / "train.npz",
            input_column="u_300mV_train[:,0,0,0]",
            output_column="y_300mV_train[:,0,0,0]",
            fs_hz=6400,
            output_unit="m",
        )
        assert len(recording) == 8192
        assert 0.1 < np.ptp(recording.y) < 100

    def test_the_bouc_wen_recording_is_read(self):
        pytest.importorskip("h5py")
        with pytest.warns(RecordingWarning, match="output_unit"):
            recording = read_recording(
                DATA / "bouc_wen" / "train.h5",
                input_column="multisine/u",
                output_column="multisine/y",
                fs_hz="multisine/fs",
            )
        assert (len(recording), recording.fs_hz) == (40_960, 750)


def test_arguments_of_the_wrong_type_are_refused_by_name(tmp_path):
    path = tmp_path / "a.csv"
    with pytest.raises(RecordingError, match="path: found int, expected the path of a file"):
        read_recording(5)
    with pytest.raises(
        ConfigError, match="options: found dict, expected RecordingOptions; pass single options"
    ):
        read_recording(path, {"fs_hz": 1000})
    with pytest.raises(RecordingError, match=r"recording: found ndarray of 3×2, expected a Recording"):
        write_recording(path, np.zeros((3, 2)))
    with pytest.raises(RecordingError, match="one: t: found list, expected a NumPy array"):
        Recording("one", [0.0, 1.0], np.zeros(2), np.zeros(2), 1.0)
    assert not path.exists()
