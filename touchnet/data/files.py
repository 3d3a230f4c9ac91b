"""Point files in, meshes out. docs/formats.md describes what is read and written, for users.

Everything here parses bytes that nobody vouches for. So sizes that a header announces are compared with the size of the
file before anything is allocated, nothing is unpickled or evaluated, and no parser depends on the locale.
"""

import ast
import io
import itertools
import json
import math
import os
import re
import stat
import struct
import sys
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import trimesh

__all__ = ["Points", "read_mesh", "read_points", "split_strokes", "write_mesh"]

POINT_SUFFIXES = (
    ".xyz .txt .csv .tsv .pts .asc .dat .xyzn .xyzrgb".split() + ".ply .pcd .npy .npz .obj .off .stl .glb".split()
)
MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb")

# Coordinates beyond this overflow when squared; no unit of length needs them.
LARGEST = 1e100
# Compressed files may expand to ten times their size, small ones to this much.
EXPANDED = 1 << 26
MAX_HEADER = 1 << 20
CHUNK_LINES = 1 << 12

COMMENTS = ("#", "//", "%", "!")
# What programs write where they have no number.
MISSING = {"", "na", "n/a", "null", "none", "nil", "-", "--", "?", "-nan(ind)", "nan(ind)", "nan(snan)"}
MISSING |= {"1.#qnan", "-1.#ind", "1.#inf", "-1.#inf", "1.#ind", "-1.#qnan"}


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


class _Raw(NamedTuple):
    """What a parser found, before rows are judged. `where(i)` names row i in messages."""

    points: np.ndarray
    normals: np.ndarray | None = None
    strokes: np.ndarray | None = None
    where: Callable[[int], str] = lambda row: f"point {row + 1}"
    incomplete: int = 0


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
    raw = _parse(data, suffix, name, strict)
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


def _parse(data: bytes, suffix: str, name: str, strict: bool) -> _Raw:
    head = data[:4096]
    if head.startswith((b"ply\n", b"ply\r")):
        return _parse_ply(data, name)
    if head.startswith(b"\x93NUMPY"):
        return _parse_npy(data, name, strict)
    if head.startswith(b"PK\x03\x04"):
        return _parse_npz(data, name, strict)
    if head.startswith(b"glTF"):
        return _parse_glb(data, name)
    if re.match(rb"(?:[ \t]*#[^\r\n]*[\r\n]+|\s)*(?:VERSION|FIELDS|COLUMNS)[ \t]", head):
        return _parse_pcd(data, name)
    if suffix == ".stl":
        return _parse_stl(data, name)
    if re.match(rb"(?:[ \t]*#[^\r\n]*[\r\n]+|\s)*(?:ST)?C?N?4?n?OFF\b", head):
        return _parse_off(data, name)
    if suffix == ".obj":
        return _parse_obj(data, name)
    if suffix in (".ply", ".pcd", ".npy", ".npz", ".glb", ".off"):
        raise ValueError(f"{name}: expected a {suffix[1:].upper()} file, found one that starts with {head[:12]!r}")
    return _parse_text(data, name, suffix, strict)


def _judge(raw: _Raw, name: str, strict: bool) -> Points:
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


# --- columns and rows ---------------------------------------------------------------------------------------------

ROLES = ("x", "y", "z", "nx", "ny", "nz", "stroke")
_NAMES = {
    "x": "x px posx positionx xcoord xcoordinate contactx pointsx points0 point0 position0",
    "y": "y py posy positiony ycoord ycoordinate contacty pointsy points1 point1 position1",
    "z": "z pz posz positionz zcoord zcoordinate contactz pointsz points2 point2 position2",
    "nx": "nx normalx xnormal normx normalsx normals0 normal0 n0",
    "ny": "ny normaly ynormal normy normalsy normals1 normal1 n1",
    "nz": "nz normalz znormal normz normalsz normals2 normal2 n2",
    "stroke": "stroke strokes strokeid strokeindex segment segmentid trajectory trajectoryid",
}
_ROLE_OF = {name: role for role, names in _NAMES.items() for name in names.split()}


def _roles(names: Sequence[str]) -> dict[str, int]:
    """Which columns hold what: {"x": 0, ...}; the first column of a kind counts."""
    roles: dict[str, int] = {}
    for column, name in enumerate(names):
        bare = re.sub(r"[\[(].*?[\])]", "", name) or name
        role = _ROLE_OF.get(re.sub(r"[^a-z0-9]", "", bare.lower()))
        if role is not None:
            roles.setdefault(role, column)
    return roles


