"""All shapes, in processes, with every finished result in a file that a later run goes on from."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from touchnet import outputs
from touchnet.evaluation.conditions import Task, conditions_of, tasks_of
from touchnet.evaluation.measure import ShapeJob, evaluate_shape, is_drawn, open_data
from touchnet.evaluation.methods import Method, weights_digest
from touchnet.evaluation.options import EvaluateConfig
from touchnet.evaluation.pictures import strip_path


def collect(
    config: EvaluateConfig, methods: Mapping[str, Method], settings: dict[str, Any], progress: Path
) -> list[dict[str, Any]]:
    """Evaluates what `progress` does not hold yet; appends each finished shape there.

    Args:
        config: what is asked.
        methods: what is tried.
        settings: what the results depend on besides their own columns; those of `progress` must be the same.
        progress: the file, one JSON object a line: the settings, then the results.
    """
    data = open_data(config)

    def digest(row: Mapping[str, Any]) -> str:
        weights = methods[row["method"]].weights(row["run"], row["category"]) if row["method"] in methods else ""
        return weights_digest(weights) if weights else ""

    rows = read_progress(progress, settings) if config.resume and progress.exists() else []
    rows = [row for row in rows if row["weights"] == digest(row)]
    done = {_key(row) for row in rows}
    pictured: dict[str, int] = {}
    used: dict[str, int] = {}
    jobs = []
    asked = set()
    most = max(condition.contacts for condition in conditions_of(config))
    for index, record in enumerate(data.records):
        used[record.category] = used.get(record.category, 0) + 1
        if config.limit is not None and used[record.category] > config.limit:
            continue
        stored = data.shape(index).shape("touches")
        if stored[0] and most > stored[1]:
            raise ValueError(f"contacts must be at most {stored[1]}, which the data set stores, got {most}")
        tasks = tasks_of(config, methods.values(), stored[0])
        asked |= {(record.id, *task) for task in tasks}
        missing = [task for task in tasks if (record.id, *task) not in done]
        picture = None
        if pictured.get(record.category, 0) < config.gallery and stored[0]:
            pictured[record.category] = pictured.get(record.category, 0) + 1
            picture = strip_path(config.output, record.id)
        if missing and picture:  # the row of the gallery needs all of its meshes, also those measured already
            missing = [task for task in tasks if task in missing or is_drawn(config, task)]
        if missing:
            jobs.append(ShapeJob(index, missing, picture))
    new = not progress.exists() or not config.resume
    with progress.open("w" if new else "a", encoding="utf-8") as log:
        if new:
            log.write(json.dumps(settings) + "\n")
        with tqdm(total=len(asked), initial=len(asked & done), unit="mesh", desc="evaluate") as bar:
            for finished in _in_processes(config, methods, jobs):
                finished = [row for row in finished if _key(row) not in done]
                for row in finished:
                    row["weights"] = digest(row)
                log.writelines(json.dumps(row) + "\n" for row in finished)
                log.flush()
                rows += finished
                bar.update(len(finished))
    # In a fixed order, and without what an earlier run had measured beyond today's question.
    return sorted((row for row in rows if _key(row) in asked), key=_key)


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return (row["shape"], *(row[name] for name in Task._fields))


def _in_processes(
    config: EvaluateConfig, methods: Mapping[str, Method], jobs: list[ShapeJob]
) -> Iterator[list[dict[str, Any]]]:
    if config.jobs == 1:
        yield from (evaluate_shape(config, methods, job) for job in jobs)
        return
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=config.jobs, return_as="generator_unordered", pre_dispatch="n_jobs", batch_size=1)
    yield from parallel(delayed(evaluate_shape)(config, methods, job) for job in jobs)


def read_progress(path: Path, settings: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of an earlier run; a last line cut off by a kill is removed from the file.

    Raises:
        ValueError: the file is damaged, or of a run with other settings.
    """
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
