"""Every file format gives the same numbers, and every fault one line that says where and what to do."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.recordings.readers import open_source
from torchpi.recordings.readers.time_stamps import round_rate, uniform_grid
from torchpi.recordings.recording import read_recording

FS_HZ = 10_000.0
T = np.arange(400) / FS_HZ
U = 5 - 5 * np.cos(2 * np.pi * 25 * T)
Y = 0.8 * U + 0.01 * np.sin(7 * U)


def refusal(path: Path, **options: object) -> str:
    """Return the error's text, after checking that it is one line and begins with the file."""
    with pytest.raises(RecordingError) as caught:
        read_recording(path, **options)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text


def write_rows(path: Path, rows: list[str]) -> Path:
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def csv_rows(delimiter: str = ",", header: str = "time_s,input_v,output_um") -> list[str]:
    return [header.replace(",", delimiter)] + [
        delimiter.join(f"{x:.9g}" for x in row) for row in zip(T, U, Y, strict=True)
    ]


def assert_is_the_record(recording, atol: float = 1e-7) -> None:
    assert recording.fs_hz == FS_HZ
    np.testing.assert_allclose(recording.t, T, atol=1e-9)
    np.testing.assert_allclose(recording.u, U, atol=atol)
    np.testing.assert_allclose(recording.y, Y, atol=atol)


class TestText:
    @pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
    def test_the_delimiter_is_recognised(self, tmp_path, delimiter):
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", csv_rows(delimiter))))

    @pytest.mark.parametrize("delimiter", [";", "\t"])
    def test_a_decimal_comma_is_recognised(self, tmp_path, delimiter):
        rows = [row.replace(".", ",") for row in csv_rows(delimiter)]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", rows)))

    def test_a_byte_order_mark_quotes_and_spaces_are_accepted(self, tmp_path):
        rows = ['\ufeff"time_s", "input_v", "output_um"'] + [row.replace(",", ", ") for row in csv_rows()[1:]]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", rows)))

    def test_windows_line_endings_are_accepted(self, tmp_path):
        (tmp_path / "a.csv").write_bytes("\r\n".join([*csv_rows(), ""]).encode())
        assert_is_the_record(read_recording(tmp_path / "a.csv"))

    def test_a_header_in_latin_1_is_read(self, tmp_path):
        rows = csv_rows(header="time_s,input_v,output [µm]")
        (tmp_path / "a.csv").write_bytes("\n".join(rows).encode("latin-1"))
        assert_is_the_record(read_recording(tmp_path / "a.csv", output_column="output [µm]"))

    def test_columns_are_chosen_by_name(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="Time,Command (V),Sensor #1"))
        assert_is_the_record(
            read_recording(path, time_column="Time", input_column="Command (V)", output_column="Sensor #1")
        )

    def test_text_without_a_header_is_read_by_column_number(self, tmp_path):
        path = write_rows(tmp_path / "a.dat", csv_rows(" ")[1:])
        assert_is_the_record(read_recording(path, time_column=1, input_column=2, output_column="3"))
        assert_is_the_record(read_recording(path, input_column=2, output_column=3, fs_hz=FS_HZ))

    def test_the_header_that_numpy_savetxt_writes_is_read(self, tmp_path):
        np.savetxt(
            tmp_path / "a.csv", np.stack((T, U, Y), 1), delimiter=",", header="time_s,input_v,output_um"
        )
        assert_is_the_record(read_recording(tmp_path / "a.csv"))

    def test_text_without_a_header_is_refused_with_a_request_for_column_numbers(self, tmp_path):
        path = write_rows(tmp_path / "a.dat", csv_rows(" ")[1:])
        text = refusal(path)
        assert "no header row" in text and "1 to 3" in text and "input_column" in text and "fs_hz" in text

    def test_an_unknown_column_is_refused_with_the_nearest_and_all_names(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="time_s,input_V,ouput"))
        text = refusal(path, input_column="input_V")
        assert "'output_um'" in text and "nearest is 'ouput'" in text and "time_s, input_V, ouput" in text

    def test_a_missing_time_column_is_refused_unless_a_sample_rate_is_given(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="zeit,input_v,output_um"))
        assert "fs_hz" in refusal(path)
        np.testing.assert_allclose(read_recording(path, fs_hz=FS_HZ).u, U, atol=1e-7)

    @pytest.mark.parametrize(
        ("cell", "says"),
        [("abc", "'abc'"), ("", "found nothing"), ("1_000", "'1_000'"), ("--", "'--'")],
    )
    def test_text_in_a_cell_is_reported_with_its_row_and_column(self, tmp_path, cell, says):
        rows = csv_rows()
        rows[16] = f"{T[15]},{cell},1.0"
        text = refusal(write_rows(tmp_path / "a.csv", rows))
        assert "row 17:" in text and "'input_v'" in text and says in text

    def test_a_short_row_is_reported(self, tmp_path):
        rows = csv_rows()
        rows[16] = "0.0015"
        text = refusal(write_rows(tmp_path / "a.csv", rows))
        assert "row 17:" in text and "found nothing" in text

    @given(
        row=st.integers(1, len(T)),
        column=st.sampled_from(["time_s", "input_v", "output_um"]),
        cell=st.sampled_from(["nan", "NaN", "inf", "-inf"]),
        comments=st.integers(0, 3),
    )
    def test_a_non_finite_number_is_reported_with_its_row_and_column(
        self, tmp_path_factory, row, column, cell, comments
    ):
        rows = csv_rows()
        cells = rows[row].split(",")
        cells[["time_s", "input_v", "output_um"].index(column)] = cell
        rows[row] = ",".join(cells)
        rows[row:row] = ["# a comment"] * comments
        text = refusal(write_rows(tmp_path_factory.mktemp("nan") / "a.csv", rows))
        assert f"row {row + 1 + comments}:" in text
        assert f"'{column}'" in text
        assert f"found {float(cell)}" in text

    def test_an_unused_column_may_hold_anything(self, tmp_path):
        rows = [row + (",note" if k == 0 else ",n/a") for k, row in enumerate(csv_rows())]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", rows)))

    def test_input_and_output_must_be_different_columns(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows())
        assert "same column 'input_v'" in refusal(path, output_column=2)

    def test_a_repeated_column_name_is_refused(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="time_s,input_v,input_v"))
        assert "occurs twice" in refusal(path)

    def test_files_without_data_are_refused(self, tmp_path):
        (tmp_path / "a.csv").write_text("")
        assert "empty" in refusal(tmp_path / "a.csv")
        (tmp_path / "b.csv").write_text("\n\n")
        assert "no row" in refusal(tmp_path / "b.csv")
        (tmp_path / "c.csv").write_text("time_s,input_v,output_um\n")
        assert "below the header" in refusal(tmp_path / "c.csv")

    def test_a_binary_file_is_not_taken_for_text(self, tmp_path):
        (tmp_path / "a.csv").write_bytes(bytes(range(256)))
        assert "binary" in refusal(tmp_path / "a.csv")


