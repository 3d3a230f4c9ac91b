"""PCD of the Point Cloud Library: ascii, binary and compressed."""

import math
import re
import struct

import numpy as np

from touchnet.data.readers.rows import (
    MAX_HEADER,
    Raw,
    check_expansion,
    excerpt,
    from_columns,
    most_rows,
    numbered_lines,
    parse_table,
    pick,
    roles_of,
)


def parse_pcd(data: bytes, name: str) -> Raw:
    """Point Cloud Library files, v0.5 to v0.7: ascii, binary, binary_compressed; VIEWPOINT is not applied."""
    head, body, first_line = _pcd_header(data, name)

    def numbers(key: str, default: list[int] | None = None) -> list[int]:
        words = head.get(key)
        if words is None and default is not None:
            return default
        if words is None or not all(re.fullmatch(r"\d{1,15}", word) for word in words) or not words:
            raise ValueError(
                f"{name}: expected whole numbers after {key}, found {excerpt(' '.join(words or ['no such line']))}"
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
    roles = roles_of([field if count == 1 else "" for field, count in zip(fields, counts, strict=True)])
    if not all(role in roles for role in "xyz"):
        raise ValueError(f"{name}: expected the fields x, y, z, found {excerpt(' '.join(fields), 120)}")
    codes = []
    for kind, size in zip(kinds, sizes, strict=True):
        code = f"{kind.lower()}{size}"
        if code not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"):
            raise ValueError(f"{name}: expected TYPE F of SIZE 4, 8 or I, U of SIZE 1, 2, 4, 8, found {kind} of {size}")
        codes.append("<" + code)
    if total == 0:
        raise ValueError(f"{name}: no points in this file (POINTS 0)")
    wanted = pick(roles)
    form = (head.get("DATA") or [""])[0].lower()
    if form == "ascii":
        if total > len(data):
            raise ValueError(f"{name}: announces {total} points, found {len(data) - body} bytes of them")
        starts = np.concatenate([[0], np.cumsum(counts)])
        table = parse_table(
            ((number + first_line - 1, text) for number, text in numbered_lines(data[body:], name)),
            name,
            str.split,
            width=int(starts[-1]),
            columns=[int(starts[roles[role]]) for role in wanted],
            capacity=most_rows(data, len(wanted)),
            comments=("#",),
        )
        if len(table.values) != total:
            raise ValueError(f"{name}: announces {total} points, found {len(table.values)}")
        return from_columns(table.values, wanted, table.where)
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
    return from_columns(values, wanted, lambda row: f"point {row + 1}")


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


def _pcd_decompress(data: bytes, body: int, size: int, name: str) -> bytearray:
    if body + 8 > len(data):
        raise ValueError(f"{name}: expected the sizes of the compressed data, found the end of the file")
    packed, plain = struct.unpack_from("<II", data, body)
    if body + 8 + packed > len(data):
        raise ValueError(f"{name}: announces {packed} compressed bytes, found {len(data) - body - 8}")
    if plain != size:
        raise ValueError(f"{name}: expected {size} bytes after decompression, the file announces {plain}")
    check_expansion(plain, len(data), name)
    return decompress_lzf(memoryview(data)[body + 8 : body + 8 + packed], plain, name)


def decompress_lzf(packed: memoryview, size: int, name: str) -> bytearray:
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
    return out
