"""Files as rigs write them: units in headers, preambles, other separators, time stamps of every kind."""

import numpy as np
import pytest

from tests.recordings.test_readers import FS_HZ, T, U, Y, assert_is_the_record, csv_rows, refusal, write_rows
from torchpi.errors import RecordingWarning
from torchpi.recordings.recording import read_recording


class TestAsRigsWriteIt:
    """Each file holds the same recording."""

    @pytest.mark.parametrize(
        "header",
        [
            "time_s,input_v,output_um",
            "time_ms,input_mV,output_nm",
            "Time [ms],u [mV],y [nm]",
            "t (us),Command (V),Displacement (nm)",
            "Time / ms,Voltage / mV,Position / µm",
            "t[ms],U[V],Y[mm]",
            "timestamp_ns,cmd_kV,pos_m",
            "t (msec),U [Volts],Position [cm]",
            "t (seconds),U,Y [Å]",
            "Time (sec),Drive (volts),Stroke (microns)",
            "time,voltage,displacement",
        ],
    )
    def test_columns_and_units_are_found_in_the_header(self, tmp_path, header):
        path = write_rows(tmp_path / "a.csv", csv_rows(header=header))
        scale = [_factor(name) for name in header.split(",")]
        rows = [
            ",".join(f"{x / f:.12g}" for x, f in zip(row, scale, strict=True))
            for row in zip(T, U, Y, strict=True)
        ]
        assert_is_the_record(read_recording(write_rows(path, [header, *rows])))

    @pytest.mark.parametrize("unit", ["furlong", "counts", "in", "%", "a.u.", "NM", "mA"])
    def test_an_unknown_unit_is_refused_with_the_option_that_sets_it(self, tmp_path, unit):
        for header in (f"time_s,u,y [{unit}]", f"time_s,u,y ({unit})", f"time_s,u,output_{unit}"):
            path = write_rows(tmp_path / "a.csv", [header, *csv_rows()[1:]])
            said = refusal(path)
            assert f"is in {unit}, expected um, nm, mm, m, pm, cm, angstrom" in said and "output_unit" in said
            assert_is_the_record(read_recording(path, output_unit=1))

    def test_an_unknown_unit_is_refused_even_if_the_column_is_chosen_by_name(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", ["time_s,input_v,output_furlong", *csv_rows()[1:]])
        expected = f"{path}: column 'output_furlong' is in furlong, expected um, nm, mm, m, pm, cm, angstrom;"
        assert refusal(path, output_column="output_furlong").startswith(expected)

    @pytest.mark.parametrize("name", ["output_raw", "output_CH2", "output_", "y_stage", "gauge_left"])
    def test_the_last_word_of_a_name_need_not_be_a_unit(self, tmp_path, name):
        path = write_rows(tmp_path / "a.csv", [f"time_stamp,input_voltage,{name}", *csv_rows()[1:]])
        chosen = {"time_column": "time_stamp", "input_column": "input_voltage", "output_column": name}
        assert_is_the_record(read_recording(path, **chosen))

    @pytest.mark.parametrize("text", ["1", "CH1", "CH A", "-", "raw", "Sensor", ""])
    def test_text_in_brackets_need_not_be_a_unit(self, tmp_path, text):
        path = write_rows(tmp_path / "a.csv", [f"time (UTC),u,y [{text}]", *csv_rows()[1:]])
        assert_is_the_record(read_recording(path))

    def test_a_temperature_column_named_t_is_not_mistaken_for_time(self, tmp_path):
        rows = [f"{row},7" for row in csv_rows()[1:]]
        path = write_rows(tmp_path / "a.csv", ["time [s],u,y,T [degC]", *rows])
        assert_is_the_record(read_recording(path))

    @pytest.mark.parametrize("units", ["ms,mV,nm", "[ms],[mV],[nm]", "(ms),(mV),(nm)"])
    def test_a_row_of_units_below_the_header_is_read(self, tmp_path, units):
        rows = [f"{1e3 * t:.9g},{1e3 * u:.9g},{1e3 * y:.9g}" for t, u, y in zip(T, U, Y, strict=True)]
        path = write_rows(tmp_path / "a.csv", ["time,input,output", units, *rows])
        assert_is_the_record(read_recording(path))

    @pytest.mark.parametrize(
        "preamble",
        [
            ["Rig 7, 2024-05-01", "Sample rate,10000", "", "Operator: nobody"],
            ["% made by a script", "% of somebody"],
            ["# one", "# two, of three, words"],
            [f"Setting {k}: {k}" for k in range(150)],
            ["Date,2024,05"],
        ],
    )
    @pytest.mark.parametrize("header", ["time_s,input_v,output_um", "# time_s,input_v,output_um"])
    def test_lines_before_the_header_are_skipped_but_counted_in_row_numbers(self, tmp_path, preamble, header):
        rows = [*preamble, header, *csv_rows()[1:]]
        path = write_rows(tmp_path / "a.csv", rows)
        assert_is_the_record(read_recording(path))
        rows[-1] = rows[-1].rpartition(",")[0] + ",nan"
        assert f"row {len(rows)}:" in refusal(write_rows(path, rows))

    def test_the_separator_declared_by_a_spreadsheet_is_used(self, tmp_path):
        rows = ["sep=;", *(row.replace(".", ",") for row in csv_rows(";"))]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", rows)))

    def test_an_unnamed_index_column_is_ignored(self, tmp_path):
        rows = csv_rows()
        rows = ["," + rows[0], *(f"{k},{row}" for k, row in enumerate(rows[1:]))]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", rows)))

    def test_a_delimiter_at_the_end_of_every_row_is_ignored(self, tmp_path):
        assert_is_the_record(
            read_recording(write_rows(tmp_path / "a.csv", [row + ";" for row in csv_rows(";")]))
        )

    def test_utf_16_is_read(self, tmp_path):
        (tmp_path / "a.txt").write_bytes("\r\n".join(csv_rows("\t")).encode("utf-16"))
        assert_is_the_record(read_recording(tmp_path / "a.txt"))

    @pytest.mark.parametrize(
        "stamp",
        [
            "2024-05-01T23:59:59.{:09d}Z",
            "2024-05-01 11:59:59.{:09d}",
            "12:00:00.{:09d}",
            "2024-05-01T12:00:00,{:09d}+02:00",
        ],
    )
    def test_iso_time_stamps_are_read_to_the_nanosecond(self, tmp_path, stamp):
        stamps = [stamp.format(round(1e9 * t)) for t in T]
        rows = ["timestamp;input_v;output_um"]
        rows += [f"{t};{u:.9g};{y:.9g}" for t, u, y in zip(stamps, U, Y, strict=True)]
        if "," in stamp:
            rows = [row.replace(".", ",") for row in rows]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.csv", rows)))

    def test_an_impossible_date_is_refused_with_its_row(self, tmp_path):
        rows = ["time,input_v,output_um"]
        rows += [f"2024-05-01T00:00:{k:02d},{u},{y}" for k, (u, y) in enumerate(zip(U[:50], Y, strict=False))]
        rows[20] = rows[20].replace("2024-05-01", "2024-05-41")
        text = refusal(write_rows(tmp_path / "a.csv", rows))
        assert "row 21:" in text and "2024-05-41" in text and "time stamp" in text

    def test_a_row_with_too_many_cells_is_refused(self, tmp_path):
        rows = csv_rows()
        rows[16] = rows[16].replace(".", ",")
        text = refusal(write_rows(tmp_path / "a.csv", rows))
        assert "row 17:" in text and "expected 3" in text and "decimal comma" in text

    @pytest.mark.parametrize("times", [True, False])
    @pytest.mark.parametrize("between", ["\t", ""])
    def test_labview_measurement_files_are_read(self, tmp_path, times, between):
        columns = "One" if times else "No"
        head = [
            "LabVIEW Measurement\t",
            "Writer_Version\t2",
            "Separator\tTab",
            "Decimal_Separator\t.",
            f"X_Columns\t{columns}",
            "Time_Pref\tAbsolute",
            "***End_of_Header***\t",
            between,
            "Channels\t2\t\t",
            "Samples\t400\t400\t",
            "Y_Unit_Label\tVolts\tnm\t",
            "X0\t0.0E+0\t0.0E+0\t",
            f"Delta_X\t{1 / FS_HZ:E}\t{1 / FS_HZ:E}\t",
            "***End_of_Header***\t\t\t",
            "X_Value\tVoltage\tSensor\tComment",
        ]
        rows = [
            f"{f'{t:.6f}' if times else ''}\t{u:.9g}\t{1e3 * y:.9g}" for t, u, y in zip(T, U, Y, strict=True)
        ]
        assert_is_the_record(read_recording(write_rows(tmp_path / "a.lvm", head + rows)))

    def test_a_single_array_is_read_by_column_number_or_field_name(self, tmp_path):
        table = np.stack((T, U, Y))
        for stored in (table, table.T):
            np.save(tmp_path / "a.npy", stored)
            assert_is_the_record(
                read_recording(tmp_path / "a.npy", time_column=1, input_column=2, output_column=3)
            )
        fields = [("time_s", float), ("input_v", float), ("output_um", float)]
        np.save(tmp_path / "b.npy", np.array(list(zip(T, U, Y, strict=True)), dtype=fields))
        assert_is_the_record(read_recording(tmp_path / "b.npy"))

    def test_ambiguous_columns_are_left_to_the_user(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="time_s,u [V],voltage [V]"))
        assert "'u [V]' and 'voltage [V]' may each be the input" in refusal(path)
        path = write_rows(tmp_path / "a.csv", csv_rows(header="time_s,u [V],sensor [V]"))
        assert "no column 'output_um'" in refusal(path)
        assert "is in V, expected um" in refusal(path, output_column="sensor")
        assert_is_the_record(read_recording(path, output_column="sensor", output_unit=1))

    def test_a_number_given_as_unit_scales_the_signal_and_may_be_negative(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="time_s,input_v,sensor"))
        with pytest.warns(RecordingWarning, match="falls"):
            read = read_recording(path, output_column="sensor", output_unit=-0.5)
        np.testing.assert_allclose(read.y, -0.5 * Y, atol=1e-7)

    def test_unit_options_override_the_header(self, tmp_path):
        path = write_rows(tmp_path / "a.csv", csv_rows(header="time_ms,input_mV,output_nm"))
        assert_is_the_record(read_recording(path, time_unit="s", input_unit="V", output_unit="um"))


def _factor(name: str) -> float:
    """Return the factor from the unit in this column name to ours."""
    powers = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "mv": 1e-3, "kv": 1e3, "nm": 1e-3, "mm": 1e3, "m": 1e6}
    powers |= {"msec": 1e-3, "cm": 1e4, "å": 1e-4}
    return powers.get(
        name.lower().rstrip(")] ").replace("[", " ").replace("(", " ").replace("_", " ").split()[-1], 1.0
    )
