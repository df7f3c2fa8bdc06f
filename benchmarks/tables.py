"""Rows of a benchmark as text: every figure, a summary, and what is missed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from statistics import median
from typing import Any

from common import markdown
from conditions import CONDITIONS
from methods import CLASSICS, METHODS

Row = dict[str, Any]
Group = dict[str, Row]  # by method, of one shape in one condition
HEADER = (
    "shape", "condition", "method", "s", "cpu s", "MB", "error", "mesh→GT", "GT→mesh", "excess",
    "NC % (floor)", "F .005 (floor)", "loops (GT)", "spur.", "non-m.", "parts (GT)", "Euler (GT)",
    "tight", "of",
)  # fmt: skip
WIDTHS = (28, 11, 13, 6, 6, 5, 7, 18, 18, 6, 14, 15, 11, 5, 6, 11, 11, 5, 24)
SUMMARY = (
    "condition", "method", "shapes", "least error on", "error / udflow's", "excess",
    "NC below floor, %", "topology right on", "cpu s / udflow's", "MB",
)  # fmt: skip
BUNNY = "closed/bunny_hr"
MARKS = {"clean": 0.18, "noise-0.3": 0.85, "noise-0.5": 1.25, "points-5000": 0.95}
LEGEND = (
    "Error: half the sum of both mean exact distances, mesh→GT and GT→mesh (each: mean / 95 % / "
    "maximum); error, distances and the excess of the L1 Chamfer distance over its sampling floor "
    "are in 1e-3 of the ground truth's largest extent. NC is the normal consistency, F the F-score "
    "at 0.005, each beside what another sample of the ground truth scores. spur. are boundary "
    "edges far from true borders, non-m. non-manifold edges. Topology is right where loops, "
    "components, Euler number and watertightness are those of the ground truth and no edge is "
    "non-manifold that should not be. Seconds are those of a whole fresh process on a machine that "
    "does other things too: compare them within a row's sitting only, best as processor seconds."
)


def cells(row: Row) -> list[str]:
    """One line of the table of everything."""
    start = [row["shape"], row["condition"], row["method"], f"{row['seconds']:.1f}"]
    start += [f"{row['processor_s']:.1f}", "-" if row["peak_mb"] is None else f"{row['peak_mb']}"]
    if "failed" in row:
        blank = len(HEADER) - len(start) - 2
        return [*start, f"failed: {row['failed']}", *["-"] * blank, row.get("origin", "")]
    mesh, truth = row["topology"], row["true_topology"]
    return [
        *start,
        f"{row['error']:.3f}",
        _distances(row["accuracy"]),
        _distances(row["completeness"]),
        f"{row['excess']:.3f}",
        f"{100 * row['normals']['value']:.2f} ({100 * row['normals']['floor']:.2f})",
        f"{row['f_score']['value']:.4f} ({row['f_score']['floor']:.4f})",
        f"{mesh['boundary_loops']} ({truth['boundary_loops']})",
        f"{row['spurious']}",
        f"{mesh['nonmanifold_edges']}",
        f"{mesh['components']} ({truth['components']})",
        f"{mesh['euler_number']} ({truth['euler_number']})",
        "yes" if mesh["watertight"] else "no",
        row.get("origin", ""),
    ]


def aligned(line: Sequence[str]) -> str:
    """A line for a terminal."""
    return " ".join(f"{cell:{width}}" for cell, width in zip(line, WIDTHS, strict=True))


def everything(rows: Iterable[Row]) -> str:
    """The table of all figures."""
    return markdown(HEADER, [cells(row) for row in rows])


def grouped(rows: Iterable[Row]) -> dict[tuple[str, str], Group]:
    """Rows by (condition, shape), then by method."""
    found: dict[tuple[str, str], Group] = {}
    for row in rows:
        found.setdefault((row["condition"], row["shape"]), {})[row["method"]] = row
    return found


def error(row: Row | None) -> float:
    """The mean exact error both ways, infinite where there is no mesh."""
    return math.inf if row is None or "failed" in row else float(row["error"])


def topology_right(row: Row) -> bool:
    """Whether the mesh is made of what the ground truth is made of."""
    if "failed" in row:
        return False
    mesh, truth = row["topology"], row["true_topology"]
    same = ("boundary_loops", "components", "euler_number", "watertight")
    return (
        all(mesh[name] == truth[name] for name in same)
        and mesh["nonmanifold_edges"] <= truth["nonmanifold_edges"]
    )


def summary(rows: Iterable[Row]) -> str:
    """One line a condition and method, over the shapes for which udflow has a row."""
    groups = grouped(rows)
    lines = []
    for condition in CONDITIONS:
        here = [g for (c, _), g in groups.items() if c == condition and "udflow" in g]
        lines += [_summed(condition, m, here) for m in METHODS if any(m in g for g in here)]
    return markdown(SUMMARY, lines)


def _summed(condition: str, method: str, groups: list[Group]) -> list[str]:
    groups = [group for group in groups if method in group]
    rows = [group[method] for group in groups]
    whole = [row for row in rows if "failed" not in row]
    best = sum(
        error(row) == min(map(error, g.values())) for row, g in zip(rows, groups, strict=True)
    )
    ratios = [error(g[method]) / error(g["udflow"]) for g in groups]
    times = [
        group[method]["processor_s"] / group["udflow"]["processor_s"]
        for group in groups
        if group[method]["sitting"] == group["udflow"]["sitting"]
    ]
    below = [100 * (row["normals"]["floor"] - row["normals"]["value"]) for row in whole]
    return [
        condition,
        method,
        str(len(rows))
        if len(whole) == len(rows)
        else f"{len(rows)}, {len(rows) - len(whole)} failed",
        str(best),
        _middle([r for r in ratios if 0 < r < math.inf], 2),
        _middle([row["excess"] for row in whole], 3),
        _middle(below, 2),
        str(sum(map(topology_right, rows))),
        _middle(times, 2),
        _middle([float(row["peak_mb"]) for row in rows if row["peak_mb"] is not None], 0),
    ]


def _middle(values: Sequence[float], digits: int) -> str:
    return f"{median(values):.{digits}f}" if values else "-"


def errors(rows: Iterable[Row]) -> str:
    """Per condition the errors of all methods, a line a shape, the least in bold."""
    groups, text = grouped(rows), ""
    for condition, made in CONDITIONS.items():
        here = {shape: group for (c, shape), group in groups.items() if c == condition}
        if not here:
            continue
        lines = [[shape, *_bold(group)] for shape, group in here.items()]
        text += f"### {condition}: {made.about}\n\n{markdown(('shape', *METHODS), lines)}\n"
    return text


def _bold(group: Group) -> list[str]:
    least = min(map(error, group.values()))
    line = []
    for method in METHODS:
        if method not in group:
            line.append("")
            continue
        value = error(group[method])
        text = "failed" if value == math.inf else f"{value:.3f}"
        if "seen_error" in group[method]:
            text += f" ({group[method]['seen_error']:.3f})"
        line.append(f"**{text}**" if value == least < math.inf else text)
    return line


def misses(rows: Iterable[Row]) -> list[str]:
    """A sentence for each shape and condition on which udflow is not ahead of both classics, and
    for each mark of the bunny that it misses."""
    found = []
    for (condition, shape), group in grouped(rows).items():
        ours = group.get("udflow")
        if ours is None:
            continue
        mark = MARKS.get(condition) if shape == BUNNY else None
        if mark is not None and error(ours) > mark:
            found.append(f"{shape}, {condition}: {error(ours):.3f}, mark {mark}")
        found += [
            f"{shape}, {condition}: {error(ours):.3f}, {method} {error(group[method]):.3f}"
            for method in CLASSICS
            if method in group and error(group[method]) <= error(ours)
        ]
    return found


def _distances(found: dict[str, float]) -> str:
    return f"{found['mean']:.3f}/{found['p95']:.3f}/{found['maximum']:.2f}"
