"""From meshes to a data set directory: close, normalise, sample, label, touch, write; in parallel and resumable."""

import hashlib
import json
import math
import re
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import joblib
import numpy as np
import safetensors
import trimesh
from numpy.typing import NDArray
from tqdm import tqdm

from touchnet.data.dataset import (
    INDEX,
    SPLITS,
    TENSORS,
    Index,
    ShapeFile,
    ShapeRecord,
    TouchDataset,
    read_index,
    sha256_of,
    write_index,
    write_shape,
)
from touchnet.data.exploration import Surface, simulate_touches
from touchnet.data.occupancy import label_box, label_near, sample_surface
from touchnet.data.watertight import METHODS, inspect_mesh, make_watertight

# Part of every shape's fingerprint: raised when the same parameters come to mean other contents.
RECIPE = 2


@dataclass(frozen=True)
class Parameters:
    """What a shape's file holds, apart from the mesh itself. Lengths are shares of the longest side."""

    trajectories: int = 4
    """Touching trajectories of each shape (T)."""
    touches: int = 2048
    """Contacts of a trajectory (N)."""
    near: int = 65536
    """Labelled points near the surface (P)."""
    box: int = 32768
    """Labelled points uniform in the bounding box (Q)."""
    surface: int = 16384
    """Surface samples with normals (S)."""
    sigmas: tuple[float, ...] = (0.01, 0.05)
    """Standard deviations of the displacement of the near points."""
    method: str = "auto"
    """How open meshes are closed: auto, manifold, closing or alpha_wrap (needs pymeshlab)."""
    resolution: int = 20000
    """Of the manifold method: about the number of leaves of its octree."""
    offset: float = 0.0025
    """Distance of a closed surface from the open mesh it was made of."""

    def __post_init__(self) -> None:
        for name in ("trajectories", "near", "box", "surface"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} should be ≥ 0, got {getattr(self, name)}")
        if not 1 <= self.touches <= 32767:  # strokes are counted in 16 bits
            raise ValueError(f"touches should be between 1 and 32767, got {self.touches}")
        if not self.sigmas or not all(0 < sigma < math.inf for sigma in self.sigmas):
            raise ValueError(f"sigmas should be positive numbers, got {self.sigmas}")
        if not 0 < self.offset < 0.1:
            raise ValueError(f"offset should be between 0 and 0.1 of the longest side, got {self.offset}")
        if self.method not in METHODS:
            raise ValueError(f"method should be one of {', '.join(METHODS)}, got {self.method!r}")
        if self.resolution < 100:
            raise ValueError(f"resolution should be ≥ 100, got {self.resolution}")

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "sigmas": list(self.sigmas)}


class MeshSource(NamedTuple):
    """Where a shape comes from. `load` must be picklable and return the mesh; `stamp` changes when the mesh does."""

    id: str
    split: str
    load: Callable[[], trimesh.Trimesh]
    stamp: str
    source: str = "unknown"
    licence: str = "unknown"

    @property
    def category(self) -> str:
        return self.id.split("/", 1)[0]


class Failure(NamedTuple):
    id: str
    reason: str


def build(
    sources: Sequence[MeshSource],
    directory: str | Path,
    parameters: Parameters | None = None,
    *,
    seed: int = 0,
    jobs: int = 1,
    overwrite: bool = False,
    progress: bool = True,
) -> TouchDataset:
    """Makes a data set of the sources in `directory`, or completes one that was begun there.

    Shapes already there with the same seed, parameters and stamp are kept, so a run that was killed goes on where it
    was; `dataset.json` is brought up to date every few seconds, so others may read while the run goes on. The train
    split comes first, in an order mixed over the categories. Shapes that only lack trajectories get the missing ones,
    and are listed with those they have until then. A
    mesh that cannot be used is listed under failures with the reason, and skipped. Bytes depend on the seed, parameters
    and mesh alone, never on `jobs`.

    Parallel work goes through joblib, so a backend chosen by `joblib.parallel_config` takes over.

    Args:
        jobs: worker processes; -1: one a core. (A backend chosen by `joblib.parallel_config` brings its own count.)
        overwrite: replace a data set made with another seed or other parameters.

    Raises:
        ValueError: an id is used twice, a split is unknown, or the directory holds another data set.
    """
    parameters = parameters or Parameters()
    directory = Path(directory)
    _check(sources)
    directory.mkdir(parents=True, exist_ok=True)
    for half in (*directory.glob(".*.part*"), *(directory / "shapes").rglob(".*.part*")):
        half.unlink(missing_ok=True)  # left by a run that was killed
    kept = _existing(directory, parameters, seed, overwrite)
    prints = {source.id: fingerprint(source, parameters, seed) for source in sources}
    done: dict[str, ShapeRecord] = {record.id: record for record in kept if record.id not in prints}
    todo = []
    for source in sources:
        record = _finished(directory, source, prints[source.id])
        if record:
            done[source.id] = record
            continue
        todo.append(source)
        file = _file(source)
        if _has_fewer(directory / file, source, parameters, seed) is not None:  # good for readers as it is
            done[source.id] = _record(source, file, sha256_of(directory / file))
    todo.sort(key=lambda source: (SPLITS.index(source.split), _hash(source.id)))
    failures: list[Failure] = []

    def save() -> None:
        write_index(
            directory, Index(seed, parameters.as_json(), list(done.values()), [one._asdict() for one in failures])
        )

    save()
    last = time.monotonic()
    try:
        with tqdm(total=len(sources), initial=len(sources) - len(todo), unit="shape", disable=not progress) as bar:
            for outcome in _outcomes(todo, directory, parameters, seed, prints, jobs):
                if isinstance(outcome, Failure):
                    done.pop(outcome.id, None)
                    failures.append(outcome)
                    tqdm.write(f"skipped {outcome.id}: {outcome.reason}")
                else:
                    done[outcome.id] = outcome
                bar.update()
                if time.monotonic() - last > 3:
                    save()
                    last = time.monotonic()
    finally:
        save()
    return TouchDataset(directory)


