"""Faults of a recording are reported, with the remedy, before anything is computed."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.recordings.test_recording import FS_HZ, record, stage
from torchpi.errors import RecordingError, RecordingWarning
from torchpi.excitation.signals import hold, multisine, paper_multisine, sine_5hz, stairs, triangles
from torchpi.recordings.faults import dropouts
from torchpi.recordings.recording import Recording, check_recording, read_recording, write_recording


@pytest.fixture(scope="module")
def multisine_record() -> Recording:
    return record(paper_multisine(0.5)[1])


def said(recording: Recording) -> list[str]:
    """Return the warnings of the check."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_recording(recording)
    return [str(warning.message) for warning in caught]


class TestRefused:
    def test_a_recording_with_too_few_samples_is_refused(self):
        with pytest.raises(RecordingError, match=r"7 samples, expected at least 20 \(min_samples"):
            check_recording(record(np.arange(7.0)), min_samples=20)

    def test_a_constant_input_is_refused_unless_allowed(self):
        recording = record(np.full(1000, 3.0))
        with pytest.raises(RecordingError, match="constant at 3 V"):
            check_recording(recording)
        check_recording(recording, allow_constant_input=True)

    def test_a_constant_sensor_signal_is_refused(self):
        u = sine_5hz()[1]
        with pytest.raises(RecordingError, match=r"flat at 1\.5 µm"):
            check_recording(record(u, np.full_like(u, 1.5)))

    def test_a_sensor_signal_of_only_three_quantisation_levels_is_refused(self):
        u = sine_5hz()[1]
        bits = np.random.default_rng(0).integers(0, 3, len(u)) * 0.0003
        with pytest.raises(RecordingError, match="only 3 values"):
            check_recording(record(u, bits))

    @pytest.mark.parametrize("signal", [sine_5hz(1.0)[1], paper_multisine(1.0)[1], triangles(1.0)[1]])
    @pytest.mark.parametrize("seed", range(5))
    def test_an_unplugged_sensor_with_noise_and_hum_is_refused(self, signal, seed):
        random = np.random.default_rng(seed)
        t = np.arange(len(signal)) / FS_HZ
        y = 0.01 * random.standard_normal(len(signal)) + 1e-3 * np.sin(2 * np.pi * 60 * t) + 0.02 * t
        with pytest.raises(RecordingError, match="does not follow the input"):
            check_recording(record(signal, y))

    def test_a_non_finite_sample_is_refused(self, multisine_record):
        y = multisine_record.y.copy()
        y[10] = np.inf
        with pytest.raises(RecordingError, match="sample 11: column 'output_um': found inf"):
            check_recording(record(multisine_record.u, y))

    def test_unequal_lengths_are_refused(self):
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
    def test_no_designed_signal_is_reported_as_clipped(self, name, noise_um, step):
        u = SIGNALS[name][1]
        y = stage(u, noise_um)
        if step:
            u, y = np.round(u / step) * step, np.round(y / step) * step
        assert said(record(u, y)) == []

    @pytest.mark.parametrize("name", ["sine", "triangles", "random phases"])
    def test_interpolated_coarse_readings_are_not_reported_as_clipped(self, name):
        t, u = SIGNALS[name]
        step, late = 0.1, 0.6 * np.random.default_rng(0).random(len(t)) / FS_HZ
        y = np.round(np.interp(t + late, t, stage(u, 0.003)) / step) * step
        read = Recording.from_arrays(t + late, np.interp(t + late, t, u), y, resample=True)
        assert said(read) == []

    def test_a_trapezoid_and_a_square_wave_are_not_reported_as_clipped(self):
        t = np.arange(20_000) / FS_HZ
        triangle = 2 * np.abs(2 * (t % 1) - 1) - 1
        for u in (np.clip(8 * triangle, -4, 4) + 5, 5 + 4 * np.sign(triangle)):
            y = stage(u)
            assert said(record(u, y - y[0])) == []

    @pytest.mark.parametrize("limit", [0.99, 0.95, 0.8, 0.6])
    @pytest.mark.parametrize("name", ["sine", "multisine of eq. 13", "random phases"])
    def test_a_clipped_input_is_reported_with_its_share(self, name, limit):
        _t, u = SIGNALS[name]
        clipped = np.minimum(u, limit * u.max())
        share = 100 * np.mean(clipped == clipped.max())
        (text,) = said(record(clipped))
        assert "clipping" in text and f"{share:.2g} %" in text and "input" in text and "amplitude" in text

    @pytest.mark.parametrize("limit", [0.98, 0.9, 0.7])
    @pytest.mark.parametrize("name", ["sine", "multisine of eq. 13", "random phases", "triangles"])
    def test_a_clipped_sensor_is_reported_with_its_share(self, name, limit):
        u = SIGNALS[name][1]
        y = stage(u)
        y = np.minimum(y, limit * y.max())
        (text,) = [line for line in said(record(u, y)) if "clipping" in line]
        share = float(text.split("clipping: ")[1].split(" %")[0])
        assert share == pytest.approx(100 * np.mean(y == y.max()), rel=0.1)
        assert "output" in text and "sensor" in text