def _pick(roles: dict[str, int]) -> list[str]:
    """The roles to read: x, y, z, complete normals, strokes."""
    wanted = ["x", "y", "z"]
    if all(role in roles for role in ("nx", "ny", "nz")):
        wanted += ["nx", "ny", "nz"]
    return wanted + (["stroke"] if "stroke" in roles else [])


def _from_columns(values: np.ndarray, wanted: Sequence[str], where: Callable[[int], str], incomplete: int = 0) -> _Raw:
    """`values` (N, len(wanted)) float64, with the roles of its columns."""
    has_normals = "nx" in wanted
    return _Raw(
        np.ascontiguousarray(values[:, :3]),
        np.ascontiguousarray(values[:, 3:6]) if has_normals else None,
        values[:, -1].copy() if "stroke" in wanted else None,
        where,
        incomplete,
    )


def _number(text: str) -> float:
    text = text.strip()
    if text.lower() in MISSING:
        return math.nan
    if "_" in text:
        raise ValueError("Python would read an underscore between digits")
    return float(text)


def _shown(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) <= 40 else text[:37] + "...")


class _Table(NamedTuple):
    values: np.ndarray  # (N, columns) float64
    lines: np.ndarray  # (N,) the line each row stood on, from 1
    incomplete: int  # rows left out because the file ends inside them

    def where(self, row: int) -> str:
        return f"line {self.lines[row]}"


def _parse_table(
    lines: Iterator[tuple[int, str]],
    name: str,
    split: Callable[[str], list[str]],
    *,
    width: int,
    columns: Sequence[int],
    capacity: int,
    comments: tuple[str, ...] = (),
    what: str = "",
    tolerate_end: bool = False,
) -> _Table:
    """Reads `columns` of rows of `width` fields; blank lines and comments are skipped.

    Args:
        lines: (line number, text) pairs.
        name: the file, for messages.
        split: makes fields of a line.
        width: how many fields each row must have.
        columns: the fields to keep.
        capacity: the most rows there can be.
        comments: what starts a comment.
        what: the separator, for messages.
        tolerate_end: an incomplete row at the very end is counted instead of refused.
    """
    values = np.empty((capacity, len(columns)))
    numbers = np.empty(capacity, dtype=np.int32)
    filled = 0

    def one_by_one(chunk: list[tuple[int, str]], last: bool) -> tuple[list[int], list[list[float]], int]:
        kept, rows = [], []
        for at, (number, line) in enumerate(chunk):
            bare = line.strip()
            if not bare or bare.startswith(comments):
                continue
            fields = split(line)
            if len(fields) != width and comments:
                for mark in comments:
                    line = line.split(mark, 1)[0]
                fields = split(line)
            if len(fields) == width + 1 and not fields[-1].strip():
                fields = fields[:width]
            wrong = len(fields) != width and f"expected {width} columns{what}, found {len(fields)}: {_shown(bare)}"
            row = []
            if not wrong:
                for column in columns:
                    try:
                        row.append(_number(fields[column]))
                    except ValueError:
                        wrong = f"expected a number in column {column + 1}, found {_shown(fields[column])}"
                        break
            if wrong:
                if tolerate_end and last and at == len(chunk) - 1 and len(fields) < width and not line.endswith("\n"):
                    return kept, rows, 1
                raise ValueError(f"{name}, line {number}: {wrong}")
            kept.append(number)
            rows.append(row)
        return kept, rows, 0

    incomplete = 0
    chunk = list(itertools.islice(lines, CHUNK_LINES))
    while chunk:
        following = list(itertools.islice(lines, CHUNK_LINES))
        rows = [split(line) for _, line in chunk]
        block = None
        if all(len(row) == width for row in rows) and not any("_" in line for _, line in chunk):
            try:
                block = np.array([[float(row[column]) for row in rows] for column in columns]).T
            except ValueError:
                pass  # a comment, a missing value or a mistake: found by going row by row
        if block is not None:
            kept = [number for number, _ in chunk]
        else:
            kept, found, incomplete = one_by_one(chunk, last=not following)
            block = np.array(found, dtype=np.float64).reshape(len(kept), len(columns))
        values[filled : filled + len(kept)] = block
        numbers[filled : filled + len(kept)] = kept
        filled += len(kept)
        chunk = following
    return _Table(values[:filled], numbers[:filled], incomplete)


def _lines(data: bytes, encoding: str = "utf-8") -> Iterator[tuple[int, str]]:
    """Numbered lines; bytes that are no text come through as lone surrogates. Line ends of any kind become \\n."""
    return enumerate(io.TextIOWrapper(io.BytesIO(data), encoding=encoding, errors="surrogateescape"), start=1)


