import dataclasses
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from accelerate.state import AcceleratorState

from touchnet.config import PAPER_SAMPLES, PEERS, ConvONetConfig, GRNetConfig, PointNet2Config, SampleConfig
from touchnet.data.dataset import Index, ShapeRecord, write_index, write_shape
from touchnet.train import main, train
from touchnet.training.batches import StepBatches
from touchnet.training.options import RECIPES, TrainConfig, resolve_recipe
from touchnet.training.schedule import Budget, learning_rate
from touchnet.weights import load_model, read_notes

SMALL_SAMPLES = SampleConfig(queries=256, min_contacts=63, max_contacts=256)


@pytest.fixture(autouse=True)
def fresh_accelerator():
    yield
    AcceleratorState._reset_state(reset_partial_state=True)


def ellipsoid(path, axes, *, trajectories=2, contacts=256, seed=0):
    """A shape file of an ellipsoid whose longest axis is 1."""
    rng = np.random.default_rng(seed)
    axes = np.asarray(axes) / max(axes) / 2
    ball = trimesh.creation.icosphere(subdivisions=2)

    def surface(*shape):
        directions = rng.normal(size=(*shape, 3))
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        normals = directions / axes
        return directions * axes, normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    def labelled(points):
        points = points.astype(np.float16)
        return points, np.packbits(((points.astype(float) / axes) ** 2).sum(1) <= 1)

    touches, touch_normals = surface(trajectories, contacts)
    on_surface, surface_normals = surface(1024)
    near, near_inside = labelled(surface(8192)[0] + rng.normal(size=(8192, 3)) * np.repeat([0.01, 0.05], 4096)[:, None])
    box, box_inside = labelled((rng.random((4096, 3)) - 0.5) * axes * 2)
    tensors = {
        "vertices": (ball.vertices * axes).astype(np.float32), "faces": ball.faces.astype(np.int32),
        "touches": touches.astype(np.float32), "touch_normals": touch_normals.astype(np.float16),
        "strokes": np.zeros((trajectories, contacts), np.int16),
        "variance": np.ones((trajectories, contacts), np.float32),
        "near": near, "near_inside": near_inside, "box": box, "box_inside": box_inside,
        "surface": on_surface.astype(np.float32), "surface_normals": surface_normals.astype(np.float16),
    }  # fmt: skip
    metadata = {"id": path.stem, "category": "egg", "centre": "[0, 0, 0]", "scale": "1", "closed_by": "none"}
    return write_shape(path, tensors, metadata)


@pytest.fixture(scope="session")
def eggs(tmp_path_factory):
    """Five ellipsoids to train on, one to validate with."""
    directory = tmp_path_factory.mktemp("eggs")
    records = []
    for i in range(6):
        file = f"shapes/egg/{i}.safetensors"
        checksum = ellipsoid(directory / file, [1, 0.5 + 0.08 * i, 0.9 - 0.1 * i], seed=i)
        split, licence = ("val" if i == 5 else "train"), ("GPL-2" if i == 4 else "CC0-1.0")
        records.append(ShapeRecord(f"egg/{i}", "egg", split, "made", licence, file, checksum))
    write_index(directory, Index(0, {"sigmas": [0.01, 0.05]}, records, []))
    return directory


def options(data, output, **changes):
    defaults = {
        "data": data, "output": output, "model": "tiny", "samples": SMALL_SAMPLES, "batch_size": 4, "steps": 6,
        "workers": 0, "device": "cpu", "validate_every": 1000, "checkpoint_every": 1000,
    }  # fmt: skip
    return TrainConfig(**{**defaults, **changes})


def weights_of(output):
    return load_model(output / "weights.safetensors").state_dict()


def same(a, b):
    return all(torch.equal(a[name], b[name]) for name in a)


