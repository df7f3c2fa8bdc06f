"""What the command line says of itself: help, versions, presets, wrong usage."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import udflow
from udflow.cli import main
from udflow.cli.parser import MESH_FORMATS, PROTOCOLS
from udflow.config import Config, preset, to_dict
from udflow.mesh import export
from udflow.metrics import protocols


def test_help_loads_nothing_heavy_and_states_the_exit_codes() -> None:
    code = (
        "import sys; from udflow.cli import main; main(['--help']);"
        "heavy = {'torch', 'scipy', 'numpy', 'rich', 'trimesh'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    for line in ("exit codes:", "  130  interrupted", "reconstruct", "evaluate"):
        assert line in done.stdout


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"udflow {udflow.__version__}\n"


def test_names_known_without_heavy_imports_are_the_real_ones() -> None:
    assert MESH_FORMATS == export.MESH_FORMATS
    assert PROTOCOLS == protocols.PROTOCOLS


def test_presets_in_json_are_what_a_request_may_say(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["presets", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fast"] == to_dict(preset("fast"))


def test_presets_for_people_can_be_given_back_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["presets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"  densify.threshold={Config().densify.threshold}" in lines
    assert "  spline.resolution=null" in lines


@pytest.mark.parametrize(
    "arguments",
    [[], ["reconstruct"], ["reconstruct", "a.ply"], ["melt", "a.ply"], ["inspect", "a", "--loud"]],
)
def test_a_wrong_command_line_is_usage(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert "usage: udflow" in capsys.readouterr().err
