"""The house stands: packages, layers, messages and the environment are what the design says."""

import ast
import dataclasses
import importlib.util
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from ament_index_python.packages import get_package_share_directory

import fbn_msgs.msg
from fbn_common import records

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(manifest.parent for manifest in (ROOT / "src").glob("*/package.xml"))
PYTHON_PACKAGES = [package for package in PACKAGES if (package / "setup.py").exists()]
ESTIMATORS = {"fbn_predict", "fbn_deadreck", "fbn_reference", "fbn_tracking", "fbn_global"}

# Every message that others may rely on, with its fields: logs and outside tools are written against these.
CONTRACT = {
    "BeaconRange": "header beacon_id range range_variance travel_delay",
    "SonarDetection": "range bearing range_sigma bearing_sigma intensity",
    "SonarDetections": "header ping range_min range_max bearing_min bearing_max lobe_width detections",
    "SonarImage": "header sound_speed frequency ranges bearings lobe_width intensities",
    "FeatureBearings": "header track_ids directions sigma",
    "PredictedMotion": "header start increment rotation velocity_start velocity_end parameters attitude_start"
    " jacobian_velocity jacobian_attitude jacobian_parameters noise",
    "VehicleParameters": "header mean covariance further further_covariance",
    "PingMotion": "header previous increment increment_covariance pose earth earth_information earth_covariance"
    " velocity altitude altitude_variance drift_covariance drift_time_constant heading_deviation heading_drift",
    "ReferenceFix": "header xy covariance marginal",
    "Datum": "header latitude longitude height",
    "Innovation": "header sensor innovation sigma nis dof verdict reason",
    "TrackedFeature": "key stage detections position covariance first_seen last_seen rival_probability rival_position",
    "TrackedFeatures": "header pings features",
    "CompositeFeature": "key detections expected first_seen last_seen",
    "SweptArea": "cell_size origin width height scans",
    "CompositeMeasurement": "header sequence start first pings distance_travelled features mean covariance"
    " prior_mean prior_covariance drift_time_constant swept base_odom p2_odom",
    "MapFeature": "id name position prior existence visibility target",
    "FeatureMap": "header datum_latitude datum_longitude datum_height features covariance",
    "MatchHypothesis": "id parent log_score posterior positive negative map_ids feature_keys pose pose_covariance",
    "MatchHypotheses": "header hypotheses",
    "LocalizationStatus": "header matched state posterior features_matched reason seconds_since_matched target_id"
    " target_position target_covariance target_position_body target_covariance_body target_range target_bearing",
    "TopicCount": "topic count",
    "NodeProgress": "header node step published",
}

CONSTANTS = {
    "Innovation": {"USED": 0, "GATED": 1, "REFUSED": 2, "LATE": 3},
    "TrackedFeature": {"INFANT": 0, "FEATURE": 1, "RETIRED": 2},
    "LocalizationStatus": {"UNMATCHED": 0, "MATCHED": 1, "AMBIGUOUS": 2, "LOST": 3},
}

FIXED_SIZES = {
    "VehicleParameters": {"mean": "double[15]", "covariance": "double[225]"},
    "PredictedMotion": {
        "jacobian_velocity": "double[72]",
        "jacobian_attitude": "double[36]",
        "jacobian_parameters": "double[180]",
        "noise": "double[144]",
    },
    "PingMotion": {"earth": "double[4]", "earth_information": "double[16]", "increment_covariance": "double[36]"},
}


def fields_of(message: str) -> dict[str, str]:
    return dict(getattr(fbn_msgs.msg, message).get_fields_and_field_types())


# -- packages ------------------------------------------------------------------------------------


def test_colcon_takes_every_package_for_a_ros_package() -> None:
    command = ["colcon", "--log-base", os.devnull, "list", "--base-paths", str(ROOT / "ros2_ws" / "src")]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    kinds = {name: kind for name, _, kind in (line.split("\t") for line in listing.splitlines())}
    assert set(kinds) == {package.name for package in PACKAGES}
    assert set(kinds.values()) <= {"(ros.ament_python)", "(ros.ament_cmake)"}


def test_every_package_has_the_same_setup() -> None:
    assert len({(package / "setup.py").read_text() for package in PYTHON_PACKAGES}) == 1


@pytest.mark.parametrize("package", PYTHON_PACKAGES, ids=lambda package: package.name)
def test_tests_run_against_the_sources(package: Path) -> None:
    spec = importlib.util.find_spec(package.name)
    assert spec is not None and spec.origin is not None
    assert Path(spec.origin).resolve() == package / package.name / "__init__.py"


# -- layers --------------------------------------------------------------------------------------