def test_training_learns_and_leaves_what_it_promises(eggs, tmp_path):
    figures = train(options(eggs, tmp_path / "run", steps=150, learning_rate=5e-3, validate_every=150))
    assert set(figures) == {f"iou/{n}{kind}" for n in (128, 512, 2048) for kind in ("", "+normals")}
    assert figures["iou/512+normals"] > 0.7
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert {"weights.safetensors", "checkpoint.pt", "config.json", "metrics.jsonl", "reconstructions.png"} <= names
    assert any(name.startswith("events.out.tfevents") for name in names)
    rows = [json.loads(line) for line in (tmp_path / "run/metrics.jsonl").read_text().splitlines()]
    losses = [row["loss"] for row in rows if "loss" in row]
    assert losses[-1] < 0.7 * losses[0]
    assert rows[-1]["iou/512+normals"] == figures["iou/512+normals"]
    torch.load(tmp_path / "run/checkpoint.pt")  # weights_only=True is torch's default


@pytest.mark.parametrize("recipe", ["default", "paper"])
def test_a_resumed_run_equals_an_uninterrupted_one_bit_for_bit(eggs, tmp_path, recipe):
    common = {"recipe": recipe, "schedule": "constant", "steps": None}
    train(options(eggs, tmp_path / "straight", epochs=2, **common))
    train(options(eggs, tmp_path / "halves", epochs=1, **common))
    train(options(eggs, tmp_path / "halves", epochs=2, resume=True, **common))
    assert same(weights_of(tmp_path / "straight"), weights_of(tmp_path / "halves"))
    steps = [
        [
            json.loads(line)["epoch"]
            for line in (tmp_path / run / "metrics.jsonl").read_text().splitlines()
            if "epoch" in line
        ]
        for run in ("straight", "halves")
    ]
    assert steps[0][-1] == steps[1][-1] == 2


SMALL_PEERS = {
    "grnet": GRNetConfig(grid=16, channels=(4, 8, 8, 8), code=16, sparse=64, copies=2),
    "pointnet2": PointNet2Config(points=64, copies=2, noise=4, width=8, centres=(16, 4), radii=(0.5, 1), neighbours=8),
    "convonet": ConvONetConfig(grid=8, hidden=8, blocks=2),
}


def test_a_batch_in_pieces_trains_the_same(eggs, tmp_path):
    for pieces in (1, 2, 4):
        train(options(eggs, tmp_path / str(pieces), steps=3, accumulate=pieces))
        AcceleratorState._reset_state(reset_partial_state=True)
    whole = torch.load(tmp_path / "1/checkpoint.pt")["network"]
    for pieces in ("2", "4"):
        parts = torch.load(tmp_path / pieces / "checkpoint.pt")["network"]
        for name, value in whole.items():
            torch.testing.assert_close(parts[name], value, rtol=1e-3, atol=2e-5)


def test_a_compiled_network_trains_the_same(eggs, tmp_path, monkeypatch):
    monkeypatch.setattr("touchnet.train.COMPILER", "aot_eager")  # the same trace; inductor's C++ takes a minute
    for compiled in (False, True):
        train(options(eggs, tmp_path / str(compiled), steps=3, compile=compiled))
        AcceleratorState._reset_state(reset_partial_state=True)
    plain, compiled = (torch.load(tmp_path / name / "checkpoint.pt")["network"] for name in ("False", "True"))
    for name, value in plain.items():
        torch.testing.assert_close(compiled[name], value, rtol=1e-3, atol=2e-5)


def test_bfloat16_without_instructions_for_it_earns_a_warning(eggs, tmp_path, monkeypatch):
    monkeypatch.setattr("touchnet.train.fast_bfloat16", lambda: False)
    with pytest.warns(UserWarning, match="this processor has no bfloat16 instructions"):
        train(options(eggs, tmp_path / "run", steps=1, precision="bf16"))


def test_training_goes_on_from_weights_that_are_given(eggs, tmp_path):
    train(options(eggs, tmp_path / "first", steps=2))
    AcceleratorState._reset_state(reset_partial_state=True)
    weights = tmp_path / "first" / "weights.safetensors"
    # One step at a rate of almost nothing leaves the weights that it began with.
    train(options(eggs, tmp_path / "second", model=None, init=str(weights), steps=1, learning_rate=1e-12))
    first, second = (load_model(tmp_path / run / "weights.safetensors") for run in ("first", "second"))
    assert first.config == second.config
    for name, value in first.state_dict().items():
        torch.testing.assert_close(second.state_dict()[name], value)


