"""The importer of column logs: units, conventions, clocks, and an account of every reading left out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fbn_bringup.importing.importer import import_logs, import_to_bag
from fbn_bringup.importing.mapping import Mapping, read_mapping, restrict
from fbn_bringup.importing.table import LogError
from fbn_common import records as r
from fbn_common.lie import matrix_from_quaternion, rpy_from_matrix
from fbn_common.parameters import ParameterError, load
from fbn_common.types import NS
from fbn_ros.bag import BagReader
from fbn_ros.validation import check

DAY_NS = 1_600_387_200 * NS  # 2020-09-18 00:00 UTC
TIME = {
    "column": "Time",
    "format": "mm:ss",
    "date_column": "Date",
    "date_format": "%m/%d/%y",
    "file_name": r"_(?P<hour>\d\d)\d{4}_",
}
DEPTH = {"depth": {"columns": ["Depth"], "unit": "m"}, "sigma": {"value": 0.1, "unit": "m"}}
COMPASS = {
    "convention": "ned",
    "yaw": {"columns": ["Heading"], "unit": "deg"},
    "pitch": {"columns": ["Pitch"], "unit": "deg"},
    "roll": {"columns": ["Roll"], "unit": "deg"},
    "sigma_yaw": {"value": 2.0, "unit": "deg"},
    "sigma_tilt": {"value": 1.0, "unit": "deg"},
}


def mapping(**groups: object) -> Mapping:
    return load(Mapping, {"time": TIME, **groups})


@pytest.fixture
def log(tmp_path: Path):
    """Writes a csv of these columns, with times a second apart unless given."""

    def write(columns: dict[str, list[object]], name: str = "a_105724_x.csv", encoding: str = "utf-8") -> Path:
        n = len(next(iter(columns.values())))
        filled = {"Time": [f"57:{31 + i:02d}.2" for i in range(n)], "Date": ["9/18/20"] * n, **columns}
        lines = [",".join(filled), *(",".join(str(c[i]) for c in filled.values()) for i in range(n))]
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n", encoding=encoding)
        return path

    return write


def records(path: Path, chosen: Mapping, kind: type[r.Record]) -> list:
    return [record for _, _, record in import_logs([path], chosen)[0] if isinstance(record, kind)]


def test_a_heading_of_east_bow_up_starboard_down_is_yaw_zero_negative_pitch_positive_roll(log) -> None:
    path = log({"Heading": [90.0, 0.0], "Pitch": [10.0, 0.0], "Roll": [5.0, 0.0]})
    east, north = records(path, mapping(compass={"imu/data": COMPASS}), r.Imu)
    assert np.degrees(rpy_from_matrix(matrix_from_quaternion(east.orientation))) == pytest.approx([5.0, -10.0, 0.0])
    assert np.degrees(rpy_from_matrix(matrix_from_quaternion(north.orientation))) == pytest.approx([0.0, 0.0, 90.0])
    assert np.sqrt(np.diag(east.orientation_covariance)) == pytest.approx(np.radians([1.0, 1.0, 2.0]))
    assert east.angular_velocity_covariance[0, 0] == -1.0  # not measured


def test_a_magnetic_heading_gets_the_variation_east_positive(log) -> None:
    path = log({"Heading": [97.0], "Pitch": [0.0], "Roll": [0.0], "Variation": [-7.0]})
    magnetic = {**COMPASS, "variation": {"columns": ["Variation"], "unit": "deg"}}
    (imu,) = records(path, mapping(compass={"imu/data": magnetic}), r.Imu)
    assert rpy_from_matrix(matrix_from_quaternion(imu.orientation))[2] == pytest.approx(0.0, abs=1e-12)


def test_turn_rates_of_ned_change_sign_about_left_and_up(log) -> None:
    path = log({"Heading": [0.0], "Pitch": [0.0], "Roll": [0.0], "p": [1.0], "q": [2.0], "r": [3.0]})
    rates = {f"rate_{a}": {"columns": [c], "unit": "deg/s"} for a, c in (("x", "p"), ("y", "q"), ("z", "r"))}
    turning = {**COMPASS, **rates, "sigma_rate": {"value": 0.5, "unit": "deg/s"}}
    (imu,) = records(path, mapping(compass={"imu/data": turning}), r.Imu)
    assert np.degrees(imu.angular_velocity) == pytest.approx([1.0, -2.0, -3.0])


def test_depth_in_feet_becomes_the_pressure_it_came_from(log) -> None:
    feet = {"depth": {"columns": ["Depth"], "unit": "ft"}, "sigma": {"value": 1.0, "unit": "ft"}, "density": 1025.0}
    (pressure,) = records(log({"Depth": [100.0]}), mapping(pressure={"pressure": feet}), r.FluidPressure)
    assert pressure.fluid_pressure == pytest.approx(101325.0 + 1025.0 * 9.80665 * 30.48)
    assert math.sqrt(pressure.variance) == pytest.approx(1025.0 * 9.80665 * 0.3048)


def test_counts_become_rates_and_angles_by_zero_and_scale(log) -> None:
    joints = {
        "propeller": {"columns": ["Motor"], "unit": "rpm", "zero": 128.0, "scale": 10.0},
        "rudder": {"columns": ["Top", "Bottom"], "unit": "deg", "zero": 128.0, "scale": -0.25},
    }
    path = log({"Motor": [188], "Top": [124], "Bottom": [128]})
    (state,) = records(path, mapping(actuators={"actuators": {"joints": joints}}), r.JointState)
    assert state.name == ("propeller", "rudder")
    assert state.velocity == pytest.approx([600.0 * math.pi / 30.0, 0.0])
    assert np.degrees(state.position) == pytest.approx([0.0, 0.5])  # the mean of 124 and 128 is 2 under zero


def test_an_altimeter_without_bottom_is_handed_on_as_such_and_counted(log) -> None:
    altimeter = {"range": {"columns": ["Height"], "unit": "m"}}
    items, report = import_logs([log({"Height": [3.5, 0.0]})], mapping(altitude={"altitude": altimeter}))
    assert [record.range for _, _, record in items] == [3.5, 0.0]
    assert report.sensors["altitude"].notes == {"no bottom": 1}


def test_hdop_gives_the_covariance_and_too_few_satellites_no_fix(log) -> None:
    gps = {
        "latitude": {"columns": ["Lat"], "unit": "deg"},
        "longitude": {"columns": ["Lon"], "unit": "deg"},
        "sigma": {"columns": ["HDOP"], "unit": "m", "scale": 3.0, "floor": 3.0},
        "fix": {"satellites": {"column": "Sats", "least": 4}},
        "repeats": False,
    }
    path = log(
        {"Lat": [25.91, 25.92, 25.93, 25.93], "Lon": [-80.1] * 4, "HDOP": [2.0, 0.8, 9.0, 9.0], "Sats": [9, 9, 3, 3]}
    )
    items, report = import_logs([path], mapping(gps={"gps/fix": gps}))
    fixes = [record for _, _, record in items]
    assert [f.status for f in fixes] == [0, 0, -1]
    assert [math.sqrt(f.position_covariance[0, 0]) for f in fixes] == pytest.approx([6.0, 3.0, 27.0])
    assert fixes[0].latitude == pytest.approx(25.91, abs=1e-12)
    assert report.sensors["gps/fix"].refused == {"repeats the row before": 1}
    assert report.sensors["gps/fix"].notes == {"no fix by 'satellites'": 1}


def test_beacons_share_one_topic_and_keep_their_names(log) -> None:
    beacon = {"sigma": {"value": 1.0, "unit": "m"}, "travel_delay": {"columns": ["TT"], "unit": "ms"}}
    two = {name: {"range": {"columns": [name], "unit": "m"}, **beacon} for name in ("A", "B")}
    items, _ = import_logs([log({"A": [100.0, ""], "B": [50.0, 51.0], "TT": [130.0, 130.0]})], mapping(beacons=two))
    found = [(topic, record.beacon_id, record.range) for _, topic, record in items]
    assert found == [("lbl/range", "A", 100.0), ("lbl/range", "B", 50.0), ("lbl/range", "B", 51.0)]
    assert items[0][2].travel_delay == pytest.approx(0.13)


def test_minutes_wrap_every_hour_and_the_hour_comes_from_the_name(log) -> None:
    path = log({"Time": ["59:59.5", "00:00.5", "00:01.5"], "Depth": [1, 2, 3]}, "a_105959_x.csv")
    items, _ = import_logs([path], mapping(pressure={"pressure": DEPTH}))
    assert [t for t, _, _ in items] == [DAY_NS + round((10 * 3600 + 3599.5 + i) * NS) for i in range(3)]


def test_a_name_written_just_before_the_hour_does_not_shift_the_log_by_one(log) -> None:
    late = {**TIME, "file_name": r"_(?P<hour>\d\d)(?P<minute>\d\d)\d\d_"}
    path = log({"Time": ["00:00.5"], "Depth": [1]}, "a_105959_x.csv")
    items, _ = import_logs([path], load(Mapping, {"time": late, "pressure": {"pressure": DEPTH}}))
    assert items[0][0] == DAY_NS + round((11 * 3600 + 0.5) * NS)


@pytest.mark.parametrize(
    ("clock", "cells", "first_s"),
    [
        ({"format": "seconds"}, ["1600387200.25"], 0.25),
        ({"format": "milliseconds", "start": "2020-09-18"}, ["1500"], 1.5),
        ({"format": "iso"}, ["2020-09-18T00:00:02.5+00:00"], 2.5),
        ({"format": "%d.%m.%Y %H-%M-%S.%f"}, ["18.09.2020 00-00-03.5"], 3.5),
        ({"format": "hh:mm:ss", "date_column": "Date", "date_format": "%m/%d/%y"}, ["01:00:00.5"], 3600.5),
        ({"format": "hh:mm:ss", "start": "2020-09-18T08:00", "utc_offset": 2.0}, ["03:00:00"], 3600.0),
        ({"format": "mm:ss", "start": "2020-09-18T08:00"}, ["01:30"], 8 * 3600 + 90.0),
    ],
)
def test_every_format_of_time_gives_the_stamp_it_says(log, clock, cells, first_s) -> None:
    path = log({"Time": cells, "Depth": [1.0]})
    items, _ = import_logs(
        [path], load(Mapping, {"time": {"column": "Time", **clock}, "pressure": {"pressure": DEPTH}})
    )
    assert items[0][0] == DAY_NS + round(first_s * NS)


def test_a_clock_of_days_goes_on_over_midnight(log) -> None:
    clock = {"column": "Time", "format": "hh:mm:ss", "start": "2020-09-18"}
    path = log({"Time": ["23:59:59", "00:00:01"], "Depth": [1, 2]})
    items, _ = import_logs([path], load(Mapping, {"time": clock, "pressure": {"pressure": DEPTH}}))
    assert items[1][0] - items[0][0] == 2 * NS


def test_repeated_backward_leaping_and_unreadable_stamps_are_dropped_and_named(log) -> None:
    times = ["57:01.0", "57:02.0", "57:02.0", "57:01.5", "58:30.0", "57:03.0", "", "57:15.0"]
    items, report = import_logs([log({"Time": times, "Depth": [0] * 8})], mapping(pressure={"pressure": DEPTH}))
    seconds = [(t - DAY_NS) / NS - 10 * 3600 - 57 * 60 for t, _, _ in items]
    assert seconds == pytest.approx([1.0, 2.0, 3.0, 15.0])
    (file,) = report.files
    assert file.dropped == {
        "repeated stamp": [4],
        "stamp goes back": [5],
        "stamp leaps ahead and back": [6],
        "no time": [8],
    }
    assert file.gaps == ((9, pytest.approx(12.0)),)


def test_files_are_put_in_order_and_their_overlap_is_dropped(log) -> None:
    second = log({"Time": ["57:32.0", "57:33.0"], "Depth": [3, 4]}, "b_105700_x.csv")
    first = log({"Time": ["57:31.0", "57:32.0"], "Depth": [1, 2]}, "a_105700_x.csv")
    items, report = import_logs([second, first], mapping(pressure={"pressure": DEPTH}))
    assert len(items) == 3
    assert [f.path.name for f in report.files] == ["a_105700_x.csv", "b_105700_x.csv"]
    assert report.files[1].dropped == {"repeated stamp": [2]}


def test_missing_cells_give_no_message_for_that_sensor_alone_and_are_counted(log) -> None:
    path = log({"Depth": ["1.0", "", "NaN", "9999.99", "-5", "inf"], "Height": [1.0] * 6})
    shallow = {**DEPTH, "depth": {**DEPTH["depth"], "least": 0.0}}
    chosen = mapping(
        file={"missing": ["9999.99"]},
        pressure={"pressure": shallow},
        altitude={"altitude": {"range": {"columns": ["Height"], "unit": "m"}}},
    )
    items, report = import_logs([path], chosen)
    assert [topic for _, topic, _ in items].count("altitude") == 6
    assert report.sensors["pressure"].written == 1
    assert report.sensors["pressure"].refused == {"pressure missing or out of range": 5}
    for _, _, record in items:
        check(record)


def test_rules_choose_rows_and_messages_and_are_counted_by_name(log) -> None:
    path = log({"State": [0, 1, 1, ""], "Depth": [0.0, 1.0, 30.0, 1.0]})
    deep = {**DEPTH, "when": {"shallow": {"column": "Depth", "below": 10.0}}}
    chosen = restrict(mapping(pressure={"pressure": deep}), ["State=1"])
    items, report = import_logs([path], chosen)
    assert len(items) == 1
    assert report.files[0].dropped == {"rule 'State=1'": [2, 5]}
    assert report.sensors["pressure"].refused == {"rule 'shallow'": 1}


def test_latin_letters_blanks_in_names_semicolons_and_decimal_commas_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a_105724_x.csv"
    path.write_text(
        "written by °\nTime ;Date;  Water   depth \n57:01,5;9/18/20; 2,5\n57:02,5;9/18/20\n", encoding="latin-1"
    )
    deep = {**DEPTH, "depth": {"columns": ["Water depth"], "unit": "m"}}
    form = {"encoding": "latin-1", "delimiter": ";", "decimal": ",", "skip_lines": 1}
    items, report = import_logs([path], mapping(file=form, pressure={"pressure": deep}))
    assert items[0][2].fluid_pressure == pytest.approx(101325.0 + 2.5 * 1000.0 * 9.80665)
    assert report.files[0].notes == {"short rows": 1}


def test_an_older_measurement_has_an_earlier_stamp_than_its_row(log) -> None:
    items, _ = import_logs([log({"Depth": [1.0]})], mapping(pressure={"pressure": {**DEPTH, "age": 0.7}}))
    log_ns, _, record = items[0]
    assert log_ns - record.stamp_ns == 700_000_000


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ({"pressure": {"pressure": {**DEPTH, "dpeth": {}}}}, "did you mean 'pressure.pressure.depth'"),
        ({"pressure": {"presure": DEPTH}}, "use pressure"),
        ({"pressure": {"pressure": {"sigma": DEPTH["sigma"]}}}, "needs either depth or pressure"),
        ({"pressure": {"pressure": {"depth": DEPTH["depth"]}}}, "needs sigma"),
        ({"compass": {"imu/data": {**COMPASS, "convention": "NED"}}}, "'ned' or 'enu'"),
        ({}, "maps nothing"),
    ],
)
def test_a_mapping_that_is_wrong_is_refused_with_the_remedy(groups, words) -> None:
    with pytest.raises(ParameterError, match=words):
        mapping(**groups)


def test_a_unit_of_the_wrong_kind_is_refused_with_those_that_fit(log) -> None:
    wrong = {**DEPTH, "depth": {"columns": ["Depth"], "unit": "deg"}}
    with pytest.raises(ParameterError, match=r"unit 'deg' is not one of length; .*ft"):
        import_logs([log({"Depth": [1.0]})], mapping(pressure={"pressure": wrong}))


def test_a_column_that_the_log_has_not_is_refused_with_the_nearest(log) -> None:
    with pytest.raises(LogError, match=r"no column 'Depth'; did you mean 'Depht'"):
        import_logs([log({"Depht": [1.0]})], mapping(pressure={"pressure": DEPTH}))


def test_a_column_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a_105724_x.csv"
    path.write_text("Time,Date,Depth,Depth\n57:01,9/18/20,1,2\n")
    with pytest.raises(LogError, match=r"'Depth' is there 2 times \(columns 3, 4\)"):
        import_logs([path], mapping(pressure={"pressure": DEPTH}))


def test_a_wrong_encoding_is_named_with_the_key_to_set(log) -> None:
    path = log({"Depth": [1.0], "°": [1]}, encoding="latin-1")
    with pytest.raises(LogError, match=r"file\.encoding, e\.g\. latin-1"):
        import_logs([path], mapping(pressure={"pressure": DEPTH}))


def test_times_of_another_format_are_refused_with_an_example(log) -> None:
    with pytest.raises(LogError, match=r"no cell of 'Time' is a time of format 'mm:ss', e\.g\. 'noon'"):
        import_logs([log({"Time": ["noon"], "Depth": [1.0]})], mapping(pressure={"pressure": DEPTH}))


def test_a_log_whose_hour_nobody_knows_is_refused_with_the_keys_that_say_it(log) -> None:
    clock = {k: v for k, v in TIME.items() if k != "file_name"}
    with pytest.raises(LogError, match=r"the hour of the first row; set time\.file_name or time\.start"):
        import_logs([log({"Depth": [1.0]})], load(Mapping, {"time": clock, "pressure": {"pressure": DEPTH}}))


def test_a_log_of_which_nothing_remains_is_refused_with_the_reasons(log) -> None:
    with pytest.raises(LogError, match="no message came of any row; pressure missing or out of range: 2"):
        import_logs([log({"Depth": ["", ""]})], mapping(pressure={"pressure": DEPTH}))


def test_the_bag_holds_what_was_imported_in_order_of_time(log, tmp_path: Path) -> None:
    path = log({"Heading": [0, 1], "Pitch": [0, 0], "Roll": [0, 0], "Depth": [1.0, 1.1]})
    report = import_to_bag(
        [path], mapping(compass={"imu/data": COMPASS}, pressure={"pressure": DEPTH}), tmp_path / "bag"
    )
    with BagReader(tmp_path / "bag") as reader:
        found = list(reader.records())
    assert {name: s.written for name, s in report.sensors.items()} == {"imu/data": 2, "pressure": 2}
    assert [topic for _, topic, _ in found] == ["imu/data", "pressure"] * 2
    assert [t for t, _, _ in found] == sorted(t for t, _, _ in found)


def test_the_mapping_that_comes_along_is_well_formed() -> None:
    chosen = read_mapping(Path(__file__).parents[1] / "config/import/iver2.yaml")
    assert {name for _, name, _ in chosen.sensors()} == {"imu/data", "pressure", "altitude", "gps/fix", "actuators"}
