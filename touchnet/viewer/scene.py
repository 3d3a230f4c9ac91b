"""What a page shows: contacts, meshes from growing numbers of them, suggestions for the next ones."""

from __future__ import annotations

import gzip
import json
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh

from touchnet.data.files import Points, split_strokes
from touchnet.frames import find_outliers

__all__ = ["MAX_SHOWN", "Scene", "Step", "Suggestion", "pick_counts"]

MAX_SHOWN = 100_000  # contacts on a page; of more every k-th is shown
FEWEST = 16  # contacts that a mesh is first made from


@dataclass(frozen=True)
class Suggestion:
    """A place to touch next, as `touchnet.explorer.Suggestions` have many.

    Attributes:
        position: (3,) where the finger should meet the surface.
        direction: (3,) along which it should come, of length 1.
        gain: in 0..1, the share of the surface's expected squared error that the touch is expected to remove.
        expected_error: how far the surface may lie from the position.
        clearance: how far back from the position, against the direction, the path is free.
    """

    position: np.ndarray
    direction: np.ndarray
    gain: float
    expected_error: float
    clearance: float


@dataclass(frozen=True)
class Step:
    """What is known after the first `count` contacts.

    Attributes:
        count: of contacts, at least 1.
        mesh: in the frame of the contacts; `vertex_attributes["confidence"]`, (V,) in [0, 1], colours it, and
            `metadata["tolerance"]` says within what distance. `None`: there is none, and `notes` say why.
        suggestions: best first.
        notes: lines to show beside the mesh, such as warnings.
    """

    count: int
    mesh: trimesh.Trimesh | None
    suggestions: Sequence[Suggestion] = ()
    notes: Sequence[str] = ()


