"""The data-flow figure of the docs, an SVG made from the graph.

Nodes lie on the diagonal.  What a node publishes leaves it to the right (or, to close a loop, to the left) and enters
its taker from above (from below); the topics stand where the way turns.
"""

from __future__ import annotations

import html
from collections.abc import Iterator

from fbn_common.graph import GRAPH

CELL_W, CELL_H, MARGIN = 158, 92, 16
BOX_W, BOX_H = 124, 46
INK, MUTED, FORWARD, BACK, FILL = "#1f2933", "#52606d", "#0072b2", "#d55e00", "#e6f1f8"


def dataflow() -> str:
    """The figure as SVG text."""
    rows = [("sensors", "the vehicle, or a log")]
    rows += [(n.name, f"{1 / n.period_s:.0f} Hz") for n in GRAPH.nodes]
    size = MARGIN * 2 + CELL_W * (len(rows) + 1), MARGIN * 2 + CELL_H * len(rows)
    cells = _cells()
    parts = [_head(*size), *(_way(i, j) for i, j in cells)]
    for (i, j), topics in cells.items():
        parts += _words(i, j, topics)
    for i, (name, below) in enumerate(rows):
        parts += _box(i, name, below)
    return "\n".join([*parts, "</svg>", ""])


def _cells() -> dict[tuple[int, int], list[str]]:
    """Topics by row of the publisher and row of the taker; the column after the last is everybody else."""
    order = {n.name: i + 1 for i, n in enumerate(GRAPH.nodes)}
    cells: dict[tuple[int, int], list[str]] = {}
    for topic in GRAPH.topics:
        maker = GRAPH.publisher(topic)
        source = order[maker.name] if maker else 0
        takers = [order[n.name] for n in GRAPH.nodes if topic in (*n.inputs, *n.feedback)]
        if topic.endswith("/innovations"):
            continue
        for sink in takers or [len(order) + 1]:
            cells.setdefault((source, sink), []).append(topic)
    return cells


def _centre(i: int) -> tuple[float, float]:
    return MARGIN + CELL_W * (i + 0.5), MARGIN + CELL_H * (i + 0.5)


def _way(i: int, j: int) -> str:
    """The line from node i to node j."""
    (x0, y0), (x1, y1) = _centre(i), _centre(j)
    side = 1 if j > i else -1
    colour, tip, dash = (FORWARD, "tip", "") if j > i else (BACK, "back", ' stroke-dasharray="5 3"')
    start = f"M{x0 + side * BOX_W / 2:g} {y0:g}"
    leaves = j > len(GRAPH.nodes)
    marker = "" if leaves else f' marker-end="url(#{tip})"'
    down = "" if leaves else f" V{y1 - side * (BOX_H / 2 + 2):g}"
    pen = f'fill="none" stroke="{colour}" stroke-opacity="0.55" stroke-width="1.3"'
    return f'<path d="{start} H{x1:g}{down}" {pen}{dash}{marker}/>'


def _words(i: int, j: int, topics: list[str]) -> Iterator[str]:
    """The topics, where the way from node i to node j turns."""
    x, y = _centre(j)[0], _centre(i)[1]
    width, height = 6.1 * max(map(len, topics)) + 8, 13 * len(topics) + 4
    corner = f'x="{x - width / 2:g}" y="{y - height / 2:g}"'
    yield f'<rect {corner} width="{width:g}" height="{height:g}" rx="3" fill="white"/>'
    for k, topic in enumerate(topics):
        yield _label(x, y - 6.5 * (len(topics) - 1) + 3.5 + 13 * k, topic, 11, FORWARD if j > i else BACK)


def _box(i: int, name: str, below: str) -> Iterator[str]:
    x, y = _centre(i)
    fill, stroke = ("white", MUTED) if i == 0 else (FILL, FORWARD)
    place = f'x="{x - BOX_W / 2:g}" y="{y - BOX_H / 2:g}" width="{BOX_W}" height="{BOX_H}"'
    yield f'<rect {place} rx="8" fill="{fill}" stroke="{stroke}" stroke-width="1.3"/>'
    yield _label(x, y - 2, name, 14, INK, "bold")
    yield _label(x, y + 14, below, 11, MUTED)


def _head(width: float, height: float) -> str:
    tips = "".join(
        f'<marker id="{name}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0 L8 4 L0 8 z" fill="{colour}"/></marker>'
        for name, colour in (("tip", FORWARD), ("back", BACK))
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
        'font-family="Helvetica, Arial, sans-serif" text-anchor="middle">'
        f'<rect width="{width:g}" height="{height:g}" fill="white"/><defs>{tips}</defs>'
    )


def _label(x: float, y: float, text: str, size: int, colour: str, weight: str = "normal") -> str:
    pen = f'font-size="{size}" font-weight="{weight}" fill="{colour}"'
    return f'<text x="{x:g}" y="{y:g}" {pen}>{html.escape(text)}</text>'