class TestDropouts:
    def test_a_frozen_sensor_is_reported(self):
        u = sine_5hz()[1]
        y = stage(u)
        y[3020:3080] = y[3020]
        (text,) = said(record(u, y))
        assert "dropouts: 0.59 %" in text and "60 samples, at t = 0.302 s" in text

    def test_a_sensor_slower_than_the_sample_rate_is_reported(self):
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

    @pytest.mark.parametrize("step", [1e-6, 1e-2])
    def test_zeros_are_found_in_a_motion_as_fast_as_the_sampling(self, step):
        rng = np.random.default_rng(0)
        u = rng.normal(size=8000)
        y = np.round(3 * u / step) * step
        assert not len(dropouts(y, u))
        lost = 10 + 50 * np.arange(100)
        y[lost] = 0.0
        assert set(lost) <= set(dropouts(y, u)) <= set(np.flatnonzero(y == 0))

    def test_a_position_to_which_the_stage_returns_regularly_is_no_dropout(self):
        u = np.random.default_rng(0).uniform(1, 5, 8000)
        u[::20] = 0.0
        assert not len(dropouts(0.8 * u, u))

    def test_overshoots_after_input_steps_are_no_dropouts_but_zeros_among_them_are(self):
        u = np.repeat(np.random.default_rng(3).uniform(0, 10, 60), 20)
        steps = np.flatnonzero(np.diff(u)) + 1
        y = u + 0.001 * np.random.default_rng(4).standard_normal(len(u))
        y[steps] += 0.05 * (u[steps] - u[steps - 1])
        assert len(dropouts(y)) > 50 and not len(dropouts(y, u))
        y[[333, 707]] = 0.0
        assert dropouts(y, u).tolist() == [333, 707]

    def test_the_preshoot_of_a_zero_phase_filter_before_a_step_is_no_dropout(self):
        u = np.repeat(np.random.default_rng(0).uniform([0, 6], [4, 10], (20, 2)).ravel(), 50)
        y = u + np.random.default_rng(1).normal(0, 1e-3, len(u))
        y[:-1] -= 0.06 * np.diff(u)  # the reading before each step goes the other way
        assert len(dropouts(y)) > 20 and len(dropouts(y, u)) == 0

    @pytest.mark.parametrize("late", [0, 1, 5])
    def test_what_a_fast_input_does_itself_is_no_dropout_of_the_output(self, late):
        u = 50 + 10 * np.sin(np.arange(3000) / 80)
        u[[400, 1100, 1900]] -= 5.0  # there and back within a sample
        y = 0.3 * np.roll(u, late) + np.random.default_rng(5).normal(0, 1e-3, len(u))
        assert len(dropouts(y)) == 3 and not len(dropouts(y, u))
        y[[700, 2500]] = 0.0
        assert dropouts(y, u).tolist() == [700, 2500]

    def test_overshoots_a_few_samples_after_a_step_are_no_dropouts(self):
        u = np.repeat(np.random.default_rng(3).uniform(0, 10, 60), 20)
        shares = [0.1, 0.6, 0.34, -0.04]  # of each step; with the third the output overshoots
        rises = np.convolve(np.diff(u, prepend=u[0]), shares)[: len(u)]
        y = u[0] + np.cumsum(rises) + 1e-3 * np.random.default_rng(4).standard_normal(len(u))
        assert len(dropouts(y)) > 40 and not len(dropouts(y, u))

    def test_dropouts_are_found_when_the_input_steps_at_every_sample(self):
        u = np.random.default_rng(3).uniform(5, 10, 500)
        y = np.convolve(u, np.ones(9) / 9, "same")
        y[[101, 250, 311, 402]] = -20.0
        assert dropouts(y, u).tolist() == [101, 250, 311, 402]

    def test_noise_alone_gives_no_dropouts(self):
        false = sum(len(dropouts(np.random.default_rng(k).standard_normal(3000))) > 0 for k in range(100))
        assert false <= 1  # one in a thousand records is allowed for

    @given(
        hnp.arrays(np.float64, st.integers(0, 40), elements=st.floats(-1e12, 1e12, allow_subnormal=True)),
    )
    def test_dropouts_of_any_signal_are_sorted_interior_indices(self, y):
        found = dropouts(y)
        assert np.all((found > 0) & (found < len(y) - 1)) and np.all(np.diff(found) > 0)

    def test_the_warning_counts_dropouts_and_names_their_rows(self, tmp_path, multisine_record):
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
    def test_an_impossible_value_is_refused_with_file_row_and_column(
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

    def test_too_small_input_ranges_and_time_steps_are_refused(self, tmp_path, multisine_record):
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
    def test_swapped_columns_and_an_inverted_sensor_are_reported_with_the_remedy(self, name):
        u = SIGNALS[name][1]
        y = stage(u)
        assert said(record(u, y)) == []
        assert any("leads the input" in line and "input_column" in line for line in said(record(y, u)))
        assert any(
            "falls when the input rises" in line and "output_unit" in line for line in said(record(u, -y))
        )
        assert not any("leads the" in line for line in said(record(u, -y)))

    @given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.integers(500, 3000))
    def test_a_ramp_is_not_reported_as_falling_where_the_input_rises(
        self, gain: float, start: float, samples: int
    ):
        u = 1e-3 * np.arange(samples)
        assert not any("falls when" in line for line in said(record(u, gain * u + start)))

    def test_swapped_columns_are_reported_even_for_a_narrow_loop(self):
        u = SIGNALS["multisine of eq. 13"][1]
        y = 0.7 * u + 0.3 * stage(u) * (np.ptp(u) / np.ptp(stage(u)))
        lines = said(record(y, u))
        assert any("leads the input" in line for line in lines), lines
        assert not any("leads the" in line for line in said(record(u, y)))

    def test_a_start_away_from_zero_is_reported_with_the_remedy(self, multisine_record):
        (text,) = said(record(multisine_record.u, multisine_record.y + 30))
        assert "starts at 30" in text and "zero (first)" in text


class TestUnits:
    @pytest.mark.parametrize(("factor", "unit"), [(1e-6, "m"), (1e-3, "mm"), (1e3, "nm")])
    def test_an_implausible_stroke_is_reported_with_its_likely_unit(self, multisine_record, factor, unit):
        (text,) = said(record(multisine_record.u, multisine_record.y * factor))
        assert f"give output_unit {unit}" in text

    def test_an_implausible_voltage_is_reported_with_its_likely_unit(self, multisine_record):
        (text,) = said(record(multisine_record.u * 1e3, multisine_record.y))
        assert "give input_unit mV" in text