@pytest.mark.parametrize("name", sorted(SMALL_PEERS))
def test_peers_train_resume_exactly_and_load_again(eggs, tmp_path, monkeypatch, name):
    monkeypatch.setitem(PEERS, name, SMALL_PEERS[name])
    common = {"model": name, "schedule": "constant", "learning_rate": 1e-3}
    figures = train(options(eggs, tmp_path / "straight", steps=4, **common))
    train(options(eggs, tmp_path / "halves", steps=2, **common))
    train(options(eggs, tmp_path / "halves", steps=4, resume=True, **common))
    assert same(weights_of(tmp_path / "straight"), weights_of(tmp_path / "halves"))
    assert (tmp_path / "straight/reconstructions.png").exists()
    model = load_model(tmp_path / "straight/weights.safetensors")
    assert model.config == SMALL_PEERS[name]
    measured = {key.partition("/")[0] for key in figures}
    assert measured == ({"iou"} if name == "convonet" else {"chamfer", "f_score"})
    assert any(key.endswith("+normals") for key in figures) == (name == "convonet")


def test_a_budget_of_minutes_follows_the_clock(eggs, tmp_path, capsys):
    budget = Budget(None, 100.0)
    assert budget.planned(10, 5.0) == 200 and budget.planned(250, 99.9) == 251
    assert not budget.spent(10**6, 99.9) and budget.spent(1, 100.0)
    train(options(eggs, tmp_path / "run", steps=None, minutes=0.02))
    said = capsys.readouterr().out
    steps = torch.load(tmp_path / "run/checkpoint.pt")["step"]
    assert f"{steps} steps, {4 * steps} samples seen" in said
    training = json.loads(read_notes(tmp_path / "run/weights.safetensors")["training"])
    assert (training["steps"], training["samples"], training["shapes"]) == (steps, 4 * steps, 5)
    with pytest.raises(ValueError, match=r"nothing is left of 0.02 minutes"):
        train(options(eggs, tmp_path / "run", steps=None, minutes=0.02, resume=True))


def test_smaller_training_sets_lie_within_larger_ones(eggs, tmp_path, monkeypatch):
    import touchnet.train as module

    drawn = {}
    real = module.TrainingSamples

    def note(data, *arguments, **options):
        drawn[len(data)] = {record.id for record in data.records}
        return real(data, *arguments, **options)

    monkeypatch.setattr(module, "TrainingSamples", note)
    for limit in (1, 3, 99):
        train(options(eggs, tmp_path / str(limit), steps=1, limit=limit))
    assert drawn[1] < drawn[3] < drawn[5]


def test_each_category_gets_a_network_of_its_own(eggs, tmp_path):
    arguments = ["--data", str(eggs), "--model", "tiny", "--steps", "1", "--category", "each", "--device", "cpu"]
    arguments += ["--workers", "0", "-o", str(tmp_path / "runs")]
    assert main(arguments) == 0
    assert load_model(tmp_path / "runs/egg/weights.safetensors")
    AcceleratorState._reset_state(reset_partial_state=True)
    assert main([*arguments, "--resume"]) == 0  # finished: passed over


def test_each_category_of_none_is_refused(eggs, tmp_path, capsys):
    nothing = ["--category", "each", "--exclude-licence", "GPL", "CC0", "-o", str(tmp_path / "runs")]
    assert main(["--data", str(eggs), *nothing]) == 2
    assert "there is no shape to train on" in capsys.readouterr().err