def _capacity(data: bytes, columns: int) -> int:
    # No more rows than line ends; and a row of k columns has k - 1 separators and a line end.
    return min(data.count(b"\n") + data.count(b"\r"), len(data) // columns) + 2


# --- text ---------------------------------------------------------------------------------------------------------

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?|[+-]?\d+(?:[eE][+-]?\d+)?|[+-]?nan", re.IGNORECASE)


def _is_number(text: str) -> bool:
    try:
        _number(text)
    except ValueError:
        return False
    return bool(text.strip())


class _Dialect(NamedTuple):
    delimiter: str | None  # None: any white space
    decimal_comma: bool
    brackets: bool

    @property
    def separator(self) -> str:
        shown = {None: "white space", "\t": "a tab"}.get(self.delimiter, repr(self.delimiter))
        return f" separated by {shown}"

    def split(self, line: str) -> list[str]:
        line = line.replace('"', "")
        if self.brackets:
            line = line.translate(_NO_BRACKETS).strip().rstrip(self.delimiter or ",")
        if self.decimal_comma:
            line = line.replace(",", ".")
        return line.rstrip("\n").split(self.delimiter)


_NO_BRACKETS = str.maketrans("()[]{}", "      ")


def _dialect(line: str, header: str) -> _Dialect | None:
    """How the fields of a row of numbers are separated, or `None` where `line` holds no three numbers."""
    text = line.replace('"', "").strip()
    brackets = text.startswith(("(", "[", "{"))
    if brackets:
        text = text.translate(_NO_BRACKETS).strip().rstrip(",")
    words = text.split()
    tab = header.count("\t") == line.count("\t") >= 2
    candidates: list[tuple[str | None, bool]] = []
    if ";" in text:
        candidates = [(";", False), (";", True)]
    elif "|" in text:
        candidates = [("|", False)]
    elif "," in text:
        # "0,5 1,25 2" can only be decimal commas; "0.5, 1.25, 2" and "0.5,1.25,2" can only be separators.
        if len(words) >= 3 and all(_DECIMAL_COMMA.fullmatch(word) for word in words[:3]):
            candidates = [("\t" if tab else None, True)]
        else:
            candidates = [(",", False)]
    elif tab:
        candidates = [("\t", False)]
    else:
        candidates = [(None, False), (":", False)]
    for delimiter, decimal_comma in candidates:
        dialect = _Dialect(delimiter, decimal_comma, brackets)
        if sum(_is_number(field) for field in dialect.split(line)) >= 3:
            return dialect
    return None


def _parse_text(data: bytes, name: str, suffix: str, strict: bool) -> _Raw:
    encoding = "utf-8-sig"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif b"\0" in data:
        known = " ".join(POINT_SUFFIXES)
        raise ValueError(f"{name}: expected one of {known}, found a binary file with the suffix {suffix or 'none'!r}")
    lines = _lines(data, encoding)
    announced, headers, comment, dialect = None, [], "", None
    first, line = 0, ""
    try:
        for first, line in lines:
            bare = line.strip()
            if not bare:
                continue
            if bare.startswith(COMMENTS):
                comment = bare.lstrip("#/%! \t")
                continue
            bare = re.split("#|//|%|!", bare)[0].strip()
            dialect = _dialect(bare, headers[-1] if headers else "")
            if dialect is not None:
                break
            if not headers and announced is None and re.fullmatch(r"\d{1,15}", bare):
                announced = int(bare)
            elif not any(_is_number(word) for word in re.split(r"[\s,;|]+", bare) if word):
                headers.append(line)
            else:
                raise ValueError(f"{name}, line {first}: expected at least 3 numbers, found {_shown(line)}")
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: not the UTF-16 text that its first bytes announce ({error.reason})") from None
    if dialect is None:
        found = f": only words, such as {_shown(headers[0])}" if headers else ""
        raise ValueError(f"{name}: no points in this file{found}")

    width = len(dialect.split(bare))
    # A title may stand above the names of the columns, and their units below.
    header = next((text for text in headers if _names_xyz(text, dialect, width)), headers[-1] if headers else None)
    roles = _roles(_header_names(comment if header is None else header, dialect, width))
    named = all(role in roles for role in "xyz")
    if not named:
        if header is not None:
            _guess(f"{name}: the header {_shown(header)} names no x, y and z: columns 1-3 are taken", strict)
        roles = dict(zip(ROLES, range(min(width, 6 if width >= 6 else 4)), strict=False))
    wanted = _pick(roles) if named else list(roles)
    try:
        table = _parse_table(
            itertools.chain([(first, line)], lines),
            name,
            dialect.split,
            width=width,
            columns=[roles[role] for role in wanted],
            capacity=_capacity(data, max(len(wanted), 3)),
            comments=COMMENTS,
            what=dialect.separator,
            tolerate_end=True,
        )
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: not the UTF-16 text that its first bytes announce ({error.reason})") from None
    if announced is not None and announced != len(table.values) + table.incomplete:
        raise ValueError(f"{name}: announces {announced} points in line 1, found {len(table.values)}")
    if not named and dialect.delimiter == "," and width >= 6:
        _refuse_commas_twice(data, name)
    values = table.values
    if not named:
        values, wanted = _guess_columns(values, name, strict)
    return _from_columns(values, wanted, table.where, table.incomplete)


def _guess(message: str, strict: bool) -> None:
    if strict:
        raise ValueError(message)
    warnings.warn(message, stacklevel=5)


def _header_names(text: str, dialect: _Dialect, width: int) -> list[str]:
    """The column names in a header line; none where their number is not that of the columns."""
    text = text.strip().replace('"', "")
    for names in (text.split(dialect.delimiter), text.split(), re.split(r"[\s,;|]+", text)):
        if len(names) == width:
            return names
    return []


def _names_xyz(text: str, dialect: _Dialect, width: int) -> bool:
    roles = _roles(_header_names(text, dialect, width))
    return all(role in roles for role in "xyz")


def _refuse_commas_twice(data: bytes, name: str) -> None:
    """Refuses 0,145,0,345,0,139: three numbers with commas for decimal points, separated by commas."""
    found = None if b"." in data else re.search(rb"(?:^|[,\r\n])[ \t]*(?:[+-]?0\d|-0,)", data)
    if found:
        number = data.count(b"\n", 0, found.end()) + 1
        raise ValueError(f"{name}, line {number}: commas seem both to separate columns and to stand for decimal points")


def _guess_columns(values: np.ndarray, name: str, strict: bool) -> tuple[np.ndarray, list[str]]:
    """Gives roles to columns without names: x y z, then normals if they look like normals."""
    count, width = values.shape
    if width >= 4 and count >= 16 and (np.diff(values[:, 0]) > 0).all():
        _guess(
            f"{name}: column 1 grows from row to row like a time or a counter: columns 2-4 are taken as x, y, z "
            "(a header line that names the columns saves the guess)",
            strict,
        )
        return values[:, 1:4], ["x", "y", "z"]
    if width == 6 and _look_like_normals(values[:, 3:6]):
        return values, ["x", "y", "z", "nx", "ny", "nz"]
    return values[:, :3], ["x", "y", "z"]


def _look_like_normals(vectors: np.ndarray) -> bool:
    """Length 1 in 99 of 100 rows and some component negative: colours are not."""
    with np.errstate(invalid="ignore", over="ignore"):
        unit = np.abs(np.sqrt((vectors**2).sum(axis=1)) - 1.0) < 0.01
    return bool(unit.mean() >= 0.99 and (vectors < 0).any())


# --- PLY ----------------------------------------------------------------------------------------------------------

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


def _parse_ply(data: bytes, name: str) -> _Raw:
    form, elements, body, line = _ply_header(data, name)
    at = next((i for i, element in enumerate(elements) if element.name == "vertex"), None)
    if at is None:
        raise ValueError(f"{name}: expected an element vertex, found {[e.name for e in elements] or 'no element'}")
    vertex = elements[at]
    names = [p.name if p.count is None else "" for p in vertex.properties]
    roles = _roles(names)
    if not all(role in roles for role in "xyz"):
        raise ValueError(f"{name}: expected vertex properties x, y, z, found {[p.name for p in vertex.properties]}")
    if vertex.count == 0:
        raise ValueError(f"{name}: no points in this file (element vertex 0)")
    wanted = _pick(roles)
    if form == "ascii":
        return _ply_ascii(data, body, line, elements, at, roles, wanted, name)
    order = "<" if form == "binary_little_endian" else ">"
    for element in elements[:at]:
        _, body = _ply_binary(data, body, element, [], order, name)
    columns, _ = _ply_binary(data, body, vertex, [roles[role] for role in wanted], order, name)
    return _from_columns(np.stack(columns, axis=1), wanted, lambda row: f"vertex {row + 1}")


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
            raise ValueError(f"{name}, line {number}: not a line of a PLY header: {_shown(line)}") from None
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
) -> _Raw:
    lines = ((number + line - 1, text) for number, text in _lines(data[body:]) if text.strip())
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

    table = _parse_table(
        itertools.islice(lines, vertex.count),
        name,
        without_lists if any(p.count for p in properties) else str.split,
        width=len(properties),
        columns=[roles[role] for role in wanted],
        capacity=vertex.count,
    )
    if len(table.values) < vertex.count:
        raise ValueError(f"{name}: announces {vertex.count} vertices, found {len(table.values)}")
    if at == len(elements) - 1:
        extra = next(lines, None)
        if extra is not None:
            raise ValueError(f"{name}, line {extra[0]}: expected {vertex.count} vertices, found more")
    return _from_columns(table.values, wanted, table.where)


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


