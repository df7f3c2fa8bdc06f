"""`udflow evaluate`: a mesh against a reference."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from typing import TYPE_CHECKING, Any

from udflow.cli.exits import UsageError
from udflow.cli.files import opened_input, print_json
from udflow.errors import InvalidCloud

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from udflow.mesh.mesh import Mesh
    from udflow.metrics import Evaluation
    from udflow.metrics.evaluation import Distances, Measure


def run(options: argparse.Namespace) -> None:
    """Measure and print."""
    if options.protocol:
        _by_protocol(options)
        return
    if options.samples is not None and options.samples < 100:
        raise UsageError(f"--samples is {options.samples}; choose at least 100")
    if options.seeds < 3:
        raise UsageError(f"--seeds is {options.seeds}; a floor needs at least 3")
    from udflow.metrics import evaluate

    found = evaluate(
        _mesh(options.mesh),
        _mesh(options.reference),
        samples=options.samples or 100_000,
        seeds=options.seeds,
        seed=options.seed,
    )
    if options.json:
        print_json(found.to_dict())
    else:
        sys.stdout.write("".join(f"{line}\n" for line in _lines(found)))


def _by_protocol(options: argparse.Namespace) -> None:
    from udflow.metrics import evaluate_protocol

    if options.protocol == "capudf-3dscene" and options.scan is None:
        raise UsageError("capudf-3dscene crops the mesh to the input scan; add --scan")
    found = evaluate_protocol(
        _mesh(options.mesh),
        _reference(options.reference, options.protocol),
        options.protocol,
        scan=_points(options.scan) if options.scan else None,
        samples=options.samples,
        seed=options.seed,
    )
    if options.json:
        print_json(dataclasses.asdict(found))
        return
    for name, value in found.figures.items():
        sys.stdout.write(f"{name:20} {value:.6g}\n")
    sys.stdout.write(f"{found.protocol}: {found.note}\n")


def _mesh(name: str) -> Mesh:
    from udflow.mesh.load import read_mesh

    with opened_input(name) as path:
        return read_mesh(path)


def _points(name: str) -> NDArray[Any]:
    from udflow.cloud.formats import read_cloud

    with opened_input(name) as path:
        return read_cloud(path).points


def _reference(name: str, protocol: str) -> Mesh | NDArray[Any]:
    """A mesh; for capudf-srb, whose truth is a scan, points do as well."""
    try:
        return _mesh(name)
    except InvalidCloud:
        if protocol != "capudf-srb":
            raise
        return _points(name)


def _lines(found: Evaluation) -> list[str]:
    mesh, truth = found.topology, found.reference_topology
    return [
        f"lengths in 1e-3 of the reference's largest extent, {found.extent:.6g}; "
        f"{found.seeds} times {found.samples} samples",
        "",
        "exact distances            mean      95 %      99 %   maximum",
        f"mesh to reference    {_distances(found.accuracy)}",
        f"reference to mesh    {_distances(found.completeness)}",
        "",
        "sampled                   value     floor    excess    sd of value and floor",
        f"L1 Chamfer           {_measure(found.chamfer)}",
        f"F-score at 0.01      {_measure(found.f_score_010)}",
        f"F-score at 0.005     {_measure(found.f_score_005)}",
        f"normal consistency   {_measure(found.normal_consistency)}",
        "",
        "topology                   mesh reference",
        *(
            f"{name.replace('_', ' '):20} {_word(value):>10} {_word(getattr(truth, name)):>9}"
            for name, value in dataclasses.asdict(mesh).items()
        ),
        f"{'spurious boundary':20} {found.spurious_boundary_edges:>10}",
    ]


def _distances(found: Distances) -> str:
    return " ".join(f"{v:9.4f}" for v in (found.mean, found.p95, found.p99, found.maximum))


def _measure(found: Measure) -> str:
    figures = " ".join(f"{v:9.4f}" for v in (found.value, found.floor, found.excess))
    return f"{figures}    {found.value_sd:.4f} {found.floor_sd:.4f}"


def _word(value: Any) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)
