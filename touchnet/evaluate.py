"""`touchnet evaluate`: reconstructions from the touches of a data set against its true shapes, beside baselines."""

import csv
import dataclasses
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
import trimesh
import tyro
from numpy.typing import NDArray
from tqdm import tqdm

from touchnet import cli, outputs
from touchnet.baselines import convex_hull, screened_poisson
from touchnet.data.dataset import INDEX, ShapeFile, TouchDataset
from touchnet.data.samples import contact_rows
from touchnet.metrics import DEFINITIONS, THRESHOLDS, PaperTruth, SurfaceTruth, inside_mesh, surface_keys

PAPER_SAMPLES = 4096  # of each kind (each sigma of `near`, and `box`) in the protocol `paper`
PAPER_COUNT = 2048
PAPER_THRESHOLD = 0.01
TILE = 224  # pixels
RESAMPLES = 1000
INTERVAL = 0.95

PROTOCOLS = {
    "surface": "the output mesh against the true mesh, by exact distances of surface samples to the other mesh and by "
    "volume",
    "paper": f"the points inside the output mesh against the points inside the true one, among common samples "
    f"({PAPER_SAMPLES} of each kind that the data set stores), thinned to {PAPER_COUNT} by farthest points; F-score at "
    f"{PAPER_THRESHOLD:g}",
}
TRUTH = "truth, resampled"  # the row that shows what each protocol's sampling lets a perfect method reach


@dataclasses.dataclass
class EvaluateConfig:
    """Reconstructs the touches of a data set and measures the results against its true shapes.

    Writes results.csv (one line a reconstruction), summary.csv, report.json, gallery.png into the output folder and
    prints tables. Two protocols stand side by side and are never mixed; the report defines every measure.
    """

    data: tyro.conf.Positional[Path]
    """Data set directory."""
    weights: str = "default"
    """Weights of the model: a file, or the name of those in the package."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("evaluation")
    """Folder for the results."""
    methods: tuple[Literal["model", "convex_hull", "poisson", "all"], ...] = ("model", "convex_hull")
    """What to evaluate; poisson needs pymeshlab."""
    split: Literal["train", "val", "test", "all"] = "test"
    """Which shapes."""
    categories: tuple[str, ...] = ()
    """Only these categories."""
    limit: int | None = None
    """At most this many shapes a category: a quick look."""
    trajectories: int | None = None
    """At most this many trajectories a shape; all of them by default."""
    contacts: tuple[int, ...] = (128, 512, 2048)
    """Numbers of contacts."""
    take: Literal["spread", "first"] = "spread"
    """Which n contacts of a trajectory: spread evenly along it (a probe that reports less often), or the first n (an
    exploration under way, which has not seen all sides yet)."""
    normals: Literal["both", "with", "without"] = "both"
    """Whether methods that can do without contact normals get them."""
    protocols: tuple[Literal["surface", "paper"], ...] = ("surface", "paper")
    """What to measure."""
    resolution: int = 128
    """Cells along the longest side in the model's extraction."""
    samples: int = 100_000
    """Points on each surface whose distances are averaged."""
    gallery: int = 2
    """Shapes a category in the picture; 0: no picture."""
    jobs: int = 1
    """Processes; each works on one shape at a time."""
    device: str = "auto"
    """Where the model runs: auto, cpu or cuda."""
    seed: int = 0
    """Of samples and bootstrap."""
    resume: bool = False
    """Go on with what the output folder already holds."""
    force: bool = False
    """Replace what the output folder already holds."""


# ---- methods ---------------------------------------------------------------------------------------------------------


class Method(NamedTuple):
    """One way from touches to a mesh."""

    run: Callable[[NDArray[np.float64], NDArray[np.float64] | None, EvaluateConfig], trimesh.Trimesh]
    normals: tuple[bool, ...]  # runs with contact normals, without, or either


def _run_model(
    touches: NDArray[np.float64], normals: NDArray[np.float64] | None, config: EvaluateConfig
) -> trimesh.Trimesh:
    from touchnet.reconstruction import reconstruct_mesh

    return reconstruct_mesh(
        touches,
        normals=normals,
        weights=_model(config.weights),
        resolution=config.resolution,
        device=config.device,
    )