# --- PCD ----------------------------------------------------------------------------------------------------------


def _parse_pcd(data: bytes, name: str) -> _Raw:
    """Point Cloud Library files, v0.5 to v0.7: ascii, binary, binary_compressed; VIEWPOINT is not applied."""
    head, body, first_line = _pcd_header(data, name)

    def numbers(key: str, default: list[int] | None = None) -> list[int]:
        words = head.get(key)
        if words is None and default is not None:
            return default
        if words is None or not all(re.fullmatch(r"\d{1,15}", word) for word in words) or not words:
            raise ValueError(
                f"{name}: expected whole numbers after {key}, found {' '.join(words or ['no such line'])!r}"
            )
        return [int(word) for word in words]

    fields = head.get("FIELDS") or head.get("COLUMNS") or []
    sizes = numbers("SIZE")
    counts = numbers("COUNT", [1] * len(fields))
    kinds = head.get("TYPE", [])
    if not len(fields) == len(sizes) == len(counts) == len(kinds):
        raise ValueError(
            f"{name}: expected as many SIZE, TYPE and COUNT as FIELDS, found {len(fields)} fields, "
            f"{len(sizes)} sizes, {len(kinds)} types, {len(counts)} counts"
        )
    area = math.prod(numbers("WIDTH", [0])[:1] + numbers("HEIGHT", [1])[:1])
    total = numbers("POINTS", [area])[0]
    if "WIDTH" in head and total != area:
        raise ValueError(f"{name}: announces {total} POINTS but WIDTH x HEIGHT = {area}")
    roles = _roles([field if count == 1 else "" for field, count in zip(fields, counts, strict=True)])
    if not all(role in roles for role in "xyz"):
        raise ValueError(f"{name}: expected the fields x, y, z, found {' '.join(fields)!r}")
    codes = []
    for kind, size in zip(kinds, sizes, strict=True):
        code = f"{kind.lower()}{size}"
        if code not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
            raise ValueError(f"{name}: expected TYPE F of SIZE 4, 8 or I, U of SIZE 1, 2, 4, 8, found {kind} of {size}")
        codes.append("<" + code)
    if total == 0:
        raise ValueError(f"{name}: no points in this file (POINTS 0)")
    wanted = _pick(roles)
    form = (head.get("DATA") or [""])[0].lower()
    if form == "ascii":
        if total > len(data):
            raise ValueError(f"{name}: announces {total} points, found {len(data) - body} bytes of them")
        starts = np.concatenate([[0], np.cumsum(counts)])
        table = _parse_table(
            ((number + first_line - 1, text) for number, text in _lines(data[body:])),
            name,
            str.split,
            width=int(starts[-1]),
            columns=[int(starts[roles[role]]) for role in wanted],
            capacity=_capacity(data, len(wanted)),
            comments=("#",),
        )
        if len(table.values) != total:
            raise ValueError(f"{name}: announces {total} points, found {len(table.values)}")
        return _from_columns(table.values, wanted, table.where)
    widths = [np.dtype(code).itemsize * count for code, count in zip(codes, counts, strict=True)]
    size = total * sum(widths)
    if form == "binary":
        if body + size > len(data):
            raise ValueError(f"{name}: announces {total} points ({size} bytes), found {len(data) - body} bytes")
        row = np.dtype([(f"f{i}", code, (count,)) for i, (code, count) in enumerate(zip(codes, counts, strict=True))])
        rows = np.frombuffer(data, dtype=row, count=total, offset=body)
        values = np.stack([rows[f"f{roles[role]}"][:, 0].astype(np.float64) for role in wanted], axis=1)
    elif form == "binary_compressed":
        # Field after field instead of point after point.
        plain = _pcd_decompress(data, body, size, name)
        starts = np.concatenate([[0], np.cumsum(widths)]) * total
        values = np.empty((total, len(wanted)))
        for column, role in enumerate(wanted):
            field = roles[role]
            values[:, column] = np.frombuffer(plain, dtype=codes[field], count=total, offset=int(starts[field]))
    else:
        raise ValueError(f"{name}: expected DATA ascii, binary or binary_compressed, found {form!r}")
    return _from_columns(values, wanted, lambda row: f"point {row + 1}")


