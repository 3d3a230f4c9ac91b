"""NPY and NPZ without numpy's own reader, which allocates what a header asks for."""

import ast
import io
import math
import struct
import zipfile

import numpy as np

from touchnet.data.readers.rows import Raw, check_expansion, excerpt, from_columns, guess_columns, pick, roles_of


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


def _as_points(array: np.ndarray, name: str, strict: bool) -> Raw:
    if array.dtype.names:
        roles = roles_of(array.dtype.names)
        flat = array.reshape(-1)
        if not all(role in roles for role in "xyz"):
            raise ValueError(f"{name}: expected the fields x, y, z, found {excerpt(' '.join(array.dtype.names), 120)}")
        wanted = pick(roles)
        columns = [flat[array.dtype.names[roles[role]]] for role in wanted]
        if not all(column.ndim == 1 and column.dtype.kind in "fiu" for column in columns):
            raise ValueError(f"{name}: expected fields of one number each, found {array.dtype}")
        values = np.stack([column.astype(np.float64) for column in columns], axis=1)
        return from_columns(values, wanted, lambda row: f"row {row + 1}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: expected numbers, found an array of {array.dtype}")
    if array.ndim < 2 or array.shape[-1] < 3 or (array.ndim == 2 and array.shape[0] == 3 < array.shape[1]):
        hint = " (transpose it)" if array.ndim == 2 and array.shape[0] == 3 else ""
        raise ValueError(f"{name}: expected an array of shape (N, 3) or (N, 6), found {array.shape}{hint}")
    if array.shape[-1] > 32:
        raise ValueError(f"{name}: expected an array of shape (N, 3) or (N, 6), found {array.shape}")
    rows = array.reshape(-1, array.shape[-1])
    values = rows[:, : 6 if rows.shape[1] >= 6 else 4].astype(np.float64)
    values, wanted = guess_columns(values, name, strict)
    return from_columns(values, wanted, lambda row: f"row {row + 1}")


def parse_npy(data: bytes, name: str, strict: bool) -> Raw:
    return _as_points(_read_npy(data, name), name, strict)


def parse_npz(data: bytes, name: str, strict: bool) -> Raw:
    """The array points (or touches, xyz, positions, vertices, or the only one), with normals and strokes beside it."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        members = {info.filename[:-4]: info for info in archive.infolist() if info.filename.endswith(".npy")}
    except (zipfile.BadZipFile, ValueError, struct.error, NotImplementedError, EOFError) as error:
        raise ValueError(f"{name}: not a readable NPZ file ({error})") from None

    def read(key: str) -> np.ndarray:
        info = members[key]
        label = f"{name}[{excerpt(key)[1:-1]}]"  # whatever the name of a member, the message is one line
        try:
            with archive.open(info) as file:
                content = file.read(info.file_size + 1)
        except Exception as error:  # zlib, lzma, bz2 and zipfile each have their own
            raise ValueError(f"{label}: cannot be unpacked ({error})") from None
        if not content.startswith(b"\x93NUMPY"):
            raise ValueError(f"{label}: expected an NPY array, found {content[:12]!r}")
        return _read_npy(content, label)

    found = [key for key in ("points", "touches", "xyz", "positions", "vertices") if key in members]
    if not found and len(members) == 1:
        found = list(members)
    if not found:
        names = excerpt(", ".join(sorted(members)), 120) if members else "none"
        raise ValueError(f"{name}: expected an array named points, found {names}")
    read_ones = {found[0], "normals", "strokes"} & set(members)
    check_expansion(sum(members[key].file_size for key in read_ones), len(data), name)
    raw = _as_points(read(found[0]), f"{name}[{excerpt(found[0])[1:-1]}]", strict)
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
