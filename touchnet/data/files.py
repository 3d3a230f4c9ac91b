"""Point files in, meshes out. docs/formats.md describes what is read and written, for users."""

import io
import os
import stat
import struct
import sys
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import trimesh

from touchnet.data.readers import parse
from touchnet.data.readers.rows import Raw
from touchnet.data.readers.solids import stl_corners

__all__ = ["Points", "read_mesh", "read_points", "split_strokes", "write_mesh"]

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb")

# Coordinates beyond this overflow when squared; no unit of length needs them.
LARGEST = 1e100
LINES_AT_ONCE = 1 << 14


class Points(NamedTuple):
    """Contacts read from a file.

    Attributes:
        points: (N,3) float64, in the units of the file, N ≥ 1, all finite.
        normals: (N,3) float64 of length 1, or `None`; a row of zeros stands for a normal that is not known.
        strokes: (N,) int64, the number of the stroke each contact belongs to, or `None` where the file does not say.
        dropped: how many rows of the file were left out.
    """

    points: np.ndarray
    normals: np.ndarray | None
    strokes: np.ndarray | None
    dropped: int


def read_points(path: str | os.PathLike[str], *, strict: bool = False) -> Points:
    """Reads contacts from a file; the format is recognised by content first and by suffix second.

    Text (any delimiter, header, comments, extra columns), PLY, PCD, OBJ, OFF, STL, GLB, NPY and NPZ are read; of a
    mesh its vertices. Rows with a coordinate that is not finite are dropped and counted, with a warning. `"-"` reads
    standard input.

    Args:
        path: the file.
        strict: raise ValueError where rows would be dropped, normals ignored or columns guessed.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: one line that names the file, the place in it, what was expected and what came.
        OSError: the file cannot be read.
    """
    name, suffix, data = _load(path)
    if not data:
        raise ValueError(f"{name}: no points in an empty file")
    # NaN of any kind may stand in a file; it is judged below.
    with np.errstate(invalid="ignore"):
        raw = parse(data, suffix, name, strict)
    return _judge(raw, name, strict)


def _load(path: str | os.PathLike[str]) -> tuple[str, str, bytes]:
    if os.fspath(path) == "-":
        return "<stdin>", "", sys.stdin.buffer.read()
    path = Path(path)
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(f"{path} is a folder, expected a file of points")
    # A device such as /dev/zero never ends; a pipe, as in `reconstruct <(convert scan)`, does.
    if not (stat.S_ISREG(mode) or stat.S_ISFIFO(mode)):
        raise ValueError(f"{path}: expected a regular file or a pipe, found a device or socket")
    return str(path), path.suffix.lower(), path.read_bytes()


def _judge(raw: Raw, name: str, strict: bool) -> Points:
    """Drops rows that are not finite, brings normals to length 1, and says what it did."""
    points, normals, strokes = raw.points, raw.normals, raw.strokes
    total = len(points) + raw.incomplete
    with np.errstate(invalid="ignore"):
        keep = (np.abs(points) <= LARGEST).all(axis=1)
    if not len(points):
        raise ValueError(f"{name}: no points in this file")
    dropped = raw.incomplete + int((~keep).sum())
    if not keep.any():
        raise ValueError(f"{name}: no finite points: each of the {total} rows has a coordinate that is not a number")
    if dropped > raw.incomplete:
        first = raw.where(int(np.argmin(keep)))
        what = (
            f"{dropped - raw.incomplete} of {total} rows with a coordinate that is not a finite number (first: {first})"
        )
        if strict:
            raise ValueError(f"{name}: expected finite coordinates, found {what}")
        warnings.warn(f"{name}: dropped {what}", stacklevel=3)
        points = points[keep]
        normals = None if normals is None else normals[keep]
        strokes = None if strokes is None else strokes[keep]
    if raw.incomplete:
        if strict:
            raise ValueError(f"{name}: the last row is incomplete")
        warnings.warn(f"{name}: dropped the last row, which is incomplete", stacklevel=3)
    if normals is not None:
        normals = _unit_normals(normals, name, strict)
    if strokes is not None:
        strokes = _whole_strokes(strokes, name, strict)
    return Points(points, normals, strokes, dropped)


def _unit_normals(normals: np.ndarray, name: str, strict: bool) -> np.ndarray | None:
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        largest = np.abs(normals).max(axis=1, keepdims=True)
        known = ((largest > 0) & (largest <= LARGEST))[:, 0]
        # Scaled first: the squares of very small components would vanish.
        normals = normals / largest
        normals = normals / np.sqrt((normals**2).sum(axis=1, keepdims=True))
    missing = int((~known).sum())
    if missing:
        what = f"{missing} of {len(normals)} normals that are zero or not finite"
        if strict:
            raise ValueError(f"{name}: expected normals, found {what}")
        if 2 * missing > len(normals):
            warnings.warn(f"{name}: {what}: no normals are used", stacklevel=4)
            return None
        warnings.warn(f"{name}: {what} count as not known", stacklevel=4)
        normals[~known] = 0.0
    return normals