METHODS = {
    "model": Method(_run_model, (True, False)),
    "convex_hull": Method(lambda touches, normals, config: convex_hull(touches), (False,)),
    "poisson": Method(lambda touches, normals, config: screened_poisson(touches, normals), (True,)),
}


@functools.lru_cache(maxsize=1)
def _model(weights: str) -> torch.nn.Module:
    from touchnet.weights import load_model

    return load_model(weights)


def _weights_digest(weights: str) -> str:
    digest = hashlib.sha256()
    for name, tensor in sorted(_model(weights).state_dict().items()):
        digest.update(name.encode() + tensor.contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


# ---- one shape -------------------------------------------------------------------------------------------------------


class Task(NamedTuple):
    """One reconstruction; `contacts` and `trajectory` are 0 for the truth itself."""

    method: str
    trajectory: int
    contacts: int
    normals: bool


def tasks_of(config: EvaluateConfig, trajectories: int) -> list[Task]:
    """All that is asked of a shape with that many stored trajectories."""
    asked = {"both": (True, False), "with": (True,), "without": (False,)}[config.normals]
    used = trajectories if config.trajectories is None else min(trajectories, config.trajectories)
    tasks = [Task(TRUTH, 0, 0, False)]
    for name in config.methods:
        able = METHODS[name].normals
        # A method without the choice runs its one way whatever was asked of those that have it.
        ways = [way for way in able if way in asked] if len(able) > 1 else able
        tasks += [Task(name, k, n, way) for k in range(used) for n in config.contacts for way in ways]
    return tasks


def result_keys(config: EvaluateConfig) -> list[str]:
    """Names of the measured columns."""
    keys = ["seconds", "faces"]
    if "surface" in config.protocols:
        keys += surface_keys(THRESHOLDS)
    if "paper" in config.protocols:
        keys += ["paper_chamfer", "paper_f_score", "paper_empty"]
    return keys


def evaluate_shape(
    config: EvaluateConfig, index: int, tasks: Sequence[Task], picture: Path | None
) -> list[dict[str, Any]]:
    """Reconstructs and measures the tasks of one shape; draws its row of the gallery if a path is given.

    A method that finds no surface (raises ValueError) gives an empty result with the reason in `note`.
    """
    if config.jobs > 1:
        torch.set_num_threads(1)
    data = _data(config)
    record, shape = data.records[index], data.shape(index)
    mesh = shape.mesh()
    try:
        truth = SurfaceTruth(mesh, samples=config.samples, seed=config.seed)
    except ValueError as error:
        raise ValueError(f"{record.id}: {error}") from None
    paper = (
        _paper_truth(shape, len(data.parameters.get("sigmas", (0.01, 0.05)))) if "paper" in config.protocols else None
    )
    touches = shape.array("touches").astype(np.float64)  # (T, N, 3)
    normals = shape.array("touch_normals").astype(np.float64)

    rows, drawn = [], {}
    for task in tasks:
        notes, seconds = [], 0.0
        if task.method == TRUTH:
            result: trimesh.Trimesh | None = mesh
        else:
            chosen = contact_rows(touches.shape[1], task.contacts, config.take)
            some = touches[task.trajectory, chosen]
            directions = normals[task.trajectory, chosen] if task.normals else None
            start = time.perf_counter()
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    result = METHODS[task.method].run(some, directions, config)
                except ValueError as error:
                    result = None
                    notes.append(str(error))
            seconds = time.perf_counter() - start
            notes += sorted({str(warning.message) for warning in caught})
        row: dict[str, Any] = {"shape": record.id, "category": record.category, **task._asdict()}
        row |= {"seconds": seconds, "faces": 0 if result is None else len(result.faces)}
        if "surface" in config.protocols:
            row |= truth.scores(result)
        if paper is not None:
            scores = paper.scores(None if result is None else inside_mesh(paper.samples, result))
            row |= {f"paper_{name}": value for name, value in scores.items()}
        row["note"] = "; ".join(" ".join(note.split()) for note in notes)
        rows.append(row)
        if _is_drawn(config, task):
            drawn[task.method, task.normals] = result
    if picture is not None:
        shown = contact_rows(touches.shape[1], max(config.contacts), config.take)
        _draw(picture, touches[0, shown] if len(touches) else touches.reshape(-1, 3), drawn, mesh)
    return rows


@functools.lru_cache(maxsize=1)
def _opened(directory: Path, split: str | None, categories: tuple[str, ...]) -> TouchDataset:
    return TouchDataset(directory, split, categories=categories or None)


def _data(config: EvaluateConfig) -> TouchDataset:
    return _opened(config.data, None if config.split == "all" else config.split, config.categories)


def _paper_truth(shape: ShapeFile, kinds: int) -> PaperTruth:
    """The common samples: the first points of each displacement of `near`, and of `box`."""
    near, near_inside = shape.array("near"), shape.inside("near")
    share = len(near) // kinds
    first = np.concatenate([np.arange(k * share, k * share + min(PAPER_SAMPLES, share)) for k in range(kinds)])
    samples = np.concatenate([near[first], shape.rows("box", 0, PAPER_SAMPLES)])
    inside = np.concatenate([near_inside[first], shape.inside("box")[:PAPER_SAMPLES]])
    return PaperTruth(samples, inside, count=PAPER_COUNT, threshold=PAPER_THRESHOLD)


def _draw(
    path: Path,
    touches: NDArray[np.float64],
    drawn: dict[tuple[str, bool], trimesh.Trimesh | None],
    truth: trimesh.Trimesh,
) -> None:
    """One shape's tiles side by side, with their names in the file; `save_gallery` puts them into the sheet."""
    from PIL import Image, PngImagePlugin

    from touchnet.figures import draw_row

    tiles = draw_row([touches, *drawn.values(), truth], size=TILE)
    said = PngImagePlugin.PngInfo()
    said.add_text("titles", json.dumps([f"{len(touches)} touches", *(_label(*key) for key in drawn), "truth"]))
    blank = np.full((TILE, TILE, 3), 255, dtype=np.uint8)
    strip = Image.fromarray(np.concatenate([blank if tile is None else tile for tile in tiles], axis=1))
    with outputs.atomic_output(path, force=True) as temporary:
        strip.save(temporary, format="PNG", pnginfo=said)


def _label(method: str, normals: bool) -> str:
    if method == TRUTH or len(METHODS[method].normals) == 1:
        return method.replace("_", " ")
    return f"{method}, {'with' if normals else 'no'} normals"


# ---- all shapes, resumable -------------------------------------------------------------------------------------------


def collect(config: EvaluateConfig, settings: dict[str, Any], weights: str, progress: Path) -> list[dict[str, Any]]:
    """Evaluates what `progress` does not hold yet; appends each finished shape there.

    Args:
        config: what is asked.
        settings: what the results depend on besides their own columns; those of `progress` must be the same.
        weights: digest of the model's; results of others are not taken over.
        progress: the file, one JSON object a line: the settings, then the results.
    """
    data = _data(config)
    rows = _read_progress(progress, settings) if config.resume and progress.exists() else []
    rows = [row for row in rows if row["weights"] in ("", weights)]
    done = {_key(row) for row in rows}
    pictured: dict[str, int] = {}
    used: dict[str, int] = {}
    jobs = []
    asked = set()
    for index, record in enumerate(data.records):
        used[record.category] = used.get(record.category, 0) + 1
        if config.limit is not None and used[record.category] > config.limit:
            continue
        stored = data.shape(index).shape("touches")
        if stored[0] and max(config.contacts) > stored[1]:
            raise ValueError(
                f"contacts must be at most {stored[1]}, which the data set stores, got {max(config.contacts)}"
            )
        tasks = tasks_of(config, stored[0])
        asked |= {(record.id, *task) for task in tasks}
        missing = [task for task in tasks if (record.id, *task) not in done]
        picture = None
        if pictured.get(record.category, 0) < config.gallery and stored[0]:
            pictured[record.category] = pictured.get(record.category, 0) + 1
            picture = _strip(config, record.id)
        if missing and picture:  # the row of the gallery needs all of its meshes, also those measured already
            missing += [task for task in tasks if _is_drawn(config, task) and task not in missing]
        if missing:
            jobs.append((index, missing, picture))
    new = not progress.exists() or not config.resume
    with progress.open("w" if new else "a", encoding="utf-8") as log:
        if new:
            log.write(json.dumps(settings) + "\n")
        with tqdm(total=len(asked), initial=len(asked & done), unit="mesh", desc="evaluate") as bar:
            for finished in _in_processes(config, jobs):
                finished = [row for row in finished if _key(row) not in done]
                for row in finished:
                    row["weights"] = weights if row["method"] == "model" else ""
                log.writelines(json.dumps(row) + "\n" for row in finished)
                log.flush()
                rows += finished
                bar.update(len(finished))
    # In a fixed order, and without what an earlier run had measured beyond today's question.
    rows = [row for row in rows if _key(row) in asked]
    return sorted(
        rows, key=lambda row: (row["shape"], row["method"], row["contacts"], row["normals"], row["trajectory"])
    )


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return (row["shape"], *(row[name] for name in Task._fields))


def _is_drawn(config: EvaluateConfig, task: Task) -> bool:
    return task.method != TRUTH and task.trajectory == 0 and task.contacts == max(config.contacts)


def _in_processes(
    config: EvaluateConfig, jobs: list[tuple[int, list[Task], Path | None]]
) -> Iterator[list[dict[str, Any]]]:
    if config.jobs == 1:
        yield from (evaluate_shape(config, *job) for job in jobs)
        return
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=config.jobs, return_as="generator_unordered", pre_dispatch="n_jobs", batch_size=1)
    yield from parallel(delayed(evaluate_shape)(config, *job) for job in jobs)


