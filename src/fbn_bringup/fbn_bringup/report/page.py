"""The HTML page: sections, tables and the figures, all in one file that needs no network."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import plotly.graph_objects as go
import plotly.io as pio
from plotly.offline import get_plotlyjs

from fbn_bringup.report import style as st

CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "scrollZoom": True,
    "modeBarButtonsToRemove": ["lasso2d", "select2d"],
}
CSS = f"""
* {{ box-sizing: border-box }}
body {{ margin: 0; background: #f5f7fa; color: {st.INK}; font: 15px/1.5 {st.FONT} }}
main {{ max-width: 1180px; margin: 0 auto; padding: 28px 20px 60px }}
h1 {{ font-size: 26px; margin: 0 0 2px; letter-spacing: -0.01em }}
h2 {{ font-size: 19px; margin: 0 0 4px }}
p.about {{ color: #52606d; margin: 0 0 12px; max-width: 76ch }}
section {{ background: white; border: 1px solid {st.GRID}; border-radius: 10px; padding: 20px 22px; margin-top: 20px }}
nav {{ margin: 10px 0 0 }} nav a {{ color: #0b69a3; text-decoration: none; margin-right: 16px }}
.cards {{ display: flex; flex-wrap: wrap; gap: 12px; margin-top: 18px }}
.card {{ background: white; border: 1px solid {st.GRID}; border-radius: 10px; padding: 12px 18px; min-width: 150px }}
.card {{ flex: 1 }}
.card b {{ display: block; font-size: 24px; font-variant-numeric: tabular-nums }}
.card span {{ color: #52606d; font-size: 13px }}
.scroll {{ overflow-x: auto; margin: 14px 0 6px }}
table {{ border-collapse: collapse; width: 100%; font-size: 14px; font-variant-numeric: tabular-nums }}
caption {{ caption-side: bottom; text-align: left; color: #52606d; font-size: 13px; padding-top: 8px }}
th {{ text-align: right; font-weight: 600; color: #52606d; border-bottom: 2px solid {st.GRID}; padding: 6px 10px }}
td {{ text-align: right; border-bottom: 1px solid {st.GRID}; padding: 6px 10px; vertical-align: top }}
th.left, td.left {{ text-align: left }}
.good {{ color: #00714f }} .fair {{ color: #b45309 }} .bad {{ color: #c2410c; font-weight: 600 }}
details summary {{ cursor: pointer; color: #0b69a3; margin: 6px 0 }}
@media print {{ body {{ background: white }} section {{ break-inside: avoid; border: 0 }} }}
"""


@dataclass(frozen=True, slots=True)
class Cell:
    """A table's cell with a judgement: good, fair, bad, or none."""

    text: str
    judgement: str = ""


@dataclass(frozen=True, slots=True)
class Section:
    """One section: a heading, what one sees, and the parts in order (figures or HTML)."""

    anchor: str
    title: str
    about: str
    parts: Sequence[go.Figure | str]


def page(title: str, subtitle: str, cards: Iterable[tuple[str, Cell]], sections: Sequence[Section]) -> str:
    """The whole document."""
    links = "".join(f'<a href="#{s.anchor}">{_text(s.title)}</a>' for s in sections)
    tiles = "".join(_card(label, cell) for label, cell in cards)
    body = "".join(_section(s) for s in sections)
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{_text(title)}</title><style>{CSS}</style><script>{get_plotlyjs()}</script></head><body><main>"
        f"<h1>{_text(title)}</h1><p class='about'>{_text(subtitle)}</p><nav>{links}</nav>"
        f"<div class='cards'>{tiles}</div>{body}</main></body></html>"
    )


def _card(label: str, cell: Cell) -> str:
    return f"<div class='card'><b class='{cell.judgement}'>{_text(cell.text)}</b><span>{_text(label)}</span></div>"


def _section(s: Section) -> str:
    parts = "".join(part if isinstance(part, str) else _figure(part) for part in s.parts)
    return f"<section id='{s.anchor}'><h2>{_text(s.title)}</h2><p class='about'>{_text(s.about)}</p>{parts}</section>"


def _figure(figure: go.Figure) -> str:
    return str(pio.to_html(figure, config=CONFIG, include_plotlyjs=False, full_html=False))


def html_table(
    columns: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 1, caption: str = "", last_left: bool = False
) -> str:
    """A table; the first ``left`` columns are text, the rest numbers; cells are text or :class:`Cell`."""
    text = [i < left or (last_left and i == len(columns) - 1) for i in range(len(columns))]
    head = "".join(f"<th{_side(t)}>{_text(c)}</th>" for t, c in zip(text, columns, strict=True))
    body = "".join("<tr>" + "".join(map(_cell, text, row)) + "</tr>" for row in rows)
    below = f"<caption>{_text(caption)}</caption>" if caption else ""
    return f"<div class='scroll'><table>{below}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def folded(summary: str, content: str) -> str:
    """Content behind a line to click."""
    return f"<details><summary>{_text(summary)}</summary>{content}</details>"


def _cell(is_text: bool, value: Any) -> str:
    cell = value if isinstance(value, Cell) else Cell(str(value))
    classes = " ".join(c for c in ("left" if is_text else "", cell.judgement) if c)
    return f"<td class='{classes}'>{_text(cell.text)}</td>" if classes else f"<td>{_text(cell.text)}</td>"


def _side(is_text: bool) -> str:
    return " class='left'" if is_text else ""


def _text(value: str) -> str:
    return html.escape(value)