class TestWhichFile:
    def test_a_missing_file_is_refused_with_the_nearest_name(self, tmp_path):
        write_rows(tmp_path / "record.csv", csv_rows())
        assert "record.csv" in refusal(tmp_path / "recrod.csv")
        assert "no such file" in refusal(tmp_path / "recrod.csv")
        assert "no folder" in refusal(tmp_path / "nowhere" / "a.csv")

    def test_a_folder_or_an_unknown_file_type_is_refused(self, tmp_path):
        assert "folder" in refusal(tmp_path)
        (tmp_path / "a.docx").write_text("x")
        assert ".csv" in refusal(tmp_path / "a.docx")

    @pytest.mark.parametrize("suffix", [".npz", ".mat", ".h5", ".tdms", ".mf4"])
    def test_a_file_whose_content_contradicts_its_suffix_is_refused(self, tmp_path, suffix):
        (tmp_path / f"a{suffix}").write_text("this is no such file\n" * 100)
        assert " is not a" in refusal(tmp_path / f"a{suffix}")


class TestNpz:
    def test_arrays_are_read_by_name_with_the_sample_rate_from_the_file(self, tmp_path):
        np.savez(tmp_path / "a.npz", volts=U, um=Y, fs=FS_HZ, aux_temp_c=T)
        recording = read_recording(tmp_path / "a.npz", input_column="volts", output_column="um", fs_hz="fs")
        assert_is_the_record(recording)
        np.testing.assert_array_equal(recording.aux["aux_temp_c"], T)

    def test_an_index_selects_one_signal_of_an_array(self, tmp_path):
        np.savez(tmp_path / "a.npz", d=np.stack((U, Y), 1)[:, :, None])
        recording = read_recording(
            tmp_path / "a.npz", input_column="d[:,0,0]", output_column="d[:, 1, 0]", fs_hz=FS_HZ
        )
        assert_is_the_record(recording)

    def test_an_array_of_several_axes_is_refused_with_the_index_to_use(self, tmp_path):
        np.savez(tmp_path / "a.npz", input_v=np.zeros((400, 3)), output_um=Y)
        assert "input_v[:,0]" in refusal(tmp_path / "a.npz", fs_hz=FS_HZ)
        assert "input_v[:,0]" in refusal(tmp_path / "a.npz", input_column="input_v[:,7]", fs_hz=FS_HZ)

    def test_unequal_lengths_are_refused(self, tmp_path):
        np.savez(tmp_path / "a.npz", input_v=U, output_um=Y[:-1])
        text = refusal(tmp_path / "a.npz", fs_hz=FS_HZ)
        assert "unequal lengths" in text and "400" in text and "399" in text

    def test_missing_time_and_sample_rate_are_refused_with_both_options(self, tmp_path):
        np.savez(tmp_path / "a.npz", input_v=U, output_um=Y)
        text = refusal(tmp_path / "a.npz")
        assert "fs_hz" in text and "time_column" in text

    def test_a_bad_sample_is_reported_by_its_number_counted_from_one(self, tmp_path):
        y = Y.copy()
        y[41] = np.nan
        np.savez(tmp_path / "a.npz", input_v=U, output_um=y)
        assert "sample 42:" in refusal(tmp_path / "a.npz", fs_hz=FS_HZ)

    def test_text_and_objects_are_refused(self, tmp_path):
        np.savez(tmp_path / "a.npz", input_v=np.array(["a", "b"]), output_um=Y)
        assert "expected numbers" in refusal(tmp_path / "a.npz", fs_hz=FS_HZ)
        np.savez(tmp_path / "b.npz", input_v=np.array([{}, {}]), output_um=Y)
        assert "'input_v'" in refusal(tmp_path / "b.npz", fs_hz=FS_HZ)