def test_a_stop_in_mid_epoch_resumes_exactly(eggs, tmp_path, monkeypatch):
    straight = options(eggs, tmp_path / "straight", steps=7)
    train(straight)
    import touchnet.train as module

    real = module.Average.update

    def interrupt(self, network, step):
        real(self, network, step)
        if step == 3:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(module.Average, "update", interrupt)
    stopped = options(eggs, tmp_path / "stopped", steps=7)
    with pytest.raises(KeyboardInterrupt):
        train(stopped)
    monkeypatch.undo()
    assert torch.load(tmp_path / "stopped/checkpoint.pt")["step"] == 4
    train(dataclasses.replace(stopped, resume=True))
    assert same(weights_of(tmp_path / "straight"), weights_of(tmp_path / "stopped"))


@pytest.mark.slow
def test_a_killed_run_leaves_whole_files_and_resumes_to_the_same_weights(eggs, tmp_path):
    arguments = [
        sys.executable, "-m", "touchnet.train", "--data", str(eggs), "--model", "tiny", "--steps", "240",
        "--samples.queries", "256", "--samples.max-contacts", "256", "--checkpoint-every", "4", "--workers", "1",
        "--device", "cpu",
    ]  # fmt: skip
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([*arguments, "-o", str(tmp_path / "straight")], check=True, env=environment, capture_output=True)
    log = (tmp_path / "straight/metrics.jsonl").read_text().splitlines()
    step = json.loads(log[-1])["seconds"] / 240
    moments = np.random.default_rng(0).uniform(0, 12 * step, size=10)  # ten times 4 + 12 steps: the run does not end
    resume: list[str] = []
    for moment in moments:
        run = subprocess.Popen(
            [*arguments, *resume, "-o", str(tmp_path / "killed")], env=environment, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        checkpoint = tmp_path / "killed/checkpoint.pt"
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        deadline = time.monotonic() + 120
        while run.poll() is None and time.monotonic() < deadline:
            if checkpoint.exists() and checkpoint.stat().st_mtime_ns > before:
                break
            time.sleep(0.01)
        time.sleep(moment)  # any place between two checkpoints, or in the midst of writing one
        assert run.poll() is None, "the run ended before it was killed"
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        load_model(tmp_path / "killed/weights.safetensors")
        torch.load(checkpoint)
        resume = ["--resume"]
    subprocess.run(
        [*arguments, "--resume", "-o", str(tmp_path / "killed")], check=True, env=environment, capture_output=True
    )
    assert same(weights_of(tmp_path / "straight"), weights_of(tmp_path / "killed"))


@pytest.mark.slow
def test_two_processes_train_as_one_and_so_do_two_machines(eggs, tmp_path):
    arguments = [
        "-m", "touchnet.train", "--data", str(eggs), "--model", "tiny", "--steps", "8", "--samples.queries", "256",
        "--samples.max-contacts", "256", "--device", "cpu", "--workers", "0",
    ]  # fmt: skip
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    launch = [sys.executable, "-m", "torch.distributed.run"]
    # The command of docs/training.md for several machines, with one process each; both are this one.
    machine = [
        *launch, "--nnodes", "2", "--nproc-per-node", "1", "--rdzv-backend", "c10d", "--rdzv-endpoint",
        "localhost:29534", "--local-addr", "localhost",
    ]  # fmt: skip
    ways = {
        "one": [[sys.executable]],
        "processes": [[*launch, "--nproc-per-node", "2", "--master-port", "29533"]],
        "machines": [machine, machine],
    }
    for name, prefixes in ways.items():
        runs = [
            subprocess.Popen(
                [*prefix, *arguments, "-o", str(tmp_path / name)], env=environment, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True,
            )
            for prefix in prefixes
        ]  # fmt: skip
        for run in runs:
            said = run.communicate(timeout=300)[0]
            assert run.returncode == 0, said
    one = weights_of(tmp_path / "one")
    for name in ("processes", "machines"):
        other = weights_of(tmp_path / name)
        assert max((one[key] - other[key]).abs().max().item() for key in one) < 1e-4


@pytest.mark.slow
def test_two_processes_train_each_category_in_turn(tmp_path):
    records = []
    for i, category in enumerate(("egg", "lens")):
        file = f"shapes/{category}/0.safetensors"
        checksum = ellipsoid(tmp_path / "data" / file, [1, 0.8, 0.4], seed=i)
        records.append(ShapeRecord(f"{category}/0", category, "train", "made", "CC0-1.0", file, checksum))
    write_index(tmp_path / "data", Index(0, {"sigmas": [0.01, 0.05]}, records, []))
    command = [
        sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--master-port", "29536", "-m",
        "touchnet.train", "--data", tmp_path / "data", "--category", "each", "-o", tmp_path / "runs", "--model",
        "tiny", "--steps", "1", "--samples.queries", "64", "--device", "cpu", "--workers", "0",
    ]  # fmt: skip
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert said.returncode == 0, said.stdout + said.stderr
    assert [line for line in said.stdout.splitlines() if line in ("egg:", "lens:")] == ["egg:", "lens:"]
    for category in ("egg", "lens"):
        assert load_model(tmp_path / "runs" / category / "weights.safetensors")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a shell script")
def test_slurm_job_trains_and_goes_on_when_requeued(eggs, tmp_path):
    """examples/train.sbatch with stand-ins for SLURM's commands: one machine, the step's command run as it is."""
    stand_ins = {
        "scontrol": 'test "$*" = "show hostnames localhost" && echo localhost\n',
        "srun": 'test "$1" = --cpus-per-task=2 && shift && exec "$@"\n',
        "torchrun": f'exec {shlex.quote(sys.executable)} -m torch.distributed.run --local-addr localhost "$@"\n',
    }
    for name, script in stand_ins.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}")
        (tmp_path / name).chmod(0o755)
    environment = {
        **os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "OMP_NUM_THREADS": "1",
        "SLURM_JOB_NODELIST": "localhost", "SLURM_JOB_ID": "9535", "SLURM_NNODES": "1", "SLURM_CPUS_PER_TASK": "2",
    }  # fmt: skip

    arguments = [
        "--data", str(eggs), "--model", "tiny", "--schedule", "constant", "--samples.queries", "256",
        "--samples.max-contacts", "256", "--device", "cpu", "--workers", "0",
    ]  # fmt: skip

    def run(*command):
        said = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert said.returncode == 0, said.stdout + said.stderr

    script = Path(__file__).parents[1] / "examples" / "train.sbatch"
    for steps in ("2", "4"):
        run("sh", script, tmp_path / "job", *arguments, "--steps", steps)
    run(sys.executable, "-m", "touchnet.train", "--output", tmp_path / "straight", *arguments, "--steps", "4")
    job, straight = weights_of(tmp_path / "job"), weights_of(tmp_path / "straight")
    assert max((job[key] - straight[key]).abs().max().item() for key in job) < 1e-4


