"""Every command's happy path, and what it says and returns when it cannot do its job."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import pytest
import yaml

from fbn_bringup import pages
from fbn_bringup.campaign import Plan, Row, run_seed, spread, spreads
from fbn_bringup.commands.replay import clear
from fbn_bringup.simulation import project_root
from fbn_common.graph import GRAPH


def test_help_names_every_command_and_teaches_by_example(fbn):
    status, out, _ = fbn("--help")
    assert status == 0
    for command in (
        "run",
        "replay",
        "sim",
        "evaluate",
        "report",
        "check",
        "params",
        "demo",
        "campaign",
        "design",
        "docs",
        "import",
    ):
        assert command in out
        if command != "import":
            text = fbn(command, "--help")[1]
            assert "Examples" in text and f"fbn {command}" in text


def test_help_loads_no_heavy_library():
    heavy = "{'numpy', 'scipy', 'gtsam', 'numba', 'plotly', 'matplotlib', 'rclpy', 'rosbags'}"
    code = f"import fbn_bringup.cli, sys; print(sorted({heavy} & set(sys.modules)))"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
    )


def test_evaluate_prints_the_dives_and_writes_json(fbn, story_bag):
    status, out, _ = fbn("evaluate", story_bag)
    assert status == 0 and "3 of 3" in out
    numbers = json.loads((story_bag / "evaluation.json").read_text())
    assert numbers["on_map_median"] == pytest.approx(0.5, abs=1e-6)
    assert numbers["matched"] == 3 and numbers["false_matches"] == 0


def test_evaluate_without_truth_still_says_what_it_can(fbn, story_bag, tmp_path):
    bag = tmp_path / "bag"
    shutil.copytree(story_bag, bag)
    (bag / "truth.yaml").unlink()
    status, out, _ = fbn("evaluate", bag, "--json")
    assert status == 0 and json.loads(out)["on_map_median"] is None


@pytest.mark.parametrize("command", ["evaluate", "report", "check", "replay"])
def test_a_bag_that_is_not_there_is_named(fbn, command, tmp_path):
    status, _, err = fbn(command, tmp_path / "nowhere")
    assert status == 1 and "nowhere" in err and "Traceback" not in err


def test_a_broken_truth_file_is_named_with_the_reason(fbn, story_bag, tmp_path):
    bad = tmp_path / "truth.yaml"
    bad.write_text("datum: {latitude: 1, longitude: 2}\nfeatures: [{id: 1, position: [1, 2]}]")
    status, _, err = fbn("evaluate", story_bag, "--truth", bad)
    assert status == 1 and "three finite numbers" in err


def test_a_log_without_estimates_is_refused_with_the_remedy(fbn, short_bag):
    status, _, err = fbn("evaluate", short_bag)
    assert status == 1 and "fbn replay" in err


def test_report_is_one_file_that_needs_no_network(fbn, story_bag, tmp_path):
    status, _, _ = fbn("report", story_bag, "-o", tmp_path / "r")
    assert status == 0
    page = (tmp_path / "r" / "report.html").read_text()
    for section in ("map", "errors", "matches", "innovations", "profile", "traffic"):
        assert f"id='{section}'" in page
    assert '<script src="http' not in page and "<link" not in page
    for picture in ("track_map.png", "errors.png", "innovations.png", "matches.png"):
        assert (tmp_path / "r" / picture).stat().st_size > 5_000


def test_check_passes_a_good_log(fbn, short_bag):
    status, out, _ = fbn("check", short_bag, "--json")
    verdict = json.loads(out)
    assert status == 0 and verdict["can_navigate"] and "lbl/range" in verdict["missing"]


def test_params_lists_names_units_and_origins(fbn):
    status, out, _ = fbn("params", "tracking", "--json")
    listed = json.loads(out)["fbn_tracking"]
    assert status == 0 and all(p["unit"] and p["origin"] and p["about"] for p in listed)


def test_params_yaml_is_a_parameter_file_that_loads(fbn, tmp_path):
    text = fbn("params", "--yaml")[1]
    document = yaml.safe_load(text)
    assert set(document) == {n.name for n in GRAPH.nodes}
    file = tmp_path / "p.yaml"
    file.write_text(text)
    from fbn_bringup.configuration import load_parameters

    load_parameters(GRAPH, (file,))


def test_params_of_an_unknown_node_names_those_there_are(fbn):
    status, _, err = fbn("params", "tracker")
    assert status == 2 and "fbn_tracking" in err


def test_an_unknown_parameter_is_refused_with_the_nearest(fbn, short_bag, tmp_path):
    status, _, err = fbn("replay", short_bag, "--offline", "-o", tmp_path / "r", "--set", "global.map_fil=x")
    assert status == 1 and "map_file" in err and not (tmp_path / "r" / "run.yaml").exists()


def test_a_setting_without_a_value_is_a_usage_error(fbn, short_bag, tmp_path):
    status, _, err = fbn("replay", short_bag, "--offline", "-o", tmp_path / "r", "--set", "nonsense")
    assert status == 2 and "NODE.NAME=VALUE" in err


def test_a_broken_map_feature_is_named(fbn, short_bag, tmp_path):
    bad = tmp_path / "bad.geojson"
    document = json.loads((short_bag / "prior_map.geojson").read_text())
    document["features"][2]["geometry"]["coordinates"] = ["east", 42.0]
    bad.write_text(json.dumps(document))
    status, _, err = fbn("replay", short_bag, "--offline", "-o", tmp_path / "r", "--map", bad)
    assert status == 1 and "feature 2" in err and "bad.geojson" in err


def test_a_map_that_is_not_there_is_a_usage_error(fbn, short_bag):
    assert fbn("replay", short_bag, "--map", "/nowhere.geojson")[0] == 2


def test_offline_takes_no_rate(fbn, short_bag):
    assert fbn("replay", short_bag, "--offline", "--rate", "2")[0] == 2


def test_sim_lists_scenarios_and_refuses_unknown_ones(fbn):
    assert "charles_river_2006" in fbn("sim")[1]
    status, _, err = fbn("sim", "atlantis")
    assert status == 1 and "charles_river_2006" in err


def test_sim_writes_map_truth_and_parameters_beside_the_bag(short_bag):
    assert {"prior_map.geojson", "truth.yaml", "parameters.yaml", "metadata.yaml"} <= {
        p.name for p in short_bag.iterdir()
    }


def test_an_empty_range_of_seeds_is_a_usage_error(fbn):
    assert fbn("campaign", "charles_river_2006", "--seeds", "5:5")[0] == 2
    assert fbn("campaign", "charles_river_2006", "--seeds", "a:b")[0] == 2


def test_a_seed_that_fails_is_a_row_with_its_error():
    row = run_seed(Plan("atlantis"), 7)
    assert row.seed == 7 and "atlantis" in row.error and not row.values


def test_spreads_are_quantiles_and_the_worst_is_on_the_bad_side():
    s = spread("on_map_median_m", [1.0, 2.0, 3.0, 4.0, 5.0])
    assert (s.median, s.low, s.high, s.worst) == pytest.approx((3.0, 1.2, 4.8, 5.0))
    assert spread("dives_matched", [6.0, 5.0, 6.0]).worst == 5.0
    rows = [Row(0, {"on_map_median_m": None, "drift_median_percent": 1.0}, 1.0), Row(1, {"on_map_median_m": 2.0}, 1.0)]
    assert {x.name: x.seeds for x in spreads(rows)} == {"on_map_median_m": 1, "drift_median_percent": 1}


def test_the_generated_pages_of_the_docs_are_current():
    root = project_root()
    assert root is not None and pages.stale(root / "docs") == [], "run: fbn docs"


def test_the_demo_ends_with_a_table_and_a_report(fbn, short_bag, tmp_path, monkeypatch):
    monkeypatch.setattr("fbn_bringup.commands.demo.sample_log", lambda: short_bag)
    status, out, _ = fbn("demo", "--offline", "-o", tmp_path / "demo")
    assert status == 0
    assert "fbn_global" in out and "drift" in out and "report.html" in out
    assert (tmp_path / "demo" / "report" / "report.html").is_file()
    assert (tmp_path / "demo" / "evaluation.json").is_file()


def test_a_run_is_not_overwritten_unless_told_and_nothing_else_is_removed(fbn, short_bag, tmp_path):
    target = tmp_path / "run"
    target.mkdir()
    (target / "run.yaml").write_text("source: elsewhere")
    (target / "notes.txt").write_text("mine")
    status, _, err = fbn("replay", short_bag, "--offline", "-o", target)
    assert status == 1 and "holds a run already" in err
    clear(target)
    assert [p.name for p in target.iterdir()] == ["notes.txt"]
