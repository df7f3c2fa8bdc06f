"""A fit on disk, to be gone on with: tensors as safetensors, the rest as JSON in their header."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as to_bytes
from torch import Tensor

from udflow import faults
from udflow.config import Config, to_dict
from udflow.errors import BadCheckpoint, BadField
from udflow.fields.spline import SplineField
from udflow.fields.storage import spline_from, spline_parts
from udflow.fit.kinds import Fit
from udflow.fit.neural import NeuralFitting
from udflow.fit.spline import SplineFit

FORMAT = "udflow-checkpoint"
VERSION = 2
_ALWAYS = {"samples", "generator"}
_TRAINER = {"parameters", "mean", "square", "order", "counts", "rate_scale"}
_FIELD = "field."  # how the tensors of a solved field are named

# the rounds, samples and generator of a Checkpoint
Place = tuple[tuple[dict[str, int], ...], Tensor, Tensor]

log = logging.getLogger("udflow")


def origin_of(cloud: Tensor, config: Config) -> str:
    """Fingerprint of (n, 3) points and a configuration."""
    digest = hashlib.sha256(json.dumps(to_dict(config), sort_keys=True).encode())
    digest.update(cloud.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Checkpoint:
    """Where a reconstruction stood: a round of densification was done, and of the fit to its
    points there is the trainer's state, or the solved field, or nothing yet.

    Attributes:
        origin: fingerprint of cloud and configuration; a checkpoint fits no other.
        rounds: counters of every round of densification so far.
        samples: (n, 3) the points that are fitted, unit frame.
        generator: state of the random numbers when the fit began.
        trainer: state of a trained fit, of `Trainer.state`.
        solved: a spline field that is whole.
        loss: of the fit so far; None before the first look at it.
    """

    origin: str
    rounds: tuple[dict[str, int], ...]
    samples: Tensor
    generator: Tensor
    trainer: dict[str, Tensor] | None = None
    solved: SplineField | None = None
    loss: float | None = None

    def save(self, path: Path) -> None:
        """Writes it in place of what is there; a reader sees the old file or the new one.

        Raises:
            OSError: it cannot be written; what was there is there still.
        """
        faults.hit("checkpoint.begun")
        content = self._to_bytes()
        part = path.with_name(path.name + ".part")
        try:
            with part.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            faults.hit("checkpoint.written")
            part.replace(path)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        faults.hit("checkpoint.renamed")
        _sync(path.parent)

    def _to_bytes(self) -> bytes:
        header: dict[str, Any] = {"format": FORMAT, "version": VERSION, "origin": self.origin}
        header |= {"rounds": list(self.rounds), "loss": self.loss}
        tensors = {"samples": self.samples, "generator": self.generator, **(self.trainer or {})}
        if self.solved is not None:
            parts, header["field"] = spline_parts(self.solved)
            tensors |= {_FIELD + name: tensor for name, tensor in parts.items()}
        tensors = {name: tensor.cpu().contiguous() for name, tensor in tensors.items()}
        header["sha256"] = _digest(header, tensors)
        return to_bytes(tensors, metadata={"udflow": json.dumps(header)})

    @classmethod
    def load(cls, path: Path, origin: str) -> Checkpoint:
        """Reads a checkpoint of the same cloud and configuration.

        Raises:
            BadCheckpoint: damaged, of another version, or of another cloud or configuration.
        """
        try:
            with safe_open(str(path), framework="pt") as file:
                header = json.loads((file.metadata() or {}).get("udflow", "{}"))
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except (SafetensorError, ValueError, OSError) as error:
            raise BadCheckpoint(_unreadable(path, str(error))) from error
        _check(path, header, tensors, origin)
        samples, generator = tensors.pop("samples"), tensors.pop("generator")
        solved = _solved(path, header, tensors)
        trainer = tensors if tensors and solved is None else None
        rounds, loss = tuple(header["rounds"]), header["loss"]
        return cls(origin, rounds, samples, generator, trainer, solved, loss)


class Keeper:
    """Saves a reconstruction to a file now and then, and hands back the one that was found there.
    A disk that does not take it costs the checkpoint, never the fit.

    Args:
        path: the file.
        every_s: least time between two savings of a fit under way.
        now: whether to save a fit under way whatever the time.
        origin: fingerprint of cloud and configuration.

    Raises:
        BadCheckpoint: the file is damaged, or of another origin.
    """

    def __init__(self, path: Path, every_s: float, now: Callable[[], bool], origin: str) -> None:
        self._path, self._every_s, self._now, self._origin = path, every_s, now, origin
        self._saved = time.monotonic()
        self.stored = Checkpoint.load(path, origin) if path.exists() else None

    def take_solved(self) -> SplineFit | None:
        """The stored fit, if it was solved and is the first that is asked for."""
        stored = self.stored
        if stored is None or stored.solved is None or stored.loss is None:
            return None
        self.stored = None
        return SplineFit(stored.solved, stored.loss)

    def resume(self, fitting: object) -> bool:
        """Puts a fit that has just begun where the stored one was; the first fit only. Whether
        it is there.

        Raises:
            BadCheckpoint: the stored network has another size.
        """
        stored, self.stored = self.stored, None
        if stored is None or stored.trainer is None or not isinstance(fitting, NeuralFitting):
            return stored is not None
        fitting.trainer.restore(stored.trainer)
        fitting.loss = math.inf if stored.loss is None else stored.loss
        return True

    def begun(self, fitting: object, *place: *Place) -> None:
        """Saves what a round of densification has brought, before the fit to it."""
        self._save(Checkpoint(self._origin, *place, _trainer_of(fitting)))

    def offer(self, fitting: object, *place: *Place) -> None:
        """Saves a trained fit under way, unless it was saved a moment ago."""
        due = time.monotonic() - self._saved >= self._every_s or self._now()
        if due and isinstance(fitting, NeuralFitting):
            trainer, loss = _trainer_of(fitting), _finite(fitting.loss)
            self._save(Checkpoint(self._origin, *place, trainer, loss=loss))

    def whole(self, fitting: object, fit: Fit, *place: *Place) -> None:
        """Saves a fit that is whole."""
        solved = fit.field if isinstance(fit.field, SplineField) else None
        trainer, loss = _trainer_of(fitting), _finite(fit.loss)
        self._save(Checkpoint(self._origin, *place, trainer, solved, loss))

    def _save(self, checkpoint: Checkpoint) -> None:
        self._saved = time.monotonic()
        try:
            checkpoint.save(self._path)
        except OSError as error:
            log.warning("no checkpoint can be written, the fit goes on without: %s", error)


def _trainer_of(fitting: object) -> dict[str, Tensor] | None:
    """The state of a trained fit; a solved one has none."""
    return fitting.trainer.state() if isinstance(fitting, NeuralFitting) else None


def _finite(loss: float) -> float | None:
    return loss if math.isfinite(loss) else None


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    with contextlib.suppress(OSError):  # the rename is done, only a power cut could undo it
        os.fsync(descriptor)
    os.close(descriptor)


def _digest(header: dict[str, Any], tensors: dict[str, Tensor]) -> str:
    """SHA-256 of all that a checkpoint says."""
    said = {name: value for name, value in header.items() if name != "sha256"}
    digest = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


def _solved(path: Path, header: dict[str, Any], tensors: dict[str, Tensor]) -> SplineField | None:
    if "field" not in header:
        return None
    try:
        return spline_from(header["field"], lambda name: tensors[_FIELD + name])
    except (BadField, LookupError, TypeError, ValueError, RuntimeError) as error:
        raise BadCheckpoint(_unreadable(path, str(error))) from error


def _check(path: Path, header: Any, tensors: dict[str, Tensor], origin: str) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise BadCheckpoint(_unreadable(path, "it is no checkpoint of udflow"))
    if header.get("version") != VERSION:
        raise BadCheckpoint(_unreadable(path, f"it has version {header.get('version')}"))
    if header.get("origin") != origin:
        raise BadCheckpoint(
            f"{path.name} was saved for another cloud or other parameters; give those, or name "
            "another file to start anew"
        )
    rounds, samples = header.get("rounds"), tensors.get("samples")
    parts = {name for name in tensors if not name.startswith(_FIELD)}
    if parts not in (_ALWAYS, _ALWAYS | _TRAINER) or "loss" not in header:
        raise BadCheckpoint(_unreadable(path, "it is not complete"))
    if samples is None or samples.ndim != 2 or samples.shape[1] != 3:
        raise BadCheckpoint(_unreadable(path, "it is not complete"))
    if not isinstance(rounds, list) or not all(_is_counts(counts) for counts in rounds):
        raise BadCheckpoint(_unreadable(path, "its rounds are not counted"))
    if not all(bool(torch.isfinite(t).all()) for t in tensors.values() if t.is_floating_point()):
        raise BadCheckpoint(_unreadable(path, "it holds numbers that are not finite"))
    if header.get("sha256") != _digest(header, tensors):
        raise BadCheckpoint(_unreadable(path, "its checksum is another"))


def _is_counts(counts: Any) -> bool:
    if not isinstance(counts, dict) or not all(isinstance(n, int) for n in counts.values()):
        return False
    return {"round", "points", "added"} <= set(counts) and counts["added"] >= 0


def _unreadable(path: Path, reason: str) -> str:
    return f"cannot go on from {path.name}: {reason}; remove the file to start anew"
