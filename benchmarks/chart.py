"""Dot charts as SVG: text files that need no plotting library and are sharp at any size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

Series = Mapping[str, float]  # value by series name
Panel = Mapping[str, Series]  # by row name

COLOURS = ("#0f766e", "#c2410c", "#7c3aed", "#6b7280")
WIDTH, LABELS, HEAD, LINE, GAP, DOT = 430, 150, 46, 17, 14, 4.2
TICKS = (1, 2, 5)


def dot_chart(title: str, panels: Mapping[str, Panel], series: Sequence[str], columns: int) -> str:
    """An SVG of panels side by side: a line a row, a dot a series, on one logarithmic scale.

    Args:
        title: what the values are.
        panels: values > 0 by panel, row and series; others are left out.
        series: names in the order of their colours, at most four.
        columns: panels beside each other.
    """
    values = [v for panel in panels.values() for row in panel.values() for v in row.values()]
    shown = [v for v in values if 0 < v < math.inf]
    if not shown:
        raise ValueError("nothing to draw: no value is above zero")
    scale = _Scale(min(shown) / 1.15, max(shown) * 1.15)
    rows = -(-len(panels) // columns)
    tallest = max(len(panel) for panel in panels.values())
    height = HEAD + LINE * tallest + 26 + GAP
    parts = [_legend(title, series)]
    for number, (name, panel) in enumerate(panels.items()):
        x, y = (number % columns) * WIDTH, HEAD + (number // columns) * height
        parts.append(f'<g transform="translate({x},{y})">{_panel(name, panel, series, scale)}</g>')
    size = f'width="{columns * WIDTH}" height="{HEAD + rows * height}"'
    style = "font-family:system-ui,sans-serif;font-size:12px"
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} style="{style}">\n'
        f'<rect width="100%" height="100%" fill="#ffffff"/>\n{body}\n</svg>\n'
    )


class _Scale:
    """Values between two limits to pixels, logarithmically."""

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high

    def __call__(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return LABELS + share * (WIDTH - LABELS - 24)

    def ticks(self) -> list[float]:
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        found = [digit * 10.0**power for power in range(first, last + 1) for digit in TICKS]
        return [tick for tick in found if self.low <= tick <= self.high]


def _panel(name: str, panel: Panel, series: Sequence[str], scale: _Scale) -> str:
    bottom = 24 + LINE * len(panel)
    parts = [f'<text x="{LABELS}" y="14" font-weight="600">{escape(name)}</text>']
    for tick in scale.ticks():
        x = scale(tick)
        parts.append(f'<path d="M{x:.1f} 20V{bottom}" stroke="#e5e7eb"/>')
        parts.append(_text(x, bottom + 13, f"{tick:g}", "middle", "#6b7280"))
    for number, (row, found) in enumerate(panel.items()):
        y = 24 + LINE * (number + 0.5)
        parts.append(_text(LABELS - 8, y + 4, row, "end", "#111827"))
        parts.append(f'<path d="M{LABELS} {y}H{WIDTH - 20}" stroke="#f3f4f6"/>')
        parts += [
            _dot(scale(found[one]), y, colour)
            for one, colour in reversed(list(zip(series, COLOURS, strict=False)))
            if 0 < found.get(one, 0.0) < math.inf
        ]
    return "".join(parts)


def _legend(title: str, series: Sequence[str]) -> str:
    parts = [f'<text x="16" y="22" font-weight="600" font-size="14">{escape(title)}</text>']
    x = 16.0
    for name, colour in zip(series, COLOURS, strict=False):
        parts += [_dot(x + 4, 38, colour), _text(x + 13, 42, name, "start", "#111827")]
        x += 36 + 7 * len(name)
    return "".join(parts)


def _dot(x: float, y: float, colour: str) -> str:
    return f'<circle cx="{x:.1f}" cy="{y}" r="{DOT}" fill="{colour}" fill-opacity="0.85"/>'


def _text(x: float, y: float, text: str, anchor: str, colour: str) -> str:
    return f'<text x="{x:.1f}" y="{y}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'