def _whole_strokes(strokes: np.ndarray, name: str, strict: bool) -> np.ndarray | None:
    whole = np.isfinite(strokes) & (np.abs(strokes) < 2**53)
    whole[whole] = strokes[whole] == np.round(strokes[whole])
    if whole.all():
        return strokes.astype(np.int64)
    what = f"{int((~whole).sum())} of {len(strokes)} stroke numbers that are not whole"
    if strict:
        raise ValueError(f"{name}: expected whole stroke numbers, found {what}")
    warnings.warn(f"{name}: {what}: the stroke column is not used", stacklevel=4)
    return None


def split_strokes(points: np.ndarray, *, factor: float = 3.0) -> np.ndarray:
    """Numbers the strokes of ordered contacts by their jumps: a step longer than `factor` times the median step.

    Args:
        points: (N,3) contacts in the order they were made.
        factor: what makes a jump.

    Returns:
        (N,) int64, growing from 0.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points should have shape (N, 3), got {points.shape}")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moving = steps[steps > 0]
    if not len(moving):
        return np.zeros(len(points), dtype=np.int64)
    return np.concatenate([[0], np.cumsum(steps > factor * np.median(moving))]).astype(np.int64)


def read_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """Reads a triangle mesh as it is (no merging, no clean-up; of an STL equal corners are joined).

    Further float properties of a PLY's vertices, such as "expected_error", become its `vertex_attributes`.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: one line; the file is no mesh, has no faces, or a vertex that is not finite.
    """
    name, suffix, data = _load(path)
    try:
        if suffix == ".stl":
            corners = stl_corners(data, name)
            vertices, inverse = np.unique(corners, axis=0, return_inverse=True)
            mesh = trimesh.Trimesh(vertices, inverse.reshape(-1, 3), process=False)
        else:
            mesh = trimesh.load(
                io.BytesIO(data), file_type=suffix[1:], force="mesh", process=False, skip_materials=True
            )
    except ValueError as error:
        raise ValueError(" ".join(f"{name}: {str(error).removeprefix(f'{name}: ')}".split())) from None
    except Exception as error:  # the reader is not ours and raises whatever a damaged file makes it stumble over
        raise ValueError(f"{name}: not a readable mesh ({type(error).__name__}: {error})") from None
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ValueError(f"{name}: expected a mesh, found no faces")
    if not np.isfinite(mesh.vertices).all():
        raise ValueError(
            f"{name}: expected finite vertices, found {int((~np.isfinite(mesh.vertices)).sum())} that are not"
        )
    for key, values in _ply_properties(mesh).items():
        mesh.vertex_attributes[key] = values
    return mesh


def _ply_properties(mesh: trimesh.Trimesh) -> dict[str, np.ndarray]:
    """What trimesh's reader kept of a PLY's further vertex properties of one float each."""
    data = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    if not isinstance(data, np.ndarray) or data.shape != (len(mesh.vertices),) or data.dtype.names is None:
        return {}
    usual = {"x", "y", "z", "nx", "ny", "nz"}
    return {
        name: data[name].astype(data.dtype[name].newbyteorder("="))
        for name in data.dtype.names
        if name not in usual and data.dtype[name].kind == "f" and data[name].shape == data.shape
    }


def write_mesh(
    target: str | os.PathLike[str] | BinaryIO,
    mesh: trimesh.Trimesh,
    *,
    kind: str | None = None,
    cell: float | None = None,
) -> None:
    """Writes a triangle mesh with enough digits that reading gives the same mesh.

    PLY holds float64, and the `vertex_attributes` of one float a vertex as its properties; OBJ holds shortest decimal
    numbers that read back equal; STL and GLB hold float32 and are refused where that would let vertices fall together.
    The file is not written atomically (`touchnet.outputs.atomic_output` is).

    Args:
        target: a path, or a file opened for writing bytes.
        mesh: vertices (V,3), faces (F,3).
        kind: "ply", "obj", "stl" or "glb"; by default the suffix of the path.
        cell: the side of the cells the mesh was extracted from, if it was; its closest vertices then lie about a
            thousandth of that apart. By default `mesh.metadata["cell"]`; without one the vertices are compared.

    Raises:
        ValueError: another format, or float32 is too coarse.
    """
    if kind is None:
        if not isinstance(target, str | os.PathLike):
            raise ValueError(
                f"kind should be one of {', '.join(s[1:] for s in MESH_SUFFIXES)} with an open file, got None"
            )
        kind = Path(target).suffix[1:]
    kind = kind.lower()
    if f".{kind}" not in MESH_SUFFIXES:
        shown = target if isinstance(target, str | os.PathLike) else "kind"
        raise ValueError(f"{shown}: expected a mesh format out of {' '.join(MESH_SUFFIXES)}, got {'.' + kind!r}")
    if kind in ("stl", "glb"):
        check_float32(mesh.vertices, kind=kind, cell=mesh.metadata.get("cell") if cell is None else cell)
    blocks = {"ply": _ply_blocks, "obj": _obj_blocks, "stl": _stl_blocks, "glb": _glb_blocks}[kind](mesh)
    if isinstance(target, str | os.PathLike):
        with open(target, "wb") as file:
            file.writelines(blocks)
    else:
        for block in blocks:
            target.write(block)


def check_float32(vertices: np.ndarray, *, kind: str, cell: float | None = None) -> None:
    """Raises ValueError where float32 coordinates (`kind` "stl" or "glb") would let vertices fall together.

    Args:
        vertices: (V,3), or for a first look before there is a mesh the points it will lie among.
        kind: the format, for the message.
        cell: the side of the cells the mesh is extracted from; without it the vertices themselves are compared.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    largest = float(np.abs(vertices).max(initial=0.0))
    advice = f"move the object to the origin or write .ply or .obj instead of .{kind}"
    if largest > np.finfo(np.float32).max:
        raise ValueError(f"{kind.upper()} holds float32, which ends before the coordinate {largest:g}: {advice}")
    step = float(np.spacing(np.float32(largest)))
    if cell is not None:
        # Extraction keeps vertices of one cell 1e-3 of its side apart; eight float32 steps keep their triangles alive.
        if 1e-3 * cell < 8 * step:
            raise ValueError(
                f"{kind.upper()} holds float32, {step:.3g} apart at the coordinate {largest:g}, too coarse for cells "
                f"of {cell:.3g}: {advice}"
            )
    elif len(np.unique(vertices.astype(np.float32), axis=0)) < len(np.unique(vertices, axis=0)):
        raise ValueError(f"{kind.upper()} holds float32, in which vertices fall together (at {largest:g}): {advice}")


