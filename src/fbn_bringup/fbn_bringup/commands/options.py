"""Options that several commands have, and how they become what the runners take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fbn_bringup.rundir import ReplayOptions

Params = Annotated[
    list[Path] | None,
    typer.Option(
        "--params",
        "-p",
        metavar="FILE",
        help="ROS parameter file, or a vehicle that comes along (ranger); may be repeated, later ones win.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NODE.NAME=VALUE", help="One parameter over the files; may be repeated."),
]
Map = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE", help="Prior map (GeoJSON). Default: the one beside the bag, if any."),
]
Namespace = Annotated[str, typer.Option("--namespace", metavar="NAME", help="Prefix of the topics, e.g. ranger.")]
Only = Annotated[
    str,
    typer.Option(
        "--only", metavar="NODES", help="Only these nodes, e.g. tracking,global; the rest comes from the log."
    ),
]
PARAMETERS = "parameters.yaml"  # beside a bag: the vehicle's parameters


def replay_options(
    bag: Path, params: list[Path] | None, settings: list[str] | None, prior_map: Path | None, namespace: str, only: str
) -> ReplayOptions:
    """What the runners take; files beside the bag serve where none is named."""
    from fbn_bringup.rundir import ReplayOptions

    files = (*_existing(bag / PARAMETERS), *parameter_files(params))
    return ReplayOptions(
        parameter_files=files,
        overrides=overrides(settings, prior_map or map_beside(bag)),
        only=nodes(only),
        namespace=namespace.strip("/"),
    )


def parameter_files(params: list[Path] | None) -> tuple[Path, ...]:
    """Files by path, or vehicles by name."""
    from fbn_bringup.shipped import config_file

    return tuple(config_file(p) for p in params or ())


def nodes(only: str) -> tuple[str, ...]:
    """Full node names of a list like ``tracking,global``."""
    from fbn_bringup.ui import fail
    from fbn_common.graph import GRAPH

    try:
        return tuple(GRAPH.node(name.strip()).name for name in only.split(",") if name.strip())
    except KeyError as error:
        fail(f"--only: {error.args[0]}", 2)


def overrides(settings: list[str] | None, prior_map: Path | None) -> dict[str, object]:
    """``NODE.NAME=VALUE`` settings (values as in YAML) and the prior map, as overrides."""
    import yaml

    from fbn_bringup.ui import fail
    from fbn_common.prior_map import read_prior_map

    found: dict[str, object] = {}
    if prior_map is not None:
        if not prior_map.is_file():
            fail(f"{prior_map}: no such map file", 2)
        read_prior_map(prior_map)  # a broken map is told before anything is started
        found["global.map_file"] = str(prior_map.resolve())
    for setting in settings or ():
        name, equals, value = setting.partition("=")
        if not equals or "." not in name:
            fail(f"--set {setting!r}: expected NODE.NAME=VALUE; fbn params lists the names", 2)
        found[name] = yaml.safe_load(value)
    return found


def map_beside(bag: Path) -> Path | None:
    """The one GeoJSON file in a bag's directory; None when there is none, or several."""
    found = sorted(bag.glob("*.geojson")) if bag.is_dir() else []
    return found[0] if len(found) == 1 else None


def _existing(path: Path) -> tuple[Path, ...]:
    return (path,) if path.is_file() else ()
