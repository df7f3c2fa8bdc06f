"""Which lattice edges the surface crosses: one flag per edge, decided once.

With an unsigned normal n and a signed height s = d·n at every vertex, the edge ab is crossed where
s_a s_b sign(n_a·n_b) < 0. Around a lattice face the signs of the heights cancel, so the number of
crossed edges is even wherever the normals agree, and the surface closes by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from udflow.fields.interface import ProjectiveField
from udflow.mesh.band import Band, Patch, project_in_chunks, widened
from udflow.mesh.normals import band_normals
from udflow.mesh.parity import Decoder, odd_faces, settled

# Vertices around a doubtful flag that are added to the band, and how far from the surface they
# may lie, in voxels: normals there are averaged over more and longer displacements.
DOUBT_REACH = 3
DOUBT_WIDTH = 2.0
SHEET_GAP = 0.5  # voxels between the feet of an edge's ends, beyond what their heights explain
BENT = 0.5  # cosine between normals below which their signs are compared in vain
NEVER = 30.0  # evidence against a crossing where an edge leaves the band
SLOPE, CAP = 6.0, 6.0
QUESTIONS = 3  # rounds of asking the field about the flags that decoding would change


@dataclass(frozen=True)
class Crossings:
    """Crossed lattice edges.

    Attributes:
        keys: (e,) int64 lattice vertex at the lower end of each crossed edge.
        axis: (e,) int64 direction of the edge.
        where: (e,) float32 position of the crossing along the edge, 0..1.
    """

    keys: Tensor
    axis: Tensor
    where: Tensor


@dataclass(frozen=True)
class _Flags:
    """Edges along x, y, z from each vertex of a band.

    Attributes:
        evidence: (n, 3) float32, log-likelihood ratio of "not crossed" against "crossed".
        bent: (n, 3) bool, edges between whose ends the normal turns too far to be followed.
        doubtful: (n,) bool, vertices whose flags contradict each other or the feet.
        height: (n,) float32 signed heights of the vertices, each in its own frame.
    """

    evidence: Tensor
    bent: Tensor
    doubtful: Tensor
    height: Tensor


def find_crossings(field: ProjectiveField, band: Band) -> Crossings:
    """The lattice edges that the surface crosses.

    Args:
        field: asked again near contradictions, where the band is widened.
        band: the vertices near the surface.
    """
    flags = _flags(band)
    crossed = flags.evidence < 0
    if not bool(flags.doubtful.any()):
        return _listed(band, flags.height, crossed)
    doubtful = band.keys[flags.doubtful]
    patch = widened(field, band, doubtful, DOUBT_REACH, DOUBT_WIDTH)
    renewed = _with_surroundings(_flags(patch.band), flags, patch)
    inside = torch.zeros_like(flags.doubtful)
    inside[patch.source[patch.inner & (patch.source >= 0)]] = True
    outer = _listed(band, flags.height, crossed & ~_between(inside, band.ahead))
    decided = _consistent(field, patch.band, renewed) & _between(patch.inner, patch.band.ahead)
    inner = _listed(patch.band, renewed.height, decided)
    return Crossings(
        torch.cat([outer.keys, inner.keys]),
        torch.cat([outer.axis, inner.axis]),
        torch.cat([outer.where, inner.where]),
    )


def _between(chosen: Tensor, ahead: Tensor) -> Tensor:
    """(n, 3) edges with both ends among the chosen vertices."""
    padded = torch.cat([chosen, chosen.new_zeros(1)])
    return chosen[:, None] & padded[ahead]


def _with_surroundings(renewed: _Flags, whole: _Flags, patch: Patch) -> _Flags:
    """Flags of a patch, with those of the whole band, as certain, where the patch ends."""
    outside = ~_between(patch.inner, patch.band.ahead) & (patch.source >= 0)[:, None]
    certain = torch.where(whole.evidence < 0, -NEVER, NEVER)
    return _Flags(
        torch.where(outside, certain[patch.source], renewed.evidence),
        renewed.bent & ~outside,
        renewed.doubtful,
        renewed.height,
    )


def _listed(band: Band, height: Tensor, crossed: Tensor) -> Crossings:
    vertex, axis = crossed.nonzero().unbind(1)
    return Crossings(band.keys[vertex], axis, _where(band, height, vertex, axis))


def _flags(band: Band) -> _Flags:
    normals = band_normals(band)
    displacement = band.lattice.positions(band.keys) - band.feet
    height = (displacement * normals).sum(dim=1)
    columns = [_evidence_along(band, axis, height, normals) for axis in range(3)]
    evidence, torn, bent = (torch.stack(column, dim=1) for column in zip(*columns, strict=True))
    doubtful = (torn | odd_faces(evidence < 0, band.ahead)).any(dim=1)
    return _Flags(evidence, bent, doubtful, height)


def _evidence_along(band: Band, axis: int, height: Tensor, normals: Tensor) -> tuple[Tensor, ...]:
    """(n,) evidence against a crossing, (n,) torn: the feet of the two ends lie on different
    sheets, and (n,) bent: the normals of the two ends hardly agree.

    Between close layers and inside sharp creases the heights change sign without a surface. There
    the feet of the two ends lie farther apart, along the normal, than their heights explain.
    """
    step = band.lattice.step
    near = (band.ahead[:, axis] >= 0).nonzero()[:, 0]
    far = band.ahead[near, axis]
    normal = normals[near]
    agreement = (normal * normals[far]).sum(dim=1)
    crossed = (height[near] < 0) ^ (height[far] < 0) ^ (agreement < 0)

    one, two = height[near].abs() / step, height[far].abs() / step
    apart = ((band.feet[far] - band.feet[near]) * normal).sum(dim=1).abs() / step
    gap = apart - 0.25 * (one + two) - SHEET_GAP
    torn = crossed & (gap > 0)
    trusted = torch.minimum(4 * agreement.square() + 0.05, 8 * torch.minimum(one, two) + 0.1)
    evidence = torch.where(crossed, -trusted, trusted)
    evidence = torch.where(torn, (4 * gap).clamp_max(3.0), evidence)
    absent = torch.full_like(band.feet[:, 0], NEVER)
    nowhere = torch.zeros_like(band.keys, dtype=torch.bool)
    return tuple(
        start.index_copy(0, near, values)
        for start, values in (
            (absent, evidence),
            (nowhere, torn),
            (nowhere, agreement.abs() < BENT),
        )
    )


def _consistent(field: ProjectiveField, band: Band, flags: _Flags) -> Tensor:
    """(n, 3) flags whose faces are even, except where the field itself speaks against it.

    Crossings between bent normals, and what decoding would change, are held against the field at
    the place of the crossing.
    """
    evidence = flags.evidence.clone()
    asked = torch.zeros_like(flags.bent)
    question = flags.bent & (evidence < 0)
    decoder: Decoder | None = None
    for _ in range(QUESTIONS):
        vertex, axis = question.nonzero().unbind(1)
        if decoder is not None and vertex.numel() == 0:
            break
        evidence[vertex, axis] += _field_evidence(field, band, flags.height, vertex, axis)
        asked |= question
        decoder = decoder or Decoder(band.keys, band.ahead, evidence)
        crossed = decoder.flags(evidence)
        question = (crossed != (flags.evidence < 0)) & ~asked
    return settled(band.keys, band.ahead, evidence < 0, crossed)


def _field_evidence(
    field: ProjectiveField, band: Band, height: Tensor, vertex: Tensor, axis: Tensor
) -> Tensor:
    """(e,) evidence against crossings from the distance at the place of the crossing.

    It is zero there if the edge is crossed; else, with both ends on one side, it is the harmonic
    mean of their distances.
    """
    far = band.ahead[vertex, axis]
    start, end = band.lattice.positions(band.keys[vertex]), band.lattice.positions(band.keys[far])
    where = _where(band, height, vertex, axis)
    points = start + where[:, None] * (end - start)
    distance = torch.linalg.vector_norm(points - project_in_chunks(field, points), dim=1)
    expected = 2 * (1 - where) * height[vertex].abs()  # the harmonic mean, by the choice of where
    excess = (distance - 0.5 * expected) / band.lattice.step
    return torch.where(excess < 0, 6 * excess, SLOPE * excess).clamp(-3.0, CAP)


def _where(band: Band, height: Tensor, vertex: Tensor, axis: Tensor) -> Tensor:
    near, far = height[vertex].abs(), height[band.ahead[vertex, axis]].abs()
    return near / (near + far).clamp_min(1e-12)