class TestMat:
    def test_variables_and_struct_fields_are_read_by_name(self, tmp_path):
        from scipy.io import savemat

        savemat(tmp_path / "a.mat", {"time_s": T, "input_v": U[:, None], "log": {"output_um": Y, "n": 3}})
        assert open_source(tmp_path / "a.mat").names == ["time_s", "input_v", "log.output_um", "log.n"]
        assert_is_the_record(read_recording(tmp_path / "a.mat", output_column="log.output_um"))

    def test_version_7_3_is_recognised_by_its_content(self, tmp_path):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
            file["time_s"], file["log/input_v"], file["log/output_um"] = T[None], U[None], Y[None]
            file["log/many"] = np.stack((U, Y))  # 400×2 in MATLAB, whose axes HDF5 reverses
            file["#refs#/a"] = np.zeros(3)
        with open(tmp_path / "a.mat", "r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file")
        assert not any(name.startswith("#") for name in open_source(tmp_path / "a.mat").names)
        for u, y in (("log.input_v", "log/output_um"), ("log.many[:,0]", "log.many[:,1]")):
            assert_is_the_record(read_recording(tmp_path / "a.mat", input_column=u, output_column=y))


class TestExtraFormats:
    def test_hdf5_datasets_are_read_by_path(self, tmp_path):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["run/u"], file["run/y"], file["run/fs"] = U, Y, FS_HZ
        recording = read_recording(
            tmp_path / "a.h5", input_column="run/u", output_column="/run/y", fs_hz="run/fs"
        )
        assert_is_the_record(recording)
        assert "the nearest is 'run/" in refusal(tmp_path / "a.h5", input_column="run/v", fs_hz=FS_HZ)

    @pytest.mark.parametrize("increment", [1 / FS_HZ, None])
    def test_tdms_channels_are_read_with_their_increment_or_a_given_rate(self, tmp_path, increment):
        nptdms = pytest.importorskip("nptdms")
        properties = {"wf_increment": increment} if increment else {}
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
            writer.write_segment(
                [
                    nptdms.ChannelObject("run", "input_v", U, properties=properties),
                    nptdms.ChannelObject("run", "output_um", Y, properties=properties),
                ]
            )
        rate = None if increment else FS_HZ
        assert_is_the_record(read_recording(tmp_path / "a.tdms", fs_hz=rate))
        assert_is_the_record(read_recording(tmp_path / "a.tdms", input_column="run/input_v", fs_hz=rate))
        if rate:
            assert "fs_hz" in refusal(tmp_path / "a.tdms")

    def test_mf4_channels_are_read_with_their_time_stamps(self, tmp_path):
        asammdf = pytest.importorskip("asammdf")
        with asammdf.MDF() as file:
            file.append(
                [
                    asammdf.Signal(samples=U, timestamps=T, name="input_v"),
                    asammdf.Signal(samples=Y, timestamps=T, name="output_um"),
                ]
            )
            file.append([asammdf.Signal(samples=Y[::2], timestamps=T[::2], name="slow_um")])
            file.save(tmp_path / "a.mf4")
        assert_is_the_record(read_recording(tmp_path / "a.mf4"))
        assert "'slow_um'" in refusal(tmp_path / "a.mf4", output_column="slow_um")

    def test_units_stored_as_metadata_of_the_signals_are_read(self, tmp_path):
        h5py = pytest.importorskip("h5py")
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["u"], file["y"], file["fs"] = 1e3 * U, 1e3 * Y, FS_HZ
            file["u"].attrs["units"], file["y"].attrs["unit"] = "mV", "nm"
        assert_is_the_record(read_recording(tmp_path / "a.h5", fs_hz="fs"))
        nptdms = pytest.importorskip("nptdms")
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
            channels = [
                nptdms.ChannelObject(
                    "run", name, x, properties={"wf_increment": 1 / FS_HZ, "unit_string": unit}
                )
                for name, x, unit in (("ai0", 1e3 * U, "mV"), ("ai1", 1e3 * Y, "nm"))
            ]
            writer.write_segment(channels)
        assert_is_the_record(read_recording(tmp_path / "a.tdms"))
        asammdf = pytest.importorskip("asammdf")
        with asammdf.MDF() as file:
            file.append(
                [
                    asammdf.Signal(samples=1e3 * U, timestamps=T, name="ch0", unit="mV"),
                    asammdf.Signal(samples=1e3 * Y, timestamps=T, name="ch1", unit="nm"),
                ]
            )
            file.save(tmp_path / "a.mf4")
        assert_is_the_record(read_recording(tmp_path / "a.mf4"))

    def test_a_truncated_recording_causes_a_warning(self, tmp_path):
        nptdms = pytest.importorskip("nptdms")
        with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
            for _ in range(2):
                writer.write_segment(
                    [nptdms.ChannelObject("run", name, x) for name, x in (("input_v", U), ("output_um", Y))]
                )
        whole = (tmp_path / "a.tdms").read_bytes()
        (tmp_path / "b.tdms").write_bytes(whole[:-3200])
        with pytest.warns(RecordingWarning, match=r"b\.tdms: Last segment .*complete"):
            open_source(tmp_path / "b.tdms")

    @pytest.mark.parametrize(
        ("suffix", "module"), [(".h5", "h5py"), (".tdms", "nptdms"), (".mf4", "asammdf")]
    )
    def test_a_missing_optional_package_is_reported_with_its_install_command(
        self, tmp_path, monkeypatch, suffix, module
    ):
        monkeypatch.setitem(__import__("sys").modules, module, None)
        (tmp_path / f"a{suffix}").write_bytes(b"x")
        assert "pip install 'torchpi[io]'" in refusal(tmp_path / f"a{suffix}")


