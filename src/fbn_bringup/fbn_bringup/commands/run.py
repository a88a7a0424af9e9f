"""``fbn run``: the nodes on the vehicle."""

from __future__ import annotations

from typing import Annotated

import typer

from fbn_bringup.commands import options as o

HELP = """Run the nodes on the vehicle until Ctrl-C.

Starts each node as a process, restarts one that dies, and leaves none behind. DDS stays on this host unless you open
it: see docs/howto/open-to-a-network-and-secure.md. With ROS installed, the same graph starts by
ros2 launch fbn_bringup fbn.launch.py.

Examples:

  fbn run --params ranger --map field.geojson
  fbn run --network --namespace ranger  # other hosts may listen
  fbn run --only predict,deadreck  # dead reckoning alone
"""


def run(
    params: o.Params = None,
    settings: o.Set = None,
    prior_map: o.Map = None,
    namespace: o.Namespace = "",
    only: o.Only = "",
    network: Annotated[bool, typer.Option("--network", help="Let other hosts of the subnet find the nodes.")] = False,
    sim_time: Annotated[bool, typer.Option("--sim-time", help="Time from /clock instead of the host's.")] = False,
    log_level: Annotated[str, typer.Option(metavar="LEVEL", help="debug, info, warn or error.")] = "info",
) -> None:
    from fbn_bringup.live import run_live

    code = run_live(
        o.parameter_files(params),
        namespace=namespace.strip("/"),
        overrides=o.overrides(settings, prior_map),
        only=o.nodes(only),
        network=network,
        use_sim_time=sim_time,
        log_level=log_level,
    )
    raise typer.Exit(code)
