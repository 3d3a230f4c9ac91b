"""Mesh files as clouds: the vertices of OBJ, OFF, STL and GLB."""

import io
import itertools
import json
import re
import struct
from collections.abc import Iterator

import numpy as np
import trimesh

from touchnet.data.readers.rows import Raw, Table, check_expansion, excerpt, most_rows, numbered_lines, parse_table


def _tagged(data: bytes, tag: str, name: str) -> Iterator[tuple[int, str]]:
    """The first three words after `tag` on the lines that start with it."""
    for number, line in numbered_lines(data, name):
        words = line.split(None, 4)
        if words and words[0] == tag:
            yield number, " ".join(words[1:4])


def _three(lines: Iterator[tuple[int, str]], data: bytes, name: str) -> Table:
    return parse_table(lines, name, str.split, width=3, columns=(0, 1, 2), capacity=most_rows(data, 3))


def parse_obj(data: bytes, name: str) -> Raw:
    """The v lines; the vn lines are their normals where there is one for each and no face says otherwise."""
    table = _three(_tagged(data, "v", name), data, name)
    if not len(table.values):
        raise ValueError(f"{name}: no points in this file (no line starts with v)")
    normals = None
    if not re.search(rb"(?:^|[\r\n])[ \t]*f[ \t]", data):
        directions = _three(_tagged(data, "vn", name), data, name).values
        if len(directions) == len(table.values):
            normals = directions
    return Raw(table.values, normals, None, table.where)


def parse_off(data: bytes, name: str) -> Raw:
    lines = ((n, text) for n, text in numbered_lines(data, name) if text.strip() and not text.lstrip().startswith("#"))
    number, keyword = next(lines)
    counts = keyword.split()[1:]
    if not counts:
        number, line = next(lines, (number, ""))
        counts = line.split()
    if not 1 <= len(counts) <= 3 or not re.fullmatch(r"\d{1,15}", counts[0]):
        raise ValueError(
            f"{name}, line {number}: expected the numbers of vertices and faces, found {excerpt(' '.join(counts))}"
        )
    total = int(counts[0])
    if total == 0:
        raise ValueError(f"{name}: no points in this file (0 vertices)")
    rows = ((n, " ".join(text.split(None, 4)[:3])) for n, text in itertools.islice(lines, min(total, len(data))))
    table = _three(rows, data, name)
    if len(table.values) != total:
        raise ValueError(f"{name}: announces {total} vertices, found {len(table.values)}")
    return Raw(table.values, None, None, table.where)


def parse_stl(data: bytes, name: str) -> Raw:
    corners = stl_corners(data, name)
    # Each corner comes once per triangle; the order of first appearance is kept.
    _, first = np.unique(corners, axis=0, return_index=True)
    return Raw(corners[np.sort(first)], None, None, lambda row: f"vertex {row + 1}")


def stl_corners(data: bytes, name: str) -> np.ndarray:
    """(3 F, 3) float64, three corners a triangle."""
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    if data.lstrip()[:5].lower() == b"solid" and len(data) != 84 + 50 * count:
        table = _three(_tagged(data, "vertex", name), data, name)
        if not len(table.values):
            raise ValueError(f"{name}: no points in this file (no line starts with vertex)")
        return table.values
    if len(data) < 84 or 84 + 50 * count > len(data):
        raise ValueError(f"{name}: announces {count} triangles ({84 + 50 * count} bytes), found {len(data)} bytes")
    if count == 0:
        raise ValueError(f"{name}: no points in this file (0 triangles)")
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, dtype=kind, count=count, offset=84)["corners"].reshape(-1, 3).astype(np.float64)


def parse_glb(data: bytes, name: str) -> Raw:
    _check_glb(data, name)
    try:
        scene = trimesh.load(io.BytesIO(data), file_type="glb", process=False, skip_materials=True)
        parts = []
        for node in getattr(scene, "graph", trimesh.Scene().graph).nodes_geometry:
            matrix, key = scene.graph[node]
            parts.append(trimesh.transform_points(np.asarray(scene.geometry[key].vertices, dtype=np.float64), matrix))
    except Exception as error:  # the reader is not ours and raises whatever a damaged file makes it stumble over
        raise ValueError(f"{name}: not a readable GLB file ({type(error).__name__}: {error})") from None
    if not parts:
        raise ValueError(f"{name}: no points in this file (no mesh in the scene)")
    return Raw(np.concatenate(parts), None, None, lambda row: f"vertex {row + 1}")


def _check_glb(data: bytes, name: str) -> None:
    """Refuses scenes that are larger than their file: accessors without data, and nodes that multiply meshes."""
    try:
        _, version, _, length, kind = struct.unpack_from("<4sIII4s", data)
        if version != 2 or kind != b"JSON" or 20 + length > len(data):
            raise ValueError("expected version 2 and a JSON chunk")
        scene = json.loads(data[20 : 20 + length])
        accessors = scene.get("accessors", [])
        vertices = []
        for accessor in accessors:
            if not 0 <= accessor["count"] <= len(data) or "sparse" in accessor or "bufferView" not in accessor:
                raise ValueError("an accessor without data, or larger than the file")
        for mesh in scene.get("meshes", []):
            vertices.append(sum(accessors[p["attributes"]["POSITION"]]["count"] for p in mesh["primitives"]))
        nodes = scene.get("nodes", [])
        children = [child for node in nodes for child in node.get("children", [])]
        roots = [root for one in scene.get("scenes", []) for root in one.get("nodes", [])]
        if len(set(children)) != len(children) or set(children) & set(roots):
            raise ValueError("the nodes are not a tree")
        total = sum(vertices[node["mesh"]] for node in nodes if "mesh" in node)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, struct.error, RecursionError) as error:
        raise ValueError(f"{name}: not a readable GLB file ({error})") from None
    check_expansion(24 * total, len(data), name)