def test_batches_cover_each_epoch_and_do_not_depend_on_where_they_start_or_on_processes():
    def keys(start, rank=0, world=1):
        return list(StepBatches(10, 4, seed=1, start=start, steps=9, rank=rank, world=world))

    whole = keys(0)
    assert [len(batch) for batch in whole] == [4] * 9
    first = [key for batch in whole[:3] for key in batch]
    assert {item for _, item in first} == set(range(10))
    assert {epoch for epoch, _ in first} == {0} and whole[3][0][0] == 1
    assert keys(5) == whole[5:]
    halves = zip(keys(0, 0, 2), keys(0, 1, 2), strict=True)
    assert [sorted(a + b) for a, b in halves] == [sorted(batch) for batch in whole]
    with pytest.raises(ValueError, match="batch_size should be a multiple of the 3 processes, got 4"):
        StepBatches(10, 4, seed=1, start=0, steps=9, rank=0, world=3)


def test_weighted_batches_draw_in_proportion():
    weights = np.array([1.0, 1.0, 8.0])
    batches = StepBatches(3, 3, seed=0, start=0, steps=400, rank=0, world=1, weights=weights)
    items = [item for batch in batches for _, item in batch]
    assert np.bincount(items) / len(items) == pytest.approx([0.1, 0.1, 0.8], abs=0.04)


