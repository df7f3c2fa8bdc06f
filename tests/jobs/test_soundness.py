"""Stored files whose bytes have changed are noticed, and are not read all the time."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jobs.ids import new_id
from jobs.soundness import Soundness
from jobs.spec import Artifact
from jobs.store import FileStore


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Artifact, bytes]:
    store, content = FileStore(tmp_path_factory.mktemp("store")), os.urandom(3000)
    made = store.put_artifact(new_id("job"), 1, "mesh.ply", lambda path: path.write_bytes(content))
    return store.artifact_path(made), made, content


@given(place=st.integers(0, 2999), bit=st.integers(0, 7))
@settings(max_examples=50, deadline=None, derandomize=True, database=None)
def test_any_flipped_bit_is_noticed(
    stored: tuple[Path, Artifact, bytes], place: int, bit: int
) -> None:
    path, artifact, content = stored
    changed = bytearray(content)
    changed[place] ^= 1 << bit
    path.write_bytes(changed)
    assert not Soundness().is_sound(path, artifact)
    path.write_bytes(content)
    assert Soundness().is_sound(path, artifact)


def test_a_sound_file_is_trusted_for_a_while(stored: tuple[Path, Artifact, bytes]) -> None:
    path, artifact, content = stored
    path.write_bytes(content)
    trusting, strict, status = Soundness(), Soundness(trusted_s=0.0), path.stat()
    assert trusting.is_sound(path, artifact)
    assert strict.is_sound(path, artifact)
    with path.open("r+b") as file:  # as a disk that forgets: no trace but in the bytes
        file.write(bytes([content[0] ^ 1]))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert trusting.is_sound(path, artifact)
    assert not strict.is_sound(path, artifact)