def _pcd_header(data: bytes, name: str) -> tuple[dict[str, list[str]], int, int]:
    """The lines of the header by keyword, and where the body begins: the byte, and the number of its first line."""
    end = re.compile(rb"(?:^|[\r\n])[ \t]*DATA[^\r\n]*(\r\n|\n|\r|$)").search(data, 0, MAX_HEADER)
    if end is None:
        raise ValueError(f"{name}: expected a line DATA in the first {MAX_HEADER} bytes of a PCD file")
    head: dict[str, list[str]] = {}
    lines = re.split(r"\r\n|\n|\r", data[: end.start(1)].decode("ascii", errors="replace"))
    for line in lines:
        words = line.split()
        if words and not words[0].startswith("#"):
            head[words[0].upper()] = words[1:]
    return head, end.end(1), len(lines) + 1


def _pcd_decompress(data: bytes, body: int, size: int, name: str) -> bytes:
    if body + 8 > len(data):
        raise ValueError(f"{name}: expected the sizes of the compressed data, found the end of the file")
    packed, plain = struct.unpack_from("<II", data, body)
    if body + 8 + packed > len(data):
        raise ValueError(f"{name}: announces {packed} compressed bytes, found {len(data) - body - 8}")
    if plain != size:
        raise ValueError(f"{name}: expected {size} bytes after decompression, the file announces {plain}")
    _check_expansion(plain, len(data), name)
    return _lzf(memoryview(data)[body + 8 : body + 8 + packed], plain, name)


