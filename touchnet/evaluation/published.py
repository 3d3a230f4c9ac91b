"""Figures that others published, of other data, as a table that stands apart from what was measured."""

from __future__ import annotations

import csv
from pathlib import Path

from touchnet.evaluation.tables import Table

COLUMNS = ("source", "method", "category", "measure", "value")
TITLE = "published by others, with other data: not to be compared line by line"


def read_published(path: Path) -> Table:
    """A table of the rows of a CSV file with the columns source, method, category, measure and value.

    Measures are columns, in the order in which they first come; values stand there as the file writes them.

    Raises:
        OSError: the file cannot be read.
        ValueError: another header, a value that is no number, a figure that is given twice, no row.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            found = ",".join(reader.fieldnames or ())
            raise ValueError(f"{path}: line 1 should be {','.join(COLUMNS)}, got {found or 'nothing'}")
        figures: dict[tuple[str, str, str], dict[str, str]] = {}
        measures: dict[str, None] = {}
        for row in reader:
            where = f"{path}: line {reader.line_num}"
            if None in row or None in row.values():
                raise ValueError(f"{where} should have {len(COLUMNS)} fields")
            source, method, category, measure, value = (row[name].strip() for name in COLUMNS)
            try:
                float(value)
            except ValueError:
                raise ValueError(f"{where}: value should be a number, got {value!r}") from None
            line = figures.setdefault((source, method, category), {})
            if measure in line:
                raise ValueError(f"{where}: {measure} of {method}, {category} is given twice")
            line[measure], measures[measure] = value, None
    if not figures:
        raise ValueError(f"{path}: no figure in this file")
    lines = [[*key, *(line.get(measure, "n/a") for measure in measures)] for key, line in figures.items()]
    return Table(TITLE, ["source", "method", "category", *measures], lines)