def make_shape(source: MeshSource, parameters: Parameters, seed: int) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """The tensors and the metadata of one shape's file.

    Raises:
        ValueError: the mesh cannot be read, closed or labelled.
    """
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        closed = make_watertight(
            source.load(), method=parameters.method, resolution=parameters.resolution, offset=parameters.offset
        )
    how = closed.metadata["closed_by"]
    low, high = closed.bounds
    centre, scale = (low + high) / 2, float((high - low).max())
    # Everything below is computed on the rounded mesh that is stored, so labels and contacts fit it exactly.
    vertices = ((closed.vertices - centre) / scale).astype(np.float32)
    mesh = trimesh.Trimesh(vertices.astype(np.float64), closed.faces, process=False)
    report = inspect_mesh(mesh)
    if not report.closed or report.volume <= 0:
        raise ValueError(f"the closed mesh ({how}) has {report.open_edges} open edges and volume {report.volume:.3g}")

    surface_seed, near_seed, box_seed = _seeds(source, seed, 3)
    surface = sample_surface(mesh, parameters.surface, np.random.default_rng(surface_seed))
    near = label_near(mesh, parameters.near, np.random.default_rng(near_seed), sigmas=parameters.sigmas)
    box = label_box(mesh, parameters.box, np.random.default_rng(box_seed))
    tensors = {
        "vertices": vertices,
        "faces": np.asarray(closed.faces, dtype=np.int32),
        **_touch(mesh, source, parameters, seed, 0),
        "near": near.points,
        "near_inside": np.packbits(near.inside),
        "box": box.points,
        "box_inside": np.packbits(box.inside),
        "surface": surface.points.astype(np.float32),
        "surface_normals": surface.normals.astype(np.float16),
    }
    metadata = {
        "id": source.id,
        "category": source.category,
        "centre": json.dumps([float(x) for x in centre]),
        "scale": repr(scale),
        "closed_by": how,
        "hollow": repr(float(closed.metadata["hollow"])),
        "thin": f"{report.thin:.3f}",
        "simple": str(report.simple).lower(),
        "volume": f"{report.volume:.6g}",
        "near_inside": str(int(near.inside.sum())),
        "box_inside": str(int(box.inside.sum())),
        "notes": "; ".join(str(one.message) for one in said),
    }
    return tensors, metadata


def _seeds(source: MeshSource, seed: int, count: int) -> list[np.random.SeedSequence]:
    """The first `count` streams of random numbers of a shape: surface, near, box, then one a trajectory."""
    return np.random.SeedSequence([seed, _hash(source.id)]).spawn(count)


def _touch(
    mesh: trimesh.Trimesh, source: MeshSource, parameters: Parameters, seed: int, first: int
) -> dict[str, NDArray[Any]]:
    """The tensors of the trajectories from number `first` on."""
    streams = _seeds(source, seed, 3 + parameters.trajectories)[3 + first :]
    surface = Surface(mesh)
    runs = [
        simulate_touches(surface, parameters.touches, seed=int(stream.generate_state(1, np.uint64)[0]) >> 1)
        for stream in streams
    ]
    shape = (len(runs), parameters.touches)
    return {
        "touches": np.array([run.points for run in runs], dtype=np.float32).reshape(*shape, 3),
        "touch_normals": np.array([run.normals for run in runs], dtype=np.float16).reshape(*shape, 3),
        "strokes": np.array([run.strokes for run in runs], dtype=np.int16).reshape(shape),
        "variance": np.array([run.variance for run in runs], dtype=np.float32).reshape(shape),
    }