class TestTimeStamps:
    @pytest.mark.parametrize("fs_hz", [10_000.0, 9_700.0, 7_000.0, 3_000.0, 200.0, 51_200.0, 1e5 / 3])
    @pytest.mark.parametrize("printed", ["%.6f", "%.6g", "%.9g", "%.17g", "float32"])
    @pytest.mark.parametrize("samples", [500, 20_000])
    def test_stamps_with_few_digits_give_the_exact_rate(self, fs_hz, printed, samples):
        t = np.arange(samples) / fs_hz
        stamps = (
            t.astype(np.float32).astype(float)
            if printed == "float32"
            else np.array([float(printed % x) for x in t])
        )
        grid = uniform_grid(stamps)
        assert grid.odd_sample is None
        assert grid.fs_hz == fs_hz

    def test_stamps_coarser_than_the_sample_period_give_the_exact_rate(self):
        t = 100 + np.arange(20_000) / FS_HZ  # %.6g prints ten equal stamps in a row
        grid = uniform_grid(np.array([float(f"{x:.6g}") for x in t]))
        assert grid.odd_sample is None
        assert grid.fs_hz == FS_HZ

    @given(
        fs_hz=st.sampled_from([10_000.0, 3_000.0, 200.0]),
        samples=st.integers(20, 3_000),
        start=st.sampled_from([0.0, -1.5, 12.25]),
        lost=st.floats(0.1, 0.9),
    )
    def test_a_lost_row_is_found(self, fs_hz, samples, start, lost):
        row = int(lost * samples)
        t = np.round(np.delete(start + np.arange(samples) / fs_hz, row), 6)
        assert uniform_grid(t).odd_sample == row

    @given(st.integers(1, 10**7), st.floats(-1e-10, 1e-10))
    def test_a_round_rate_is_recovered_despite_rounding_errors(self, fs_hz, error):
        assert round_rate((1 + error) / fs_hz, 0.0) == pytest.approx(fs_hz, rel=2e-9)
        if fs_hz < 10**4:
            assert round_rate((1 + error) / fs_hz, 0.0) == fs_hz

    def test_a_changing_sample_rate_is_not_taken_as_uniform(self):
        step = np.where(np.arange(10_000) < 5_000, 1.000e-4, 1.005e-4)
        assert uniform_grid(np.cumsum(step)).odd_sample is not None
