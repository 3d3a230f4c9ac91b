"""Text: any delimiter, decimal commas, headers, comments."""

import itertools
import re
from typing import NamedTuple

from touchnet.data.readers.rows import (
    POINT_SUFFIXES,
    ROLES,
    Raw,
    excerpt,
    from_columns,
    guess,
    guess_columns,
    most_rows,
    numbered_lines,
    parse_table,
    pick,
    roles_of,
    to_number,
)

COMMENTS = ("#", "//", "%", "!")

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?|[+-]?\d+(?:[eE][+-]?\d+)?|[+-]?nan", re.IGNORECASE)


def _is_number(text: str) -> bool:
    try:
        to_number(text)
    except ValueError:
        return False
    return bool(text.strip())


class _Dialect(NamedTuple):
    """How the fields of a line are separated and written."""

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


def parse_text(data: bytes, name: str, suffix: str, strict: bool) -> Raw:
    """Columns x, y, z by their names or first; normals and strokes by name, normals also by their length."""
    encoding = "utf-8-sig"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif b"\0" in data:
        known = " ".join(POINT_SUFFIXES)
        raise ValueError(f"{name}: expected one of {known}, found a binary file with the suffix {suffix or 'none'!r}")
    lines = numbered_lines(data, name, encoding)
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
            bare = re.split("#|//|%|!", line)[0].rstrip("\n")
            dialect = _dialect(bare, headers[-1] if headers else "")
            if dialect is not None:
                break
            if not headers and announced is None and re.fullmatch(r"\d{1,15}", bare.strip()):
                announced = int(bare.strip())
            elif not any(_is_number(word) for word in re.split(r"[\s,;|]+", bare) if word):
                headers.append(line)
            else:
                raise ValueError(f"{name}, line {first}: expected at least 3 numbers, found {excerpt(line)}")
    except UnicodeDecodeError as error:
        raise ValueError(f"{name}: not the UTF-16 text that its first bytes announce ({error.reason})") from None
    if dialect is None:
        found = f": only words, such as {excerpt(headers[0])}" if headers else ""
        raise ValueError(f"{name}: no points in this file{found}")

    width = len(dialect.split(bare))
    # A title may stand above the names of the columns, and their units below.
    header = next((text for text in headers if _names_xyz(text, dialect, width)), headers[-1] if headers else None)
    roles = roles_of(_header_names(comment if header is None else header, dialect, width))
    named = all(role in roles for role in "xyz")
    if not named:
        if header is not None:
            guess(
                f"{name}: the header {excerpt(header)} does not name x, y and z among {width} columns: columns 1-3 are "
                "taken",
                strict,
            )
        # As many of the first columns as hold numbers and may mean something.
        numeric = next((i for i, word in enumerate(dialect.split(bare)) if not _is_number(word)), width)
        roles = dict(zip(ROLES, range(max(3, 6 if numeric >= 6 else min(numeric, 4))), strict=False))
    wanted = pick(roles) if named else list(roles)
    try:
        table = parse_table(
            itertools.chain([(first, line)], lines),
            name,
            dialect.split,
            width=width,
            columns=[roles[role] for role in wanted],
            capacity=most_rows(data, max(len(wanted), 3)),
            comments=COMMENTS,
            delimiter=False if dialect.decimal_comma or dialect.brackets else dialect.delimiter,
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
        values, wanted = guess_columns(values, name, strict)
    return from_columns(values, wanted, table.where, table.incomplete)


def _header_names(text: str, dialect: _Dialect, width: int) -> list[str]:
    """The column names in a header line; none where their number is not that of the columns."""
    text = text.strip().replace('"', "")
    for names in (text.split(dialect.delimiter), text.split(), re.split(r"[\s,;|]+", text)):
        if len(names) == width:
            return names
    return []


def _names_xyz(text: str, dialect: _Dialect, width: int) -> bool:
    roles = roles_of(_header_names(text, dialect, width))
    return all(role in roles for role in "xyz")


def _refuse_commas_twice(data: bytes, name: str) -> None:
    """Refuses 0,145,0,345,0,139: three numbers with commas for decimal points, separated by commas."""
    found = None if b"." in data else re.search(rb"(?:^|[,\r\n])[ \t]*(?:[+-]?0\d|-0,)", data)
    if found:
        number = data.count(b"\n", 0, found.end()) + 1
        raise ValueError(f"{name}, line {number}: commas seem both to separate columns and to stand for decimal points")
