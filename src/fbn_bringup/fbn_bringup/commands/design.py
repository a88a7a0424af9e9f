"""``fbn design``: what a vehicle, a sonar and a sea can do together."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fbn_bringup.design.case import Case

HELP = """Say what a sonar can see of a vehicle's motion and of a target it passes, and what to change.

N1 to N8 are what each term of a target's range and bearing changes by from one ping to the next, in wavelengths
(range) or beam widths (bearing). A term above its threshold is seen from ping to ping; below, only after the time in
the last column.
"detector" is the threshold by the sonar file's range_sigma and bearing_sigma, "phase" that of a sonar which resolves a
quarter of a wavelength. Speed, turn rate and acceleration are the vehicle's own unless told.

Examples:

  fbn design  # list vehicles and sonars
  fbn design ranger --depth 5 --current 0.1
  fbn design remus100 --sonar blueview_p450_90 --depth 30 --altitude 4 --waves 1.0 6.0
  fbn design my_vehicle.yaml --sonar my_sonar.yaml --speed 1.2 --ping-rate 2 --figure design.png

docs/howto/design-a-vehicle-with-a-sonar.md explains how to read it.
"""


def design(
    vehicle: Annotated[str, typer.Argument(help="A vehicle that comes along, or a parameter file.")] = "",
    sonar: Annotated[str, typer.Option(help="A sonar's name or file; default: the vehicle's own.")] = "",
    depth: Annotated[float, typer.Option(help="Of the water [m].")] = 10.0,
    altitude: Annotated[float, typer.Option(help="Of the vehicle over the bed [m].")] = 2.5,
    target_depth: Annotated[
        float | None, typer.Option(help="Below the surface [m]; default: 1 m over the bed.")
    ] = None,
    offset: Annotated[float, typer.Option(help="Of the target to the side of the way [m].")] = 3.0,
    current: Annotated[float, typer.Option(help="Speed of the water [m/s].")] = 0.1,
    waves: Annotated[tuple[float, float], typer.Option(help="Height [m] and period [s].")] = (0.2, 3.0),
    speed: Annotated[float | None, typer.Option(help="Through the water [m/s]; default: terminal speed.")] = None,
    ping_rate: Annotated[float | None, typer.Option(help="[Hz]; default: the sonar's.")] = None,
    figure: Annotated[Path | None, typer.Option(metavar="PNG", help="Draw it over speed and altitude.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    from fbn_bringup.design.case import make_case
    from fbn_bringup.shipped import config_file

    if not vehicle:
        _list()
        return
    target = depth - 1.0 if target_depth is None else target_depth
    case = make_case(
        config_file(vehicle), sonar, speed, ping_rate,
        water_depth=depth, vehicle_depth=depth - altitude, target_depth=target,
        current=current, wave_height=waves[0], wave_period=waves[1],
    )  # fmt: skip
    if figure is not None:
        from fbn_bringup.report.design_figure import draw

        draw(case, offset, figure)
    if as_json:
        typer.echo(json.dumps(_document(case, offset), indent=2))
    else:
        _print(case, offset, figure)


def _list() -> None:
    from fbn_bringup import ui
    from fbn_bringup.shipped import names
    from fbn_common.sonar_file import load_sonar, sonar_names

    table = ui.table("Sonars", "name", "what", "arrays", left=2)
    for name in sonar_names():
        model = load_sonar(name)
        table.add_row(name, model.about, str(len(model.arrays)))
    ui.out.print(table, "")
    ui.out.print("Vehicles: " + ", ".join(names()) + "; next: fbn design ranger")


def _document(case: Case, offset: float) -> dict[str, object]:
    from dataclasses import asdict

    from fbn_bringup.design.advice import advice
    from fbn_bringup.design.case import terms
    from fbn_bringup.design.passage import passage

    numbers = {t.name: {"value": t.value, "threshold": t.threshold, "after_s": _finite(t.after)} for t in terms(case)}
    seen = {k: _finite(v) for k, v in asdict(passage(case, offset)).items()}
    return {"numbers": numbers, "passage": seen, "advice": list(advice(case, offset))}


def _finite(value: float) -> float | None:
    return value if value < float("inf") else None


def _print(case: Case, offset: float, figure: Path | None) -> None:
    from fbn_bringup import ui
    from fbn_bringup.design.advice import advice
    from fbn_bringup.design.case import terms

    title = (
        f"{case.vehicle} with {case.sonar}: {case.speed:.2f} m/s, {case.ping_rate:g} Hz, "
        f"{case.vehicle_depth:.1f} m deep in {case.water_depth:.1f} m"
    )
    table = ui.table(title, "", "of", "value", "phase", "detector", "from ping to ping", "seen after", left=2)
    for t in terms(case):
        marks = ("yes" if t.coherent else "no", f"{t.threshold:.3g}", "[green]yes[/]" if t.observable else "no")
        after = f"{t.after:.2g} s" if t.after < float("inf") else "never"
        table.add_row(t.name, t.meaning, f"{t.value:.3g}", *marks, after)
    ui.out.print(table, "")
    ui.out.print("[bold]Advice[/]")
    for line in advice(case, offset):
        ui.out.print(f"- {ui.escape(line)}", soft_wrap=True)
    if figure is not None:
        ui.out.print(f"\nfigure: [bold]{figure}[/]", soft_wrap=True)
