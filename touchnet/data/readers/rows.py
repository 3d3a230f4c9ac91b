"""What the readers share: which column holds what, rows of numbers in text, limits."""

import io
import itertools
import math
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

POINT_SUFFIXES = (
    ".xyz .txt .csv .tsv .pts .asc .dat .xyzn .xyzrgb".split() + ".ply .pcd .npy .npz .obj .off .stl .glb".split()
)

# Compressed files may expand to ten times their size, small ones to this much.
EXPANDED = 1 << 26
MAX_HEADER = 1 << 20
LONGEST_LINE = 1 << 16
CHUNK_LINES = 1 << 12

# What programs write where they have no number.
MISSING = {"", "na", "n/a", "null", "none", "nil", "-", "--", "?", "-nan(ind)", "nan(ind)", "nan(snan)"}
MISSING |= {"1.#qnan", "-1.#ind", "1.#inf", "-1.#inf", "1.#ind", "-1.#qnan"}


class Raw(NamedTuple):
    """What a parser found, before rows are judged. `where(i)` names row i in messages."""

    points: np.ndarray
    normals: np.ndarray | None = None
    strokes: np.ndarray | None = None
    where: Callable[[int], str] = lambda row: f"point {row + 1}"
    incomplete: int = 0


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


def roles_of(names: Sequence[str]) -> dict[str, int]:
    """Which columns hold what: {"x": 0, ...}; the first column of a kind counts."""
    roles: dict[str, int] = {}
    for column, name in enumerate(names):
        # Units in brackets do not count: "x [mm]".
        bare = re.sub(r"[\[(].*?[\])]", "", name[:80]) or name
        role = _ROLE_OF.get(re.sub(r"[^a-z0-9]", "", bare.lower()))
        if role is not None:
            roles.setdefault(role, column)
    return roles


def pick(roles: dict[str, int]) -> list[str]:
    """The roles to read: x, y, z, complete normals, strokes."""
    wanted = ["x", "y", "z"]
    if all(role in roles for role in ("nx", "ny", "nz")):
        wanted += ["nx", "ny", "nz"]
    return wanted + (["stroke"] if "stroke" in roles else [])


def from_columns(values: np.ndarray, wanted: Sequence[str], where: Callable[[int], str], incomplete: int = 0) -> Raw:
    """`values` (N, len(wanted)) float64, with the roles of its columns."""
    has_normals = "nx" in wanted
    return Raw(
        np.ascontiguousarray(values[:, :3]),
        np.ascontiguousarray(values[:, 3:6]) if has_normals else None,
        values[:, -1].copy() if "stroke" in wanted else None,
        where,
        incomplete,
    )


def to_number(text: str) -> float:
    """The number, NaN for what stands where there is none; ValueError for anything else."""
    text = text.strip()
    if text.lower() in MISSING:
        return math.nan
    if "_" in text:
        raise ValueError("Python would read an underscore between digits")
    return float(text)


def excerpt(text: str, longest: int = 40) -> str:
    """The text in quotes, cut, control characters escaped."""
    text = text.strip()
    return repr(text if len(text) <= longest else text[: longest - 3] + "...")


class Table(NamedTuple):
    """Rows of numbers from text."""

    values: np.ndarray  # (N, columns) float64
    lines: np.ndarray  # (N,) the line each row stood on, from 1
    incomplete: int  # rows left out because the file ends inside them

    def where(self, row: int) -> str:
        return f"line {self.lines[row]}"


def parse_table(
    lines: Iterator[tuple[int, str]],
    name: str,
    split: Callable[[str], list[str]],
    *,
    width: int,
    columns: Sequence[int],
    capacity: int,
    comments: tuple[str, ...] = (),
    delimiter: str | bool | None = None,
    what: str = "",
    tolerate_end: bool = False,
) -> Table:
    """Reads `columns` of rows of `width` fields; blank lines and comments are skipped.

    Args:
        lines: (line number, text) pairs.
        name: the file, for messages.
        split: makes fields of a line.
        width: how many fields each row must have.
        columns: the fields to keep.
        capacity: the most rows there can be.
        comments: what starts a comment.
        delimiter: what `split` splits at (None: white space), or False where it does more than that.
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
            wrong = len(fields) != width and f"expected {width} columns{what}, found {len(fields)}: {excerpt(bare)}"
            row = []
            if not wrong:
                for column in columns:
                    try:
                        row.append(to_number(fields[column]))
                    except ValueError:
                        wrong = f"expected a number in column {column + 1}, found {excerpt(fields[column])}"
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
        block = None
        if delimiter is not False and chunk[0][1].strip():
            # numpy's parser is ten times faster and takes plain numbers only; whatever it does not take is looked at
            # row by row: a comment, a missing value, a mistake.
            try:
                block = np.loadtxt([line for _, line in chunk], delimiter=delimiter, comments=None, ndmin=2)
            except ValueError:
                pass
            else:
                block = block[:, columns] if block.shape == (len(chunk), width) else None
        if block is not None:
            kept = [number for number, _ in chunk]
        else:
            kept, found, incomplete = one_by_one(chunk, last=not following)
            block = np.array(found, dtype=np.float64).reshape(len(kept), len(columns))
        values[filled : filled + len(kept)] = block
        numbers[filled : filled + len(kept)] = kept
        filled += len(kept)
        chunk = following
    return Table(values[:filled], numbers[:filled], incomplete)


def numbered_lines(data: bytes, name: str, encoding: str = "utf-8") -> Iterator[tuple[int, str]]:
    """Numbered lines; bytes that are no text come through as lone surrogates. Line ends of any kind become \\n.

    Raises:
        ValueError: a line longer than 64 KiB, which no row of points is and which would take much memory to split.
    """
    start = 0
    while start + LONGEST_LINE < len(data):
        end = max(data.rfind(b"\n", start, start + LONGEST_LINE), data.rfind(b"\r", start, start + LONGEST_LINE))
        if end < 0:
            raise ValueError(f"{name}: expected rows of numbers, found a line of more than {LONGEST_LINE} bytes")
        start = end + 1
    return enumerate(io.TextIOWrapper(io.BytesIO(data), encoding=encoding, errors="surrogateescape"), start=1)


def most_rows(data: bytes, columns: int) -> int:
    """How many rows of so many columns a text can hold at most."""
    # No more rows than line ends; and a row of k columns has k - 1 separators and a line end.
    return min(data.count(b"\n") + data.count(b"\r"), len(data) // columns) + 2


def guess(message: str, strict: bool) -> None:
    """Warns of a guess, or refuses to make it."""
    if strict:
        raise ValueError(message)
    warnings.warn(message, stacklevel=5)


def guess_columns(values: np.ndarray, name: str, strict: bool) -> tuple[np.ndarray, list[str]]:
    """Gives roles to columns without names: x y z, then normals if they look like normals."""
    count, width = values.shape
    if width >= 4 and count >= 16 and (np.diff(values[:, 0]) > 0).all():
        guess(
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


def check_expansion(plain: int, size: int, name: str) -> None:
    """Raises ValueError where `size` bytes of a file would become too many."""
    if plain > max(10 * size, EXPANDED):
        raise ValueError(f"{name}: refused: {size} bytes would expand to {plain}, more than tenfold")
