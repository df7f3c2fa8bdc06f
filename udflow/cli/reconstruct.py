"""`udflow reconstruct`: scan in, mesh out."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from udflow.cli.exits import UsageError
from udflow.cli.files import STREAM, check_outputs, print_json, write_json, write_output
from udflow.cli.fitting import check_streams, config_from, fitted, say
from udflow.cli.parser import MESH_FORMATS

if TYPE_CHECKING:
    from udflow.mesh.export import MeshFormat
    from udflow.reconstruct import Reconstruction


def run(options: argparse.Namespace) -> None:
    """Reconstruct a scan and write what was asked for."""
    outputs = (options.output, options.report, options.field, options.points)
    config = config_from(options)
    format = _mesh_format(options.output, options.format)
    check_outputs(*outputs, force=options.force)
    check_streams(options, *outputs)
    result = fitted(options, config)
    shift = _write(result, format, options)
    if options.json:
        print_json(_summary(result, shift, options))
    say(options, _lines(result, shift, options))


def _mesh_format(output: str, format: MeshFormat | None) -> MeshFormat:
    if format is not None:
        return format
    if output == STREAM:
        return "ply"
    suffix = Path(output).suffix.lstrip(".").lower()
    for known in MESH_FORMATS:
        if suffix == known:
            return known
    raise UsageError(
        f"cannot tell the format of {output}; end its name in "
        f"{', '.join('.' + known for known in MESH_FORMATS)}, or add --format"
    )


def _write(result: Reconstruction, format: MeshFormat, options: argparse.Namespace) -> list[float]:
    """Write all outputs, the mesh last; the shift of its coordinates."""
    from udflow.fields.storage import field_to_bytes
    from udflow.mesh.export import write_mesh, write_points

    force, shift = options.force, [0.0, 0.0, 0.0]
    if options.report:
        write_json(options.report, result.report, force=force)
    if options.field:
        content = field_to_bytes(result.field)
        write_output(options.field, lambda file: file.write(content), force=force)
    if options.points:
        write_output(options.points, lambda file: write_points(result.points, file), force=force)
    write_output(
        options.output,
        lambda file: shift.__setitem__(slice(None), write_mesh(result.mesh, file, format)),
        force=force,
    )
    return shift


def _summary(
    result: Reconstruction, shift: list[float], options: argparse.Namespace
) -> dict[str, Any]:
    return {
        "output": options.output,
        "vertices": len(result.mesh.vertices),
        "faces": len(result.mesh.faces),
        "shift": shift,
        "report": result.report,
    }


def _lines(result: Reconstruction, shift: list[float], options: argparse.Namespace) -> list[str]:
    report = result.report
    seconds = ", ".join(f"{name} {spent:.1f}" for name, spent in report["seconds"].items())
    points = report["points"]
    lines = [
        f"{options.output}: {len(result.mesh.vertices)} vertices, {len(result.mesh.faces)} faces"
        + (", with colours" if result.mesh.colors is not None else ""),
        f"points   {points['input']} read, {points['unique']} distinct, "
        f"{points['densified']} after {points['rounds']} rounds of densification",
        f"spacing  {report['spacing']:.4g}, sample error {report['sample_error']:.4g} "
        "(units of the scan)",
        f"seconds  {seconds}",
    ]
    if any(shift):
        lines.append(f"shift    add {shift} to the coordinates of this file")
    return lines + [f"warning  {text}" for text in report["warnings"]]