def test_learning_rates():
    paper = [learning_rate(step, 400, 2, 1e-4, "multistep") for step in (0, 99, 100, 199, 200)]
    assert paper == [1e-4, 1e-4, 5e-5, 5e-5, 2.5e-5]
    cosine = [learning_rate(step, 1000, 2, 1.0, "cosine") for step in (0, 99, 100, 550, 999)]
    assert cosine == pytest.approx([0.01, 1.0, 1.0, 0.505, 0.01], abs=1e-4)


def test_recipe_paper_is_the_papers():
    recipe = resolve_recipe(TrainConfig(recipe="paper"))
    assert (recipe.model.network, recipe.loss, recipe.learning_rate, recipe.batch_size) == ("paper", "squared", 1e-4, 4)
    assert (recipe.epochs, recipe.steps, recipe.schedule, recipe.samples) == (200, None, "multistep", PAPER_SAMPLES)
    assert recipe.samples.queries == 4000
    assert resolve_recipe(TrainConfig()) == RECIPES["default"]
    fewer = resolve_recipe(TrainConfig(recipe="paper", samples=SampleConfig(queries=100)))
    assert fewer.samples == dataclasses.replace(PAPER_SAMPLES, queries=100)
    mixed = resolve_recipe(TrainConfig(recipe="paper", steps=7, sampling="addition"))
    assert (mixed.steps, mixed.epochs, mixed.model.sampling, mixed.model.network) == (7, None, "addition", "paper")


def test_a_bad_value_stops_the_run_and_names_the_shape(eggs, tmp_path, monkeypatch):
    import touchnet.objectives as module

    monkeypatch.setattr(module, "occupancy_loss", lambda logits, inside, kind: logits.mean() * torch.nan)
    with pytest.raises(ValueError, match=r"the loss is nan at step 0; the batch holds egg/\d.*Nothing was updated"):
        train(options(eggs, tmp_path / "run"))


def test_an_untrained_network_without_a_surface_is_reported_not_fatal(eggs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "touchnet.models.TouchNet.decode", lambda self, features, queries: torch.zeros(queries.shape[:2])
    )
    train(options(eggs, tmp_path / "run", steps=1))
    assert "no reconstruction of egg/5: " in capsys.readouterr().err
    assert (tmp_path / "run/reconstructions.png").exists()


def test_licences_can_be_left_out(eggs, tmp_path, capsys):
    train(options(eggs, tmp_path / "run", steps=1, exclude_licence=("GPL",)))
    assert "4 shapes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--data", "nowhere"], "nowhere"),
        (["--steps", "0"], "steps should be positive, got 0"),
        (["--steps", "1", "--epochs", "1"], "steps and epochs were both given"),
        (["--steps", "1", "--minutes", "1"], "steps and minutes were both given"),
        (["--limit", "0"], "limit should be positive, got 0"),
        (["--model", "grnet", "--sampling", "addition"], "sampling is how TouchNet reads features, grnet has none"),
        (["--init", "default", "--model", "tiny"], "init brings its model with it: leave --model and --sampling out"),
        (["--init", "nowhere.safetensors"], "no such file nowhere.safetensors"),
        (["--accumulate", "3"], "batch_size should be a multiple of 3 piece(s) x 1 process(es), got 4"),
        (["--samples.max-contacts", "3"], "min_contacts should lie between 4 and max_contacts, got 64 and 3"),
        (["--samples.noise", "2"], "samples: noise should lie between 0 and 1, got 2"),
        (["--resume"], "resume: there is no checkpoint"),
        (["--recipe", "best"], "recipe"),
    ],
)
def test_bad_options_are_one_line_and_status_2(arguments, words, tmp_path, capsys):
    assert main([*arguments, "-o", str(tmp_path / "run"), "--device", "cpu", "--cache", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert words in error and len(error.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_a_finished_run_is_not_overwritten(eggs, tmp_path, capsys):
    train(options(eggs, tmp_path / "run", steps=1))
    AcceleratorState._reset_state(reset_partial_state=True)
    assert main(["--data", str(eggs), "-o", str(tmp_path / "run"), "--model", "tiny"]) == 2
    assert "holds a run; --resume continues it, --force starts anew" in capsys.readouterr().err
