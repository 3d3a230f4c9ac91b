"""PLY: the vertices, ascii and binary of both byte orders."""

import itertools
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from touchnet.data.readers.rows import (
    MAX_HEADER,
    Raw,
    excerpt,
    from_columns,
    numbered_lines,
    parse_table,
    pick,
    roles_of,
)

_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


class _Property(NamedTuple):
    name: str
    kind: str  # numpy type code without byte order
    count: str | None  # the type of the length, where the property is a list


class _Element(NamedTuple):
    name: str
    count: int
    properties: list[_Property]
    line: int


def parse_ply(data: bytes, name: str) -> Raw:
    form, elements, body, line = _ply_header(data, name)
    at = next((i for i, element in enumerate(elements) if element.name == "vertex"), None)
    if at is None:
        raise ValueError(f"{name}: expected an element vertex, found {_names(elements)}")
    vertex = elements[at]
    names = [p.name if p.count is None else "" for p in vertex.properties]
    roles = roles_of(names)
    if not all(role in roles for role in "xyz"):
        raise ValueError(f"{name}: expected vertex properties x, y, z, found {_names(vertex.properties)}")
    if vertex.count == 0:
        raise ValueError(f"{name}: no points in this file (element vertex 0)")
    wanted = pick(roles)
    if form == "ascii":
        return _ply_ascii(data, body, line, elements, at, roles, wanted, name)
    order = "<" if form == "binary_little_endian" else ">"
    for element in elements[:at]:
        _, body = _ply_binary(data, body, element, [], order, name)
    columns, _ = _ply_binary(data, body, vertex, [roles[role] for role in wanted], order, name)
    return from_columns(np.stack(columns, axis=1), wanted, lambda row: f"vertex {row + 1}")


def _names(parts: Sequence[_Element | _Property]) -> str:
    return excerpt(" ".join(part.name for part in parts), 120) if parts else "none"


def _ply_header(data: bytes, name: str) -> tuple[str, list[_Element], int, int]:
    """The format, the elements, and where the body begins: the byte, and the number of its first line."""
    end = re.compile(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)").search(data, 0, MAX_HEADER)
    if end is None:
        raise ValueError(f"{name}: expected a line end_header in the first {MAX_HEADER} bytes of a PLY file")
    text = data[: end.start(1)].decode("ascii", errors="replace")
    form, elements = "", []
    number = 0
    for number, line in enumerate(re.split(r"\r\n|\n|\r", text), start=1):
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info", "end_header"):
            continue
        try:
            if words[0] == "format":
                form = words[1]
            elif words[0] == "element":
                if not re.fullmatch(r"\d{1,15}", words[2]):
                    raise ValueError
                elements.append(_Element(words[1], int(words[2]), [], number))
            elif words[0] == "property" and words[1] == "list":
                length, kind, label = words[2:5]
                if _PLY_TYPES[length][0] == "f":
                    raise ValueError
                elements[-1].properties.append(_Property(label, _PLY_TYPES[kind], _PLY_TYPES[length]))
            elif words[0] == "property":
                elements[-1].properties.append(_Property(words[2], _PLY_TYPES[words[1]], None))
            else:
                raise ValueError
        except (ValueError, IndexError, KeyError):
            raise ValueError(f"{name}, line {number}: not a line of a PLY header: {excerpt(line)}") from None
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError(f"{name}: expected the format ascii or binary of either byte order, found {form or 'none'!r}")
    return form, elements, end.end(1), number + 1


