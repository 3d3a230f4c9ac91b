"""The data set directory: one small JSON index and one safetensors file a shape (docs/data_set.md).

Everything is read lazily: an item costs the bytes it asks for, whatever the size of the set.
"""

import hashlib
import json
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple

import numpy as np
import safetensors
import trimesh
from numpy.typing import NDArray

from touchnet.outputs import atomic_output

FORMAT = "touchnet-dataset"
VERSION = 1
SPLITS = ("train", "val", "test")
INDEX = "dataset.json"

# Name -> dtype and the columns of a row; packed bits have none.
TENSORS = {
    "vertices": ("F32", 3),
    "faces": ("I32", 3),
    "touches": ("F32", 3),
    "touch_normals": ("F16", 3),
    "strokes": ("I16", None),
    "variance": ("F32", None),
    "near": ("F16", 3),
    "near_inside": ("U8", None),
    "box": ("F16", 3),
    "box_inside": ("U8", None),
    "surface": ("F32", 3),
    "surface_normals": ("F16", 3),
}
_DTYPES = {"F32": np.float32, "F16": np.float16, "I32": np.int32, "I16": np.int16, "U8": np.uint8}


class ShapeRecord(NamedTuple):
    """One line of the index. `id` is "category/name", `split` one of train, val, test, `file` relative to the set."""

    id: str
    category: str
    split: str
    source: str
    licence: str
    file: str
    sha256: str


class ShapeFile:
    """One shape of a data set; every read opens the file, reads what was asked for and closes it (fork-safe)."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    @property
    def metadata(self) -> dict[str, Any]:
        """id, category, closed_by, centre (3,) and scale (original = unit * scale + centre), and what else is known."""
        with self._open() as file:
            said = dict(file.metadata() or {})
        centre = np.array(json.loads(said["centre"]))
        return {**said, "centre": centre, "scale": float(said["scale"])}

    @property
    def names(self) -> list[str]:
        with self._open() as file:
            return list(file.keys())

    def shape(self, name: str) -> tuple[int, ...]:
        """The extents of a tensor, read from the header alone."""
        with self._open() as file:
            return tuple(self._slice(file, name).get_shape())

    def array(self, name: str) -> NDArray[Any]:
        """One whole tensor."""
        with self._open() as file:
            self._slice(file, name)
            return file.get_tensor(name)

    def rows(self, name: str, start: int, stop: int) -> NDArray[Any]:
        """Rows start:stop of a tensor, clipped to its extent as Python slices are."""
        with self._open() as file:
            part = self._slice(file, name)
            start, stop, _ = slice(start, stop).indices(part.get_shape()[0])
            if stop <= start:
                return np.empty((0, *part.get_shape()[1:]), dtype=_DTYPES[part.get_dtype()])
            return part[start:stop]

    def inside(self, name: str) -> NDArray[np.bool_]:
        """The labels (P,) of the points `name`, "near" or "box"."""
        with self._open() as file:
            count = self._slice(file, name).get_shape()[0]
            self._slice(file, f"{name}_inside")
            return np.unpackbits(file.get_tensor(f"{name}_inside"), count=count).astype(bool)

    def mesh(self) -> trimesh.Trimesh:
        """The closed mesh in unit coordinates."""
        with self._open() as file:
            return trimesh.Trimesh(file.get_tensor("vertices"), file.get_tensor("faces"), process=False)

    def _open(self) -> Any:
        try:
            return safetensors.safe_open(self.path, framework="numpy")
        except safetensors.SafetensorError as error:
            raise ValueError(f"{self.path}: not a shape file ({error})") from error

    def _slice(self, file: Any, name: str) -> Any:
        if name not in file.keys():
            raise ValueError(f"{self.path}: no tensor {name!r}, there are {', '.join(file.keys())}")
        return file.get_slice(name)


class TouchDataset:
    """A data set directory, or the part of it that was asked for.

    Args:
        directory: where `dataset.json` lies.
        split: "train", "val" or "test"; None: all.
        categories: keep these only.
        exclude_licences: leave shapes out whose licence starts with one of these (such as "GPL").

    Raises:
        ValueError: not a data set of this version, an unknown split or category.
        FileNotFoundError: no `dataset.json` there.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        split: str | None = None,
        *,
        categories: Collection[str] | None = None,
        exclude_licences: Sequence[str] = (),
    ) -> None:
        self.directory = Path(directory)
        index = read_index(self.directory)
        if split is not None and split not in SPLITS:
            raise ValueError(f"split should be one of {', '.join(SPLITS)}, got {split!r}")
        known = {record.category for record in index.shapes}
        unknown = sorted(set(categories or ()) - known)
        if unknown:
            raise ValueError(f"categories should be out of {', '.join(sorted(known))}, got {', '.join(unknown)}")
        self.seed = index.seed
        self.parameters = index.parameters
        self.failures = index.failures
        self.records = [
            record
            for record in index.shapes
            if (split is None or record.split == split)
            and (categories is None or record.category in categories)
            and not record.licence.startswith(tuple(exclude_licences))
        ]

    def __len__(self) -> int:
        return len(self.records)

    def shape(self, i: int) -> ShapeFile:
        return ShapeFile(self.directory / self.records[i].file)

    @property
    def categories(self) -> list[str]:
        return sorted({record.category for record in self.records})