def _begun(
    path: Path, source: MeshSource, parameters: Parameters, seed: int
) -> tuple[dict[str, NDArray[Any]], dict[str, str]] | None:
    """The shape that lies at `path` with the trajectories it lacks added, if it is the same in all else."""
    found = _has_fewer(path, source, parameters, seed)
    if found is None:
        return None
    file = ShapeFile(path)
    try:
        with safetensors.safe_open(path, framework="numpy") as opened:
            metadata = dict(opened.metadata() or {})
        tensors = {name: file.array(name) for name in TENSORS}
    except (OSError, ValueError):
        return None
    for name, more in _touch(file.mesh(), source, parameters, seed, found).items():
        tensors[name] = np.concatenate([tensors[name], more])
    return tensors, metadata


def _has_fewer(path: Path, source: MeshSource, parameters: Parameters, seed: int) -> int | None:
    """How many trajectories the shape at `path` has, if it lacks some and is what is wanted in all else."""
    try:
        file = ShapeFile(path)
        found = file.shape("touches")[0]
        same = fingerprint(source, replace(parameters, trajectories=found), seed)
        return found if found < parameters.trajectories and file.metadata.get("fingerprint") == same else None
    except (OSError, ValueError, KeyError):
        return None


def fingerprint(source: MeshSource, parameters: Parameters, seed: int) -> str:
    """What a finished file must carry to be kept."""
    said = [RECIPE, source.id, source.stamp, seed, parameters.as_json()]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def shape_id(category: str, name: str) -> str:
    """ "category/name" with characters that are safe in file names everywhere."""
    safe = (re.sub(r"[^A-Za-z0-9._+-]+", "-", part).strip(".-") for part in (category, name))
    category, name = safe
    if not category or not name:
        raise ValueError(f"a shape needs a category and a name, got {category!r} and {name!r}")
    return f"{category}/{name}"


def _check(sources: Sequence[MeshSource]) -> None:
    seen: dict[str, str] = {}
    for source in sources:
        if source.split not in SPLITS:
            raise ValueError(f"{source.id}: split should be one of {', '.join(SPLITS)}, got {source.split!r}")
        # Windows and macOS do not tell upper case from lower case in file names.
        if source.id.lower() in seen:
            raise ValueError(f"two shapes would be called {seen[source.id.lower()]} and {source.id}")
        seen[source.id.lower()] = source.id


def _existing(directory: Path, parameters: Parameters, seed: int, overwrite: bool) -> list[ShapeRecord]:
    """The shapes listed in a data set that may be completed; those of one to be replaced are removed."""
    if not (directory / INDEX).exists():
        return []
    index = read_index(directory)
    wanted = parameters.as_json()
    found = index.parameters
    other = [
        f"{k} {found.get(k)}, not {v}"
        for k, v in wanted.items()
        if found.get(k) != v and not _fewer(k, found.get(k), v)
    ]
    if index.seed != seed:
        other.append(f"seed {index.seed}, not {seed}")
    if not other:
        return [record for record in index.shapes if (directory / record.file).is_file()]
    if not overwrite:
        raise ValueError(
            f"{directory} holds a data set made with {'; '.join(other)}: choose another folder or overwrite"
        )
    for record in index.shapes:
        (directory / record.file).unlink(missing_ok=True)
    return []


def _fewer(name: str, found: Any, wanted: Any) -> bool:
    """Whether all that lacks is trajectories, which can be added."""
    return name == "trajectories" and isinstance(found, int) and found < wanted


def _finished(directory: Path, source: MeshSource, wanted: str) -> ShapeRecord | None:
    file = _file(source)
    path = directory / file
    if not path.is_file():
        return None
    try:
        found = ShapeFile(path).metadata.get("fingerprint")
    except (ValueError, KeyError):
        return None
    return _record(source, file, sha256_of(path)) if found == wanted else None


def _file(source: MeshSource) -> str:
    return f"shapes/{source.id}.safetensors"


def _record(source: MeshSource, file: str, checksum: str) -> ShapeRecord:
    return ShapeRecord(source.id, source.category, source.split, source.source, source.licence, file, checksum)


def _outcomes(
    todo: Sequence[MeshSource], directory: Path, parameters: Parameters, seed: int, prints: dict[str, str], jobs: int
) -> Iterator[ShapeRecord | Failure]:
    workers = None if jobs == 1 else jobs  # None: what joblib.parallel_config says, 1 otherwise
    if joblib.effective_n_jobs(workers) == 1:
        yield from (_make(source, directory, parameters, seed, prints[source.id]) for source in todo)
        return
    parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", batch_size=1)
    yield from parallel(
        joblib.delayed(_make)(source, directory, parameters, seed, prints[source.id]) for source in todo
    )


def _make(source: MeshSource, directory: Path, parameters: Parameters, seed: int, wanted: str) -> ShapeRecord | Failure:
    try:
        path = directory / _file(source)
        tensors, metadata = _begun(path, source, parameters, seed) or make_shape(source, parameters, seed)
    except (ValueError, OSError, MemoryError, ArithmeticError, LookupError) as error:
        return Failure(source.id, " ".join(f"{error or type(error).__name__}".split()))
    checksum = write_shape(path, tensors, {**metadata, "fingerprint": wanted})
    return _record(source, _file(source), checksum)


def _hash(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