def imports(source: Path) -> Iterator[str]:
    """Top-level names of the modules that a source file imports, wherever in the file."""
    for node in ast.walk(ast.parse(source.read_text(), source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module.split(".")[0]


def modules(package: Path) -> list[Path]:
    return sorted((package / package.name).rglob("*.py"))


def is_ros(module: str) -> bool:
    return module in {"rclpy", "builtin_interfaces", "launch", "launch_ros"} or module.endswith("_msgs")


def test_ros_stays_in_nodes_the_adapter_and_the_harness() -> None:
    intruders = {
        f"{source.relative_to(ROOT)}: {module}"
        for package in PYTHON_PACKAGES
        if package.name not in {"fbn_ros", "fbn_testing"}
        for source in modules(package)
        if source.name != "node.py"
        for module in imports(source)
        if is_ros(module)
    }
    assert not intruders


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_of_an_estimator_only_the_node_uses_the_adapter(name: str) -> None:
    users = {source.name for source in modules(ROOT / "src" / name) if "fbn_ros" in imports(source)}
    assert users <= {"node.py"}


def test_common_depends_on_no_other_package() -> None:
    used = {module for source in modules(ROOT / "src/fbn_common") for module in imports(source)}
    assert {module for module in used if module.startswith("fbn_")} <= {"fbn_common"}


@pytest.mark.parametrize("name", sorted(ESTIMATORS | {"fbn_sim"}))
def test_estimators_and_simulator_do_not_know_one_another(name: str) -> None:
    used = {module for source in modules(ROOT / "src" / name) for module in imports(source)}
    assert not used & (ESTIMATORS | {"fbn_sim"}) - {name}


# -- messages ------------------------------------------------------------------------------------


def test_every_message_is_in_the_contract() -> None:
    built = {name for name in dir(fbn_msgs.msg) if isinstance(getattr(fbn_msgs.msg, name), type)}
    assert built == set(CONTRACT)


@pytest.mark.parametrize("message", CONTRACT)
def test_messages_have_the_fields_of_the_contract(message: str) -> None:
    assert set(fields_of(message)) == set(CONTRACT[message].split())


@pytest.mark.parametrize("message", FIXED_SIZES)
def test_arrays_of_known_size_are_fixed(message: str) -> None:
    assert FIXED_SIZES[message].items() <= fields_of(message).items()


@pytest.mark.parametrize("message", CONSTANTS)
def test_enumerations_have_the_numbers_of_the_contract(message: str) -> None:
    for name, number in CONSTANTS[message].items():
        assert getattr(getattr(fbn_msgs.msg, message), name) == number


@pytest.mark.parametrize("message", CONTRACT)
def test_every_field_says_what_it_is(message: str) -> None:
    text = (Path(get_package_share_directory("fbn_msgs")) / "msg" / f"{message}.msg").read_text()
    assert not [line for line in text.splitlines() if line and "#" not in line]


def own_records() -> list[type]:
    classes = [c for c in vars(records).values() if isinstance(c, type) and dataclasses.is_dataclass(c)]
    return [c for c in classes if getattr(c, "ros_type", "").startswith("fbn_msgs/")]


@pytest.mark.parametrize("record", own_records(), ids=lambda record: record.__name__)
def test_records_are_the_images_of_their_messages(record: type) -> None:
    names = {field.name for field in dataclasses.fields(record)}
    header = {"header"} if "stamp_ns" in names else set()
    expected = {name.removesuffix("_ns") for name in names - {"stamp_ns", "frame_id"}} | header
    assert set(fields_of(record.ros_type.rsplit("/", 1)[1])) == expected  # type: ignore[attr-defined]


# -- environment ---------------------------------------------------------------------------------


def test_the_environment_needs_nothing_from_the_shell_and_no_directory(tmp_path: Path) -> None:
    command = [str(ROOT / "tools/run"), "python", "-c", "import rclpy, fbn_common, fbn_msgs.msg, gtsam"]
    bare = {"HOME": str(tmp_path), "PATH": os.defpath}
    subprocess.run(command, check=True, cwd=tmp_path, env=bare)


def test_a_clone_that_is_not_set_up_says_what_to_do(tmp_path: Path) -> None:
    for name in ("fbn", "tools/run"):
        copy = tmp_path / name
        copy.parent.mkdir(exist_ok=True)
        copy.write_text((ROOT / name).read_text())
        copy.chmod(0o755)
    answer = subprocess.run([tmp_path / "fbn"], capture_output=True, text=True)
    assert answer.returncode == 1
    assert f"make -C {tmp_path} setup" in answer.stderr


@pytest.fixture
def prepare() -> ModuleType:
    spec = importlib.util.spec_from_file_location("prepare", ROOT / "tools" / "prepare.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_python_that_will_not_do_is_refused_with_the_reason(
    prepare: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = tmp_path / "python3"
    old.write_text("#!/bin/sh\necho 'is Python 3.9' >&2\nexit 1\n")
    old.chmod(0o755)
    monkeypatch.setenv("FBN_PYTHON", str(old))
    with pytest.raises(prepare.SetupError, match=r"needs Python 3\.11 or 3\.12, but .* is Python 3\.9"):
        prepare.find_python("")


def test_a_virtual_environment_is_built_on_the_python_beneath(prepare: ModuleType) -> None:
    found = Path(prepare.find_python("")).resolve()
    assert found.exists() and prepare.VENV not in found.parents


def test_only_what_a_build_depends_on_asks_for_a_new_one(prepare: ModuleType, tmp_path: Path) -> None:
    def write(name: str, text: str) -> None:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)

    write("package.xml", "<package/>")
    write("config/ranger.yaml", "a: 1")
    first = prepare.fingerprint(tmp_path)
    write("fbn_x/filter.py", "pass")
    write("config/ranger.yaml", "a: 2")
    assert prepare.fingerprint(tmp_path) == first
    write("config/remus100.yaml", "a: 1")
    second = prepare.fingerprint(tmp_path)
    write("msg/X.msg", "int32 x")
    assert len({first, second, prepare.fingerprint(tmp_path)}) == 3