def _read_progress(path: Path, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of an earlier run; a last line cut off by a kill is removed from the file."""
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        with outputs.atomic_output(path, force=True) as temporary:
            temporary.write_text(whole, encoding="utf-8")
    try:
        first, *rows = [json.loads(line) for line in whole.splitlines()] or [None]
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}); --force starts anew") from None
    if first != settings:
        changed = sorted(name for name in {*settings, *(first or {})} if (first or {}).get(name) != settings.get(name))
        raise ValueError(f"{path} was written with another {', '.join(changed)}; --force starts anew")
    return rows


# ---- summary ---------------------------------------------------------------------------------------------------------


class Summary(NamedTuple):
    """A measure of a method: mean over the trajectories of a shape, then over shapes, then over categories."""

    method: str
    contacts: int
    normals: bool
    category: str  # or "mean"
    measure: str
    value: float | None  # None: every result was empty and the measure infinite
    low: float | None  # bootstrap interval over shapes; None for a single shape
    high: float | None
    shapes: int
    results: int
    empty: int


def summarise(rows: Sequence[dict[str, Any]], measures: Iterable[str], *, seed: int) -> list[Summary]:
    """Means and bootstrap intervals over shapes, per category and over categories with equal weight.

    Infinite values (empty results) are left out of the means of distances; `empty` counts them.
    """
    groups: dict[tuple[str, int, bool], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["method"], row["contacts"], row["normals"]), []).append(row)
    summaries = []
    for (method, contacts, normals), group in groups.items():
        categories = sorted({row["category"] for row in group})
        for measure in measures:
            # The same resamples for every method and measure, so their intervals can be compared.
            generator = np.random.default_rng(seed)
            empty_key = "paper_empty" if measure.startswith("paper_") else "empty"
            values, spreads = [], []
            for category in categories:
                own = [row for row in group if row["category"] == category]
                by_shape: dict[str, list[float]] = {}
                for row in own:
                    by_shape.setdefault(row["shape"], []).append(row[measure])
                means = np.array([_finite_mean(np.array(measured)) for measured in by_shape.values()])
                values.append(_finite_mean(means))
                spreads.append(_finite_mean(means[generator.integers(len(means), size=(RESAMPLES, len(means)))]))
                counts = len(means), len(own), sum(int(row.get(empty_key, 0)) for row in own)
                bounds = _interval(spreads[-1], len(means))
                summaries.append(
                    Summary(method, contacts, normals, category, measure, _or_none(values[-1]), *bounds, *counts)
                )
            shapes = len({row["shape"] for row in group})
            counts = shapes, len(group), sum(int(row.get(empty_key, 0)) for row in group)
            # One shape a category has no spread to resample.
            bounds = _interval(_finite_mean(np.stack(spreads, axis=1)), shapes if shapes > len(categories) else 1)
            value = _or_none(_finite_mean(np.array(values)))
            summaries.append(Summary(method, contacts, normals, "mean", measure, value, *bounds, *counts))
    return summaries


def _finite_mean(values: NDArray[np.float64]) -> Any:
    """Mean over the last axis of what is finite; NaN where nothing is."""
    finite = np.isfinite(values)
    count = finite.sum(axis=-1)
    return np.where(count, np.where(finite, values, 0).sum(axis=-1) / np.maximum(count, 1), np.nan)


def _interval(means: NDArray[np.float64], shapes: int) -> tuple[float | None, float | None]:
    means = means[np.isfinite(means)]
    if shapes < 2 or not len(means):
        return None, None
    low, high = np.quantile(means, [(1 - INTERVAL) / 2, (1 + INTERVAL) / 2])
    return float(low), float(high)


def _or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# ---- report ----------------------------------------------------------------------------------------------------------

COLUMNS = {  # measure -> heading, factor, digits
    "iou": ("IoU", 1, 3),
    "f_score_0.005": ("F 0.5%", 1, 3),
    "f_score_0.01": ("F 1%", 1, 3),
    "f_score_0.02": ("F 2%", 1, 3),
    "chamfer_l1": ("CD-L1 %", 100, 3),
    "chamfer": ("CD x1e4", 1e4, 3),
    "hausdorff_95": ("H95 %", 100, 2),
    "normal_consistency": ("NC", 1, 3),
    "watertight": ("closed", 1, 3),
    "seconds": ("seconds", 1, 2),
    "paper_f_score": ("F 1%", 1, 3),
    "paper_chamfer": ("CD x1e4", 1e4, 2),
}


def tables(summaries: Sequence[Summary], protocols: Sequence[str]) -> str:
    """The summary as text: IoU by category, the other measures averaged over categories, and the paper's protocol."""
    cell = {(s.method, s.contacts, s.normals, s.category, s.measure): s for s in summaries}
    settings = list(dict.fromkeys((s.method, s.contacts, s.normals) for s in summaries))
    settings.sort(key=lambda setting: (setting[1], setting[0] == TRUTH, setting[0], not setting[2]))
    categories = list(dict.fromkeys(s.category for s in summaries if s.category != "mean"))
    blocks = []
    if "surface" in protocols:
        blocks += [
            _by_category("IoU by category (protocol surface)", cell, settings, categories, "iou"),
            _by_measure("protocol surface, mean over categories", cell, settings, "iou"),
        ]
    if "paper" in protocols:
        blocks += [
            _by_category("F-score at 1 % by category (protocol paper)", cell, settings, categories, "paper_f_score"),
            _by_category(
                "Chamfer distance x 1e4 by category (protocol paper)", cell, settings, categories, "paper_chamfer"
            ),
        ]
    return "\n\n".join(blocks)


Setting = tuple[str, int, bool]
Cells = dict[tuple[str, int, bool, str, str], Summary]


def _by_category(title: str, cell: Cells, settings: list[Setting], categories: list[str], measure: str) -> str:
    header = ["contacts", "method", *categories, "mean", "95% interval", "empty"]
    lines = []
    for setting in settings:
        mean = cell[(*setting, "mean", measure)]
        values = [_number(cell.get((*setting, category, measure)), measure) for category in [*categories, "mean"]]
        interval = "" if mean.low is None else f"{_scaled(mean.low, measure)}-{_scaled(mean.high, measure)}"
        lines.append([*_heads(setting), *values, interval, f"{mean.empty}/{mean.results}"])
    return _aligned(title, header, lines)


def _by_measure(title: str, cell: Cells, settings: list[Setting], first: str) -> str:
    measures = [name for name in COLUMNS if not name.startswith("paper_") and (*settings[0], "mean", name) in cell]
    header = ["contacts", "method", *(COLUMNS[name][0] for name in measures), "empty"]
    lines = []
    for setting in settings:
        mean = cell[(*setting, "mean", first)]
        values = [_number(cell[(*setting, "mean", name)], name) for name in measures]
        lines.append([*_heads(setting), *values, f"{mean.empty}/{mean.results}"])
    return _aligned(title, header, lines)


def _heads(setting: Setting) -> list[str]:
    method, contacts, normals = setting
    return [str(contacts or "-"), _label(method, normals)]


def _number(summary: Summary | None, measure: str) -> str:
    return "-" if summary is None or summary.value is None else _scaled(summary.value, measure)


def _scaled(value: float, measure: str) -> str:
    _, factor, digits = COLUMNS[measure]
    return f"{value * factor:.{digits}f}"


def _aligned(title: str, header: list[str], lines: list[list[str]]) -> str:
    widths = [max(len(line[k]) for line in [header, *lines]) for k in range(len(header))]

    def joined(line: list[str]) -> str:
        return "  ".join(
            text.ljust(width) if k == 1 else text.rjust(width)
            for k, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()

    return "\n".join([title, joined(header), "-" * len(joined(header)), *map(joined, lines)])


def definitions(config: EvaluateConfig) -> list[str]:
    """What the numbers mean, one line each."""
    lines = ["distances and thresholds are in units of the longest side of the true shape's box"]
    lines += [f"protocol {name}: {PROTOCOLS[name]}" for name in config.protocols]
    if "surface" in config.protocols:
        lines.append(f"surface samples: {config.samples} on each mesh, stratified by area")
    lines += [f"{name}: {text}" for name, text in DEFINITIONS.items()]
    lines.append(
        "mean: over the trajectories of a shape, then the shapes of a category, then categories with equal weight"
    )
    lines.append("means of distances leave empty results out; the column empty counts them")
    lines.append(f"interval: {INTERVAL:.0%} bootstrap over shapes ({RESAMPLES} resamples)")
    lines.append(f"{TRUTH}: the true mesh in place of a reconstruction, the ceiling that the sampling allows")
    return lines


def write_report(
    config: EvaluateConfig, settings: dict[str, Any], rows: list[dict[str, Any]], summaries: list[Summary], command: str
) -> None:
    """results.csv, summary.csv and report.json, each whole or not at all."""
    with outputs.atomic_output(config.output / "results.csv", force=True) as path, path.open("w", newline="") as file:
        columns = ["shape", "category", *Task._fields, *result_keys(config), "weights", "note"]
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    with outputs.atomic_output(config.output / "summary.csv", force=True) as path, path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Summary._fields)
        writer.writerows(summaries)
    report = {
        "command": command,
        "options": json.loads(json.dumps(dataclasses.asdict(config), default=str)),
        "settings": settings,
        "versions": versions(),
        "definitions": definitions(config),
        "summary": [summary._asdict() for summary in summaries],
        "results": [{name: _jsonable(value) for name, value in row.items()} for row in rows],
    }
    with outputs.atomic_output(config.output / "report.json", force=True) as path:
        path.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _jsonable(value: Any) -> Any:
    # JSON has no infinity; the flag `empty` says why the number is missing.
    return None if isinstance(value, float) and not math.isfinite(value) else value


def versions() -> dict[str, str]:
    """Of Python, the machine's kind and the packages that made the numbers."""
    names = ("touchnet", "torch", "numpy", "scipy", "trimesh", "point-cloud-utils", "pymeshlab")
    found = {"python": platform.python_version(), "platform": platform.platform(), "processors": str(os.cpu_count())}
    for name in names:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def assemble_gallery(config: EvaluateConfig, shapes: Iterable[str]) -> None:
    """gallery.png from the strips of tiles that were drawn with the shapes."""
    from PIL import Image

    from touchnet.figures import save_gallery

    rows, titles = [], []
    for shape in shapes:
        file = _strip(config, shape)
        if file.is_file():
            with Image.open(file) as strip:
                named = json.loads(strip.text["titles"])
                pixels = np.asarray(strip.convert("RGB"))
            tiles = np.split(pixels, len(named), axis=1)
            rows.append((shape, *(None if (tile == 255).all() else tile for tile in tiles)))
            titles = named if len(named) > len(titles) else titles
    if rows:
        save_gallery(config.output / "gallery.png", rows, titles=titles, size=TILE)


def _strip(config: EvaluateConfig, shape: str) -> Path:
    return config.output / "gallery" / f"{shape.replace('/', '_')}.png"


def evaluate(config: EvaluateConfig, *, command: str = "") -> list[Summary]:
    """Runs the whole evaluation that `config` describes; returns the summary that it also writes."""
    config = _checked(config)
    data = _data(config)
    if len(data) == 0:
        raise ValueError(f"{config.data} has no shape in split {config.split!r}")
    settings = {
        "data": hashlib.sha256((config.data / INDEX).read_bytes()).hexdigest()[:16],
        "resolution": config.resolution,
        "samples": config.samples,
        "seed": config.seed,
        "take": config.take,
        "protocols": list(config.protocols),
    }
    progress = config.output / "progress.jsonl"
    if progress.exists() and not (config.resume or config.force):
        raise ValueError(f"{config.output} holds results; --resume goes on with them, --force replaces them")
    if not config.resume:
        shutil.rmtree(config.output / "gallery", ignore_errors=True)
    config.output.mkdir(parents=True, exist_ok=True)
    if config.gallery:
        (config.output / "gallery").mkdir(exist_ok=True)
    weights = _weights_digest(config.weights) if "model" in config.methods else ""
    rows = collect(config, settings, weights, progress)
    measures = [name for name in result_keys(config) if name in COLUMNS]
    summaries = summarise(rows, measures, seed=config.seed)
    write_report(config, settings, rows, summaries, command)
    assemble_gallery(config, dict.fromkeys(row["shape"] for row in rows))
    return summaries


def _checked(config: EvaluateConfig) -> EvaluateConfig:
    methods = tuple(METHODS) if "all" in config.methods else tuple(dict.fromkeys(config.methods))
    config = dataclasses.replace(config, methods=methods)
    for name in ("methods", "contacts", "protocols"):
        if not getattr(config, name):
            raise ValueError(f"{name} must name at least one, got none")
    for name in ("limit", "trajectories", "resolution", "samples", "jobs"):
        value = getattr(config, name)
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")
    if min(config.contacts) < 1:
        raise ValueError(f"contacts must be at least 1, got {min(config.contacts)}")
    if "poisson" in methods and importlib.util.find_spec("pymeshlab") is None:
        raise ImportError("method poisson needs pymeshlab: pip install 'touchnet[data]'")
    return config


@cli.command("touchnet evaluate")
def main(argv: Sequence[str] | None = None) -> None:
    """The command."""
    config = cli.parse(EvaluateConfig, argv, prog="touchnet evaluate")
    arguments = sys.argv[1:] if argv is None else argv
    start = time.monotonic()
    summaries = evaluate(config, command=" ".join(["touchnet evaluate", *arguments]))
    print(tables(summaries, config.protocols))
    print()
    print("\n".join(definitions(config)))
    shapes = max(summary.shapes for summary in summaries)
    print(f"\n{shapes} shapes, {time.monotonic() - start:.0f} s; results in {config.output}")


if __name__ == "__main__":
    # Worker processes look functions up by module, and cannot look into the __main__ of another process.
    from touchnet import evaluate as importable

    sys.exit(importable.main())