def _ply_blocks(mesh: trimesh.Trimesh) -> Iterable[bytes]:
    attributes = _real_attributes(mesh)
    fields = [(name, "<f8") for name in "xyz"] + [(name, values.dtype.str) for name, values in attributes.items()]
    vertices = np.empty(len(mesh.vertices), dtype=fields)
    for axis, name in enumerate("xyz"):
        vertices[name] = mesh.vertices[:, axis]
    for name, values in attributes.items():
        vertices[name] = values
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = mesh.faces
    properties = "".join(f"property {'double' if kind == '<f8' else 'float'} {name}\n" for name, kind in fields)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment touchnet\n"
        f"element vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return [header.encode(), vertices.tobytes(), faces.tobytes()]


def _real_attributes(mesh: trimesh.Trimesh) -> dict[str, np.ndarray]:
    """The mesh's attributes of one float32 or float64 a vertex, by name; others have no place in our PLY."""
    found = {}
    for name, values in mesh.vertex_attributes.items():
        values = np.asarray(values)
        if values.shape == (len(mesh.vertices),) and values.dtype in (np.float32, np.float64) and name.isidentifier():
            found[name] = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return found


def _obj_blocks(mesh: trimesh.Trimesh) -> Iterable[bytes]:
    yield b"# touchnet\n"
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    for start in range(0, len(vertices), LINES_AT_ONCE):
        # repr gives the shortest number that reads back equal (at most 17 digits).
        rows = vertices[start : start + LINES_AT_ONCE].tolist()
        yield "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows).encode()
    for start in range(0, len(mesh.faces), LINES_AT_ONCE):
        rows = (np.asarray(mesh.faces[start : start + LINES_AT_ONCE]) + 1).tolist()
        yield "".join(f"f {a} {b} {c}\n" for a, b, c in rows).encode()


def _stl_blocks(mesh: trimesh.Trimesh) -> Iterable[bytes]:
    triangles = np.empty(
        len(mesh.faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    triangles["corners"] = corners
    triangles["attribute"] = 0
    return [b"touchnet".ljust(80), struct.pack("<I", len(triangles)), triangles.tobytes()]


def _glb_blocks(mesh: trimesh.Trimesh) -> Iterable[bytes]:
    # A bare mesh: metadata of ours need not be JSON.
    bare = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return [trimesh.exchange.gltf.export_glb(trimesh.Scene(bare))]