def _check_expansion(plain: int, size: int, name: str) -> None:
    if plain > max(10 * size, EXPANDED):
        raise ValueError(f"{name}: refused: {size} bytes would expand to {plain}, more than tenfold")


def _lzf(packed: memoryview, size: int, name: str) -> bytes:
    """Decompresses LZF (the format of liblzf): literal runs, and copies of at most 264 bytes from up to 8 KiB back."""
    out = bytearray()
    at, end = 0, len(packed)
    try:
        while at < end and len(out) <= size:
            control = packed[at]
            at += 1
            if control < 32:
                if at + control + 1 > end:
                    raise IndexError
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            back = ((control & 31) << 8) + packed[at] + 1
            at += 1
            length += 2
            if back > len(out):
                raise IndexError
            if back >= length:
                start = len(out) - back
                out += out[start : start + length]
            else:
                # The copy overlaps itself: the last `back` bytes repeat.
                out += (out[-back:] * (length // back + 1))[:length]
    except IndexError:
        raise ValueError(f"{name}: the compressed data are damaged at byte {at}") from None
    if len(out) != size:
        raise ValueError(f"{name}: expected {size} bytes after decompression, found {len(out)}")
    return bytes(out)


# --- NumPy --------------------------------------------------------------------------------------------------------


def _read_npy(data: bytes | memoryview, name: str) -> np.ndarray:
    """One NPY array of plain numbers, without numpy's own reader: it allocates what the header asks for."""
    if len(data) < 12:
        raise ValueError(f"{name}: expected an NPY header, found {len(data)} bytes")
    major = data[6]
    if major == 1:
        length, start = struct.unpack_from("<H", data, 8)[0], 10
    elif major in (2, 3):
        length, start = struct.unpack_from("<I", data, 8)[0], 12
    else:
        raise ValueError(f"{name}: expected NPY version 1, 2 or 3, found {major}")
    if start + length > len(data) or length > 10_000:
        raise ValueError(f"{name}: expected an NPY header of at most 10000 bytes, found {length} announced")
    try:
        header = ast.literal_eval(bytes(data[start : start + length]).decode("latin-1").strip())
        dtype = np.lib.format.descr_to_dtype(header["descr"])
        shape = tuple(header["shape"])
        order = "F" if header["fortran_order"] else "C"
        if not all(isinstance(n, int) and n >= 0 for n in shape):
            raise ValueError
    except (ValueError, TypeError, KeyError, IndexError, SyntaxError, AttributeError, MemoryError, RecursionError):
        raise ValueError(f"{name}: the NPY header is damaged") from None
    if dtype.hasobject:
        raise ValueError(f"{name}: expected an array of numbers, found Python objects, which are never unpickled")
    count = math.prod(shape)
    if start + length + count * dtype.itemsize > len(data):
        raise ValueError(
            f"{name}: announces shape {shape} of {dtype} ({count * dtype.itemsize} bytes), "
            f"found {len(data) - start - length} bytes"
        )
    if count * dtype.itemsize == 0:
        raise ValueError(f"{name}: no points in an array of shape {shape}")
    return np.frombuffer(data, dtype=dtype, count=count, offset=start + length).reshape(shape, order=order)


def _as_points(array: np.ndarray, name: str, strict: bool) -> _Raw:
    if array.dtype.names:
        roles = _roles(array.dtype.names)
        flat = array.reshape(-1)
        if not all(role in roles for role in "xyz"):
            raise ValueError(f"{name}: expected the fields x, y, z, found {list(array.dtype.names)}")
        wanted = _pick(roles)
        columns = [flat[array.dtype.names[roles[role]]] for role in wanted]
        if not all(column.ndim == 1 and column.dtype.kind in "fiu" for column in columns):
            raise ValueError(f"{name}: expected fields of one number each, found {array.dtype}")
        values = np.stack([column.astype(np.float64) for column in columns], axis=1)
        return _from_columns(values, wanted, lambda row: f"row {row + 1}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: expected numbers, found an array of {array.dtype}")
    if array.ndim < 2 or array.shape[-1] < 3 or (array.ndim == 2 and array.shape[0] == 3 < array.shape[1]):
        hint = " (transpose it)" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise ValueError(f"{name}: expected an array of shape (N, 3) or (N, 6), found {array.shape}{hint}")
    if array.shape[-1] > 32:
        raise ValueError(f"{name}: expected an array of shape (N, 3) or (N, 6), found {array.shape}")
    rows = array.reshape(-1, array.shape[-1])
    values = rows[:, : 6 if rows.shape[1] >= 6 else 4].astype(np.float64)
    values, wanted = _guess_columns(values, name, strict)
    return _from_columns(values, wanted, lambda row: f"row {row + 1}")


def _parse_npy(data: bytes, name: str, strict: bool) -> _Raw:
    return _as_points(_read_npy(data, name), name, strict)


def _parse_npz(data: bytes, name: str, strict: bool) -> _Raw:
    """The array points (or touches, xyz, positions, vertices, or the only one), with normals and strokes beside it."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        members = {info.filename[:-4]: info for info in archive.infolist() if info.filename.endswith(".npy")}
    except (zipfile.BadZipFile, ValueError, struct.error, NotImplementedError, EOFError) as error:
        raise ValueError(f"{name}: not a readable NPZ file ({error})") from None

    def read(key: str) -> np.ndarray:
        info = members[key]
        _check_expansion(info.file_size, len(data), f"{name}[{key}]")
        try:
            with archive.open(info) as file:
                content = file.read(info.file_size + 1)
        except Exception as error:  # zlib, lzma, bz2 and zipfile each have their own
            raise ValueError(f"{name}[{key}]: cannot be unpacked ({error})") from None
        if not content.startswith(b"\x93NUMPY"):
            raise ValueError(f"{name}[{key}]: expected an NPY array, found {content[:12]!r}")
        return _read_npy(content, f"{name}[{key}]")

    found = [key for key in ("points", "touches", "xyz", "positions", "vertices") if key in members]
    if not found and len(members) == 1:
        found = list(members)
    if not found:
        names = ", ".join(sorted(members)[:8]) or "none"
        raise ValueError(f"{name}: expected an array named points, found {names}")
    raw = _as_points(read(found[0]), f"{name}[{found[0]}]", strict)
    if "normals" in members:
        normals = read("normals")
        if normals.shape != raw.points.shape or normals.dtype.kind not in "fiu":
            raise ValueError(f"{name}[normals]: expected shape {raw.points.shape}, found {normals.shape}")
        raw = raw._replace(normals=normals.astype(np.float64))
    if "strokes" in members:
        strokes = read("strokes")
        if strokes.shape != raw.points.shape[:1] or strokes.dtype.kind not in "fiu":
            raise ValueError(f"{name}[strokes]: expected shape {raw.points.shape[:1]}, found {strokes.shape}")
        raw = raw._replace(strokes=strokes.astype(np.float64))
    return raw


# --- meshes as clouds ---------------------------------------------------------------------------------------------


def _tagged(data: bytes, tag: str) -> Iterator[tuple[int, str]]:
    """The first three words after `tag` on the lines that start with it."""
    for number, line in _lines(data):
        words = line.split(None, 4)
        if words and words[0] == tag:
            yield number, " ".join(words[1:4])


def _three(lines: Iterator[tuple[int, str]], data: bytes, name: str) -> _Table:
    return _parse_table(lines, name, str.split, width=3, columns=(0, 1, 2), capacity=_capacity(data, 3))


def _parse_obj(data: bytes, name: str) -> _Raw:
    """The v lines; the vn lines are their normals where there is one for each and no face says otherwise."""
    table = _three(_tagged(data, "v"), data, name)
    if not len(table.values):
        raise ValueError(f"{name}: no points in this file (no line starts with v)")
    normals = None
    if not re.search(rb"(?:^|[\r\n])[ \t]*f[ \t]", data):
        directions = _three(_tagged(data, "vn"), data, name).values
        if len(directions) == len(table.values):
            normals = directions
    return _Raw(table.values, normals, None, table.where)


def _parse_off(data: bytes, name: str) -> _Raw:
    lines = ((n, text) for n, text in _lines(data) if text.strip() and not text.lstrip().startswith("#"))
    number, keyword = next(lines)
    counts = keyword.split()[1:]
    if not counts:
        number, line = next(lines, (number, ""))
        counts = line.split()
    if not 1 <= len(counts) <= 3 or not re.fullmatch(r"\d{1,15}", counts[0]):
        raise ValueError(
            f"{name}, line {number}: expected the numbers of vertices and faces, found {_shown(' '.join(counts))}"
        )
    total = int(counts[0])
    if total == 0:
        raise ValueError(f"{name}: no points in this file (0 vertices)")
    rows = ((n, " ".join(text.split(None, 4)[:3])) for n, text in itertools.islice(lines, min(total, len(data))))
    table = _three(rows, data, name)
    if len(table.values) != total:
        raise ValueError(f"{name}: announces {total} vertices, found {len(table.values)}")
    return _Raw(table.values, None, None, table.where)


def _parse_stl(data: bytes, name: str) -> _Raw:
    corners = _stl_corners(data, name)
    # Each corner comes once per triangle; the order of first appearance is kept.
    _, first = np.unique(corners, axis=0, return_index=True)
    return _Raw(corners[np.sort(first)], None, None, lambda row: f"vertex {row + 1}")


def _stl_corners(data: bytes, name: str) -> np.ndarray:
    """(3 F, 3) float64, three corners a triangle."""
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    if data.lstrip()[:5].lower() == b"solid" and len(data) != 84 + 50 * count:
        table = _three(_tagged(data, "vertex"), data, name)
        if not len(table.values):
            raise ValueError(f"{name}: no points in this file (no line starts with vertex)")
        return table.values
    if len(data) < 84 or 84 + 50 * count > len(data):
        raise ValueError(f"{name}: announces {count} triangles ({84 + 50 * count} bytes), found {len(data)} bytes")
    if count == 0:
        raise ValueError(f"{name}: no points in this file (0 triangles)")
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, dtype=kind, count=count, offset=84)["corners"].reshape(-1, 3).astype(np.float64)


def _parse_glb(data: bytes, name: str) -> _Raw:
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
    return _Raw(np.concatenate(parts), None, None, lambda row: f"vertex {row + 1}")


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
    _check_expansion(24 * total, len(data), name)


# --- meshes -------------------------------------------------------------------------------------------------------


def read_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """Reads a triangle mesh as it is (no merging, no clean-up; of an STL equal corners are joined).

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: one line; the file is no mesh, has no faces, or a vertex that is not finite.
    """
    name, suffix, data = _load(path)
    try:
        if suffix == ".stl":
            corners = _stl_corners(data, name)
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
    return mesh


def write_mesh(
    target: str | os.PathLike[str] | BinaryIO,
    mesh: trimesh.Trimesh,
    *,
    kind: str | None = None,
    cell: float | None = None,
) -> None:
    """Writes a triangle mesh with enough digits that reading gives the same mesh.

    PLY holds float64, OBJ shortest decimal numbers that read back equal; STL and GLB hold float32 and are refused where
    that would let vertices fall together. The file is not written atomically (`touchnet.cli.atomic_output` is).

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
    vertices = np.ascontiguousarray(mesh.vertices, dtype="<f8")
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"] = 3
    faces["corners"] = mesh.faces
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment touchnet\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return [header.encode(), vertices.tobytes(), faces.tobytes()]


def _obj_blocks(mesh: trimesh.Trimesh) -> Iterable[bytes]:
    yield b"# touchnet\n"
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    for start in range(0, len(vertices), CHUNK_LINES):
        # repr gives the shortest number that reads back equal (at most 17 digits).
        rows = vertices[start : start + CHUNK_LINES].tolist()
        yield "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rows).encode()
    for start in range(0, len(mesh.faces), CHUNK_LINES):
        rows = (np.asarray(mesh.faces[start : start + CHUNK_LINES]) + 1).tolist()
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
