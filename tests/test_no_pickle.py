"""Nothing in the project can unpickle: no module for it, no loader that does it, no queue by it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("udflow", "jobs", "service", "worker", "benchmarks", "examples", "docker", "docs", "web")
MODULES = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}
BUILT_IN = {"eval", "exec", "compile", "__import__"}
# loaders that unpickle by themselves, and what must be said so that they do not
LOADERS = {"torch.load": None, "torch.save": None, "np.load": "allow_pickle"}
LOADERS |= {"numpy.load": "allow_pickle", "format.read_array": "allow_pickle", "yaml.load": None}
# RQ pickles wherever it is not told otherwise
OF_RQ = {"Queue", "rq.Queue", "Job.fetch", "send_stop_job_command"}


def offences(source: str) -> Iterator[str]:
    """Where a source could run foreign code."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        elif isinstance(node, ast.Call):
            yield from _calls(node)
            continue
        else:
            continue
        yield from (f"import {name}" for name in names if name.partition(".")[0] in MODULES)


def _calls(node: ast.Call) -> Iterator[str]:
    name = ast.unparse(node.func)
    said = {word.arg: word.value for word in node.keywords}
    if name in BUILT_IN:
        yield name
    for loader, word in LOADERS.items():
        if name == loader or name.endswith(f".{loader}"):
            value = said.get(word)
            if not (isinstance(value, ast.Constant) and value.value is False):
                yield name
    if name in OF_RQ and "serializer" not in said:
        yield f"{name} without a serializer"


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_unpickles(room: str) -> None:
    sources = [path for path in (ROOT / room).rglob("*.py") if "node_modules" not in path.parts]
    found = {
        str(path.relative_to(ROOT)): list(offences(path.read_text())) for path in sorted(sources)
    }
    assert sources
    assert {path: said for path, said in found.items() if said} == {}


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "import dill.session",
        "x = torch.load(path)",
        "x = torch.load(path, weights_only=True)",
        "x = np.load(path)",
        "x = np.load(path, allow_pickle=True)",
        "x = np.lib.format.read_array(file)",
        "eval(text)",
        "rq.Queue('q', connection=c)",
        "Job.fetch('id', connection=c)",
    ],
)
def test_the_rule_notices(source: str) -> None:
    assert list(offences(source))


def test_the_rule_allows_what_is_safe() -> None:
    assert not list(offences("x = np.load(path, allow_pickle=False)\nimport json\nre.compile('a')"))