class Index(NamedTuple):
    """The contents of `dataset.json`."""

    seed: int
    parameters: dict[str, Any]
    shapes: list[ShapeRecord]
    failures: list[dict[str, str]]


def read_index(directory: str | os.PathLike[str]) -> Index:
    """Reads and checks `dataset.json`."""
    path = Path(directory) / INDEX
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileNotFoundError(f"{directory} is not a data set: no {INDEX} in it") from None
    except ValueError as error:
        raise ValueError(f"{path}: not JSON ({error})") from error
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise ValueError(f"{path}: format should be {FORMAT!r}")
    if said.get("version") != VERSION:
        raise ValueError(f"{path}: version should be {VERSION}, got {said.get('version')!r}")
    try:
        shapes = [ShapeRecord(**shape) for shape in said["shapes"]]
        for shape in shapes:
            # A data set from elsewhere may name files of its own folder only.
            if not is_below(shape.file):
                raise ValueError(f"{path}: the file of {shape.id} should lie in the data set, got {shape.file!r}")
        return Index(said["seed"], said["parameters"], shapes, said["failures"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"{path}: an entry is missing or unknown ({error})") from error


def is_below(file: str) -> bool:
    """Whether a relative path stays below its folder, on any system."""
    return not (PureWindowsPath(file).anchor or ".." in PureWindowsPath(file).parts)


def write_index(directory: str | os.PathLike[str], index: Index) -> None:
    """Writes `dataset.json`, shapes sorted by id, with the counts of each category and split."""
    shapes = sorted(index.shapes, key=lambda record: record.id)
    counts: dict[str, dict[str, int]] = {}
    for record in shapes:
        of_category = counts.setdefault(record.category, dict.fromkeys(SPLITS, 0))
        of_category[record.split] += 1
    said = {
        "format": FORMAT,
        "version": VERSION,
        "seed": index.seed,
        "parameters": index.parameters,
        "shapes": [record._asdict() for record in shapes],
        "failures": sorted(index.failures, key=lambda failure: failure["id"]),
        "counts": dict(sorted(counts.items())),
    }
    replace(Path(directory) / INDEX, (json.dumps(said, indent=1) + "\n").encode())


def write_shape(path: str | os.PathLike[str], tensors: Mapping[str, NDArray[Any]], metadata: Mapping[str, str]) -> str:
    """Writes one shape file whole or not at all; returns the SHA-256 of its bytes.

    The safetensors library orders metadata at random; here the same contents give the same bytes.

    Raises:
        ValueError: a tensor of the format is missing, unknown, or has another type or number of columns.
    """
    if set(tensors) != set(TENSORS):
        wrong = ", ".join(sorted(set(tensors) ^ set(TENSORS)))
        raise ValueError(f"tensors should be the {len(TENSORS)} of the format, missing or unknown: {wrong}")
    header: dict[str, Any] = {"__metadata__": dict(sorted(metadata.items()))}
    blocks = []
    position = 0
    # Wide types first, so that every tensor starts at a multiple of its item size.
    for name in sorted(TENSORS, key=lambda name: -np.dtype(_DTYPES[TENSORS[name][0]]).itemsize):
        kind, columns = TENSORS[name]
        array = np.ascontiguousarray(tensors[name])
        if array.dtype != _DTYPES[kind] or (columns is not None and array.shape[-1:] != (columns,)):
            raise ValueError(f"{name} should be {kind} (..., {columns}), got {array.dtype} {array.shape}")
        block = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        header[name] = {"dtype": kind, "shape": list(array.shape), "data_offsets": [position, position + len(block)]}
        blocks.append(block)
        position += len(block)
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    data = b"".join([len(text).to_bytes(8, "little"), text, *blocks])
    replace(Path(path), data)
    return hashlib.sha256(data).hexdigest()


def replace(path: Path, data: bytes) -> None:
    """Writes a file whole or not at all; makes its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(path, force=True) as temporary:
        temporary.write_bytes(data)


def sha256_of(path: str | os.PathLike[str]) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def verify(directory: str | os.PathLike[str]) -> list[str]:
    """What is wrong with a data set, one line each; empty when every file is there and matches its checksum."""
    directory = Path(directory)
    index = read_index(directory)
    wrong = []
    for record in index.shapes:
        path = directory / record.file
        if not path.is_file():
            wrong.append(f"{record.id}: {record.file} is missing")
        elif sha256_of(path) != record.sha256:
            wrong.append(f"{record.id}: {record.file} does not match its checksum")
        elif record.split not in SPLITS:
            wrong.append(f"{record.id}: split {record.split!r} is not one of {', '.join(SPLITS)}")
    wrong += [f"{i}: listed more than once" for i in _repeated(record.id for record in index.shapes)]
    listed = {record.file for record in index.shapes}
    for path in sorted((directory / "shapes").rglob("*")):
        file = path.relative_to(directory).as_posix()
        if path.is_file() and file not in listed:
            wrong.append(f"{file}: not in {INDEX}")
    return wrong


def _repeated(values: Iterable[str]) -> list[str]:
    seen: set[str] = set()
    return sorted({value for value in values if value in seen or seen.add(value)})