@dataclass
class Scene:
    """All that a page shows.

    On the page coordinates are relative to the middle of the contacts and in units of the longest side of their box
    (outliers apart), so that a graphics card's float32 is enough anywhere.

    Attributes:
        contacts: as `read_points` gives them.
        title: the heading.
        up: the axis that points up at first.
        steps: in order of `count`; at least one.
        mesh_name: of a mesh that was given and not made from the contacts.
        live: the page may ask its server for more steps.
        ahead: the counts of steps that a live page asks for by itself.
    """

    contacts: Points
    title: str
    up: str = "y"
    steps: list[Step] = field(default_factory=list)
    mesh_name: str | None = None
    live: bool = False
    ahead: Sequence[int] = ()

    def __post_init__(self) -> None:
        points = self.contacts.points
        self.outliers = find_outliers(points)
        inliers = points[~self.outliers]
        low, high = inliers.min(axis=0), inliers.max(axis=0)
        self.centre = low / 2 + high / 2
        self.side = float((high - low).max()) or 1.0
        self.strokes = self.contacts.strokes
        if self.strokes is None:
            self.strokes = split_strokes(points)

    def pack_contacts(self) -> bytes:
        """The contacts and what is said of the whole scene, for the page (`pack`)."""
        points, normals = self.contacts.points, self.contacts.normals
        every = -(-len(points) // MAX_SHOWN)
        # In the order of their first contact, whatever their numbers are.
        numbers, first, of_contact = np.unique(self.strokes, return_index=True, return_inverse=True)
        order = np.argsort(first)
        place = np.argsort(order)[of_contact.reshape(-1)]
        shown = slice(None, None, every)
        arrays = {
            "position": self._scene(points[shown]).T.astype("<f4"),
            "stroke": place[shown].astype("<u4"),
            "outlier": self.outliers[shown].astype("u1"),
        }
        if normals is not None:
            arrays["normal"] = np.round(normals[shown].T * 127).astype("<i1")
        head = {
            "title": self.title,
            "count": len(points),
            "every": every,
            "dropped": self.contacts.dropped,
            "outliers": int(self.outliers.sum()),
            "strokes": numbers[order].tolist(),
            "guessed": self.contacts.strokes is None,
            "centre": self.centre.tolist(),
            "side": self.side,
            "up": self.up,
            "mesh": self.mesh_name,
            "live": self.live,
            "ahead": list(self.ahead),
        }
        return pack(head, arrays)

    def pack_step(self, step: Step) -> bytes:
        """A step for the page (`pack`): positions in 65536 steps of the mesh's box, confidence in 256."""
        mesh = step.mesh
        head: dict[str, Any] = {
            "count": step.count,
            "notes": list(step.notes),
            "suggestions": [
                {
                    "position": np.asarray(s.position, dtype=np.float64).tolist(),
                    "direction": np.asarray(s.direction, dtype=np.float64).tolist(),
                    "gain": float(s.gain),
                    "expected_error": float(s.expected_error),
                    "clearance": float(s.clearance),
                }
                for s in step.suggestions
            ],
        }
        if mesh is None:
            return pack(head, {})
        vertices = self._scene(mesh.vertices)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = np.where(high > low, high - low, 1.0)
        arrays = {
            "vertex": np.round((vertices - low) / size * 65535).T.astype("<u2"),
            "face": np.asarray(mesh.faces).reshape(1, -1).astype("<u4"),
        }
        confidence = confidence_of(mesh)
        if confidence is not None:
            arrays["confidence"] = np.round(confidence * 255).reshape(1, -1).astype("u1")
            head["tolerance"] = mesh.metadata.get("tolerance")
        head |= {
            "low": low.tolist(),
            "size": size.tolist(),
            "vertices": len(vertices),
            "faces": len(mesh.faces),
            "closed": bool(mesh.is_watertight),
            "volume": float(mesh.volume) if mesh.is_watertight else None,
            "smooth": self.mesh_name is None,
        }
        return pack(head, arrays)

    def _scene(self, points: np.ndarray) -> np.ndarray:
        return (np.asarray(points, dtype=np.float64) - self.centre) / self.side


def confidence_of(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """The confidence (V,) in [0, 1] at the vertices of a mesh, where it says one; what is not finite counts as 0."""
    values = mesh.vertex_attributes.get("confidence")
    if values is None:
        return None
    values = np.asarray(values, dtype=np.float64).reshape(-1)
    if len(values) != len(mesh.vertices):
        warnings.warn(
            f"the mesh has {len(values)} values of confidence for {len(mesh.vertices)} vertices: they are not shown",
            stacklevel=2,
        )
        return None
    return np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0)


def pick_counts(total: int, steps: int) -> list[int]:
    """Numbers of contacts to make meshes from: `total` and its halves, at most `steps` and none below 16.

    Returns:
        Growing; the last is `total`.
    """
    counts = [total]
    while len(counts) < steps and counts[-1] // 2 >= FEWEST:
        counts.append(counts[-1] // 2)
    return counts[::-1]


def pack(head: dict[str, Any], arrays: dict[str, np.ndarray]) -> bytes:
    """Numbers and arrays for the page, gzipped; scene.js reads them.

    uint32 length of the head | the head as JSON | the arrays one after the other, everything little-endian. Of arrays
    of whole numbers neighbours along the last axis are subtracted (modulo the type's range), and of all arrays first
    the lowest bytes of the elements are stored, then the next ones: gzip then finds twice as much to save.
    """
    described, blocks = [], []
    for name, array in arrays.items():
        whole = array.dtype.kind == "u"
        described.append([name, array.dtype.str.lstrip("<|"), list(array.shape)])
        if whole:
            array = np.diff(array, axis=-1, prepend=array.dtype.type(0))
        planes = np.ascontiguousarray(array).reshape(-1).view("u1").reshape(-1, array.dtype.itemsize).T
        blocks.append(planes.tobytes())
    text = json.dumps(head | {"arrays": described}, allow_nan=False).encode()
    return gzip.compress(b"".join([struct.pack("<I", len(text)), text, *blocks]), compresslevel=6, mtime=0)
