"""All commands and their options. Imports nothing heavy."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, TypeAlias

import udflow
from udflow.cli.exits import EXPLAINED
from udflow.config import MAX_RESOLUTION, PRESET_NAMES

if TYPE_CHECKING:
    from udflow.mesh.export import MeshFormat

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
PROTOCOLS = ("capudf-cars", "capudf-srb", "capudf-3dscene")
MESH_FORMATS: tuple[MeshFormat, ...] = ("ply", "glb", "obj", "stl")


def build_parser() -> argparse.ArgumentParser:
    """The parser of `udflow`."""
    parser = argparse.ArgumentParser(
        prog="udflow",
        description="Point clouds to meshes and unsigned distances. "
        "Files are told by their content; - is standard input or output.",
        epilog=EXPLAINED,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"udflow {udflow.__version__}")
    parser.add_argument(
        "--traceback", action="store_true", help="show where an unexpected error happened"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    _reconstruct(commands)
    _densify(commands)
    _query(commands)
    _evaluate(commands)
    _inspect(commands)
    _presets(commands)
    _submit(commands)
    _watch(commands)
    _fetch(commands)
    return parser


def _command(commands: Commands, name: str, help: str) -> argparse.ArgumentParser:
    return commands.add_parser(
        name,
        help=help,
        description=help[0].upper() + help[1:] + ".",
        epilog=EXPLAINED,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _reconstruct(commands: Commands) -> None:
    command = _command(commands, "reconstruct", "turn a scan into a mesh")
    _scan(command)
    command.add_argument(
        "-o", "--output", required=True, metavar="MESH", help="mesh to write: .ply .glb .obj .stl"
    )
    command.add_argument(
        "--format", choices=MESH_FORMATS, help="format of the mesh; default: its suffix, or ply"
    )
    command.add_argument(
        "--resolution",
        type=int,
        metavar="N",
        help=f"cells along the largest extent of the mesh, 16 to {MAX_RESOLUTION}",
    )
    command.add_argument("--report", metavar="JSON", help="write parameters, timings and counts")
    command.add_argument("--field", metavar="SAFETENSORS", help="write the field, for `query`")
    command.add_argument("--points", metavar="PLY", help="write the densified points")
    _run_options(command)


def _densify(commands: Commands) -> None:
    command = _command(commands, "densify", "add points to a scan along its fitted surface")
    _scan(command)
    command.add_argument("-o", "--output", required=True, metavar="PLY", help="points to write")
    command.add_argument("--target", type=int, metavar="N", help="stop at this many points")
    _run_options(command)


def _query(commands: Commands) -> None:
    command = _command(commands, "query", "unsigned distances from points to a fitted field")
    command.add_argument("field", help="written by `reconstruct --field`; or a job of a server")
    command.add_argument("points", help="query points, .npy (n, 3) or any format of a scan")
    command.add_argument("-o", "--output", required=True, metavar="NPY", help="answers to write")
    command.add_argument(
        "--gradients", action="store_true", help="unit vectors away from the surface, too"
    )
    command.add_argument("--closest", action="store_true", help="nearest surface points, too")
    _server(command)
    command.add_argument("--device", default="cpu", help="cpu (default), cuda, cuda:1, auto")
    _force(command)
    _json(command)


def _evaluate(commands: Commands) -> None:
    command = _command(commands, "evaluate", "compare a mesh with a reference")
    command.add_argument("mesh", help="mesh to judge")
    command.add_argument("--reference", required=True, help="ground truth in the same frame")
    command.add_argument("--protocol", choices=PROTOCOLS, help="figures as a published evaluator")
    command.add_argument("--scan", help="input scan, for capudf-3dscene, which crops to it")
    command.add_argument("--samples", type=int, metavar="N", help="points per surface")
    command.add_argument("--seeds", type=int, default=3, metavar="N", help="repetitions, >= 3")
    _seed(command)
    _json(command)


def _inspect(commands: Commands) -> None:
    command = _command(commands, "inspect", "say what a scan is made of")
    _scan(command)
    _json(command)


def _presets(commands: Commands) -> None:
    _json(_command(commands, "presets", "list the presets and their parameters"))


def _submit(commands: Commands) -> None:
    command = _command(commands, "submit", "send a scan to a server, which reconstructs it")
    _scan(command)
    command.add_argument("-o", "--output", metavar="MESH", help="wait, and write the mesh here")
    command.add_argument("--format", choices=MESH_FORMATS, help="of the mesh; default: its suffix")
    command.add_argument("--resolution", type=int, metavar="N", help="cells of the mesh")
    command.add_argument(
        "--estimate", action="store_true", help="say what it would take, and start nothing"
    )
    _parameters(command)
    command.add_argument("--quiet", action="store_true", help="no progress")
    _force(command)
    _server(command)
    _json(command)


def _watch(commands: Commands) -> None:
    command = _command(commands, "watch", "follow a job on a server to its end")
    command.add_argument("job", help="id that `submit` printed")
    command.add_argument("--after", metavar="EVENT", help="id of the last event seen; 0-0: all")
    command.add_argument("--quiet", action="store_true", help="only the exit code")
    _server(command)
    command.add_argument("--json", action="store_true", help="events as JSON, one a line")


def _fetch(commands: Commands) -> None:
    command = _command(commands, "fetch", "download what a job on a server has made")
    command.add_argument("job", help="id that `submit` printed")
    command.add_argument("-o", "--output", required=True, metavar="FILE", help="file to write")
    command.add_argument(
        "--what", choices=("mesh", "points", "field", "report"), default="mesh", help="which file"
    )
    command.add_argument("--format", choices=MESH_FORMATS, help="of the mesh; default: its suffix")
    _force(command)
    _server(command)


def _server(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--url", help="of the server; default: UDFLOW_URL, else this machine; key: UDFLOW_KEY"
    )


def _run_options(command: argparse.ArgumentParser) -> None:
    _parameters(command)
    command.add_argument("--device", default="cpu", help="cpu (default), cuda, cuda:1, auto")
    command.add_argument(
        "--checkpoint",
        metavar="FILE",
        help="save trained fields there while they are fitted, and go on from it if it exists",
    )
    command.add_argument("--quiet", action="store_true", help="no progress, no summary")
    _force(command)
    _json(command)


def _parameters(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--preset", default="fast", help=f"one of: {', '.join(PRESET_NAMES)} (default: fast)"
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="any parameter that `udflow presets` shows, e.g. --set densify.target_points=0; "
        "may be repeated, and wins over the other options",
    )
    _seed(command)


def _scan(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "scan", help="point cloud: PLY PCD LAS LAZ E57 XYZ CSV NPY NPZ OBJ STL ..."
    )


def _seed(command: argparse.ArgumentParser) -> None:
    command.add_argument("--seed", type=int, default=0, help="start of the random numbers")


def _force(command: argparse.ArgumentParser) -> None:
    command.add_argument("--force", action="store_true", help="overwrite outputs that exist")


def _json(command: argparse.ArgumentParser) -> None:
    command.add_argument("--json", action="store_true", help="answer in JSON on standard output")