def _ply_ascii(
    data: bytes,
    body: int,
    line: int,
    elements: list[_Element],
    at: int,
    roles: dict[str, int],
    wanted: list[str],
    name: str,
) -> Raw:
    lines = ((number + line - 1, text) for number, text in numbered_lines(data[body:], name) if text.strip())
    vertex = elements[at]
    for element in elements[:at]:
        if element.properties:
            _ = sum(1 for _ in itertools.islice(lines, element.count))
    if vertex.count > len(data) - body:
        raise ValueError(f"{name}: announces {vertex.count} vertices, found only {len(data) - body} bytes of them")
    properties = vertex.properties

    def without_lists(text: str) -> list[str]:
        """Scalars keep their place, a list becomes one empty field; too few words leave too few fields."""
        words, fields, position = text.split(), [], 0
        for one in properties:
            if position >= len(words):
                return fields
            if one.count is None:
                fields.append(words[position])
                position += 1
            else:
                length = words[position]
                fields.append("")
                position += 1 + (int(length) if re.fullmatch(r"\d{1,9}", length) else len(words))
        return fields + words[position:]

    table = parse_table(
        itertools.islice(lines, vertex.count),
        name,
        without_lists if any(p.count for p in properties) else str.split,
        width=len(properties),
        columns=[roles[role] for role in wanted],
        capacity=vertex.count,
        delimiter=False if any(p.count for p in properties) else None,
    )
    if len(table.values) < vertex.count:
        raise ValueError(f"{name}: announces {vertex.count} vertices, found {len(table.values)}")
    if at == len(elements) - 1:
        extra = next(lines, None)
        if extra is not None:
            raise ValueError(f"{name}, line {extra[0]}: expected {vertex.count} vertices, found more")
    return from_columns(table.values, wanted, table.where)


def _ply_binary(
    data: bytes, start: int, element: _Element, columns: Sequence[int], order: str, name: str
) -> tuple[list[np.ndarray], int]:
    """Reads the properties `columns` of one element as float64; returns them and where the element ends."""

    def layout(lengths: Sequence[int]) -> np.dtype:
        fields: list[tuple[Any, ...]] = []
        remaining = iter(lengths)
        for index, one in enumerate(element.properties):
            if one.count is not None:
                fields.append((f"n{index}", order + one.count))
                fields.append((f"p{index}", order + one.kind, (next(remaining),)))
            else:
                fields.append((f"p{index}", order + one.kind))
        return np.dtype(fields)

    def short(needed: str) -> ValueError:
        return ValueError(
            f"{name}: announces {element.count} of element {element.name} ({needed}), found {len(data) - start} bytes"
        )

    if element.count == 0 or not element.properties:
        return [], start
    lists = [index for index, one in enumerate(element.properties) if one.count is not None]
    smallest = layout([0] * len(lists)).itemsize * element.count
    if start + smallest > len(data):
        raise short(f"at least {smallest} bytes" if lists else f"{smallest} bytes")
    # Lists mostly have one length throughout (triangles); then the element is a plain table as well.
    lengths, position = [], start
    for one in element.properties:
        if one.count is not None:
            lengths.append(_ply_length(data, position, order + one.count, name, element))
            position += np.dtype(one.count).itemsize + lengths[-1] * np.dtype(one.kind).itemsize
        else:
            position += np.dtype(one.kind).itemsize
    if position > len(data):
        raise short(f"the first alone takes {position - start} bytes")
    table = layout(lengths)
    if start + table.itemsize * element.count <= len(data):
        rows = np.frombuffer(data, dtype=table, count=element.count, offset=start)
        if all((rows[f"n{index}"] == length).all() for index, length in zip(lists, lengths, strict=True)):
            return [rows[f"p{c}"].astype(np.float64) for c in columns], start + table.itemsize * element.count
    # Otherwise row by row.
    found = np.empty((len(columns), element.count))
    position = start
    for row in range(element.count):
        for index, one in enumerate(element.properties):
            size = np.dtype(one.kind).itemsize
            if one.count is not None:
                length = _ply_length(data, position, order + one.count, name, element)
                position += np.dtype(one.count).itemsize + length * size
            else:
                if index in columns and position + size <= len(data):
                    value = np.frombuffer(data, dtype=order + one.kind, count=1, offset=position)[0]
                    found[columns.index(index), row] = value
                position += size
        if position > len(data):
            raise short(f"row {row + 1} passes the end")
    return list(found), position


def _ply_length(data: bytes, position: int, kind: str, name: str, element: _Element) -> int:
    if position + np.dtype(kind).itemsize > len(data):
        raise ValueError(f"{name}: announces {element.count} of element {element.name}, found the end of the file")
    length = int(np.frombuffer(data, dtype=kind, count=1, offset=position)[0])
    if not 0 <= length <= len(data):
        raise ValueError(f"{name}: a list of element {element.name} has the length {length}")
    return length
