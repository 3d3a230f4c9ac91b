"""The options of `touchnet evaluate`."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from touchnet.evaluation.conditions import CONTACTS, NOISES, ORIENTATIONS, STRATEGIES

Curve = Literal["contacts", "noise", "strategy", "orientation", "all"]


@dataclasses.dataclass
class EvaluateConfig:
    """Reconstructs the touches of a data set and measures the results against its true shapes.

    Writes report.html (tables, curves, pictures in one file), results.csv (one line a reconstruction), summary.csv,
    report.json, gallery.png and exploration.png into the output folder and prints tables. Two protocols stand side by
    side and are never mixed; the report defines every measure.
    """

    data: tyro.conf.Positional[Path]
    """Data set directory."""
    weights: str = "default"
    """Weights of the method `model`: a file, or the name of those in the package."""
    models: tuple[str, ...] = ()
    """More trained networks, NAME=FILE each: they are evaluated under that name. {category} in FILE stands for the
    category of the shape (one network a category); several files joined by commas are runs with other seeds.
    Names such as fi@10 and fi@30 make a curve over the number of training shapes, which the files tell."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("evaluation")
    """Folder for the results."""
    methods: tuple[
        Literal[
            "model", "convex_hull", "alpha_shape", "alpha_wrap", "ball_pivoting", "poisson", "gpis", "gpis_points",
            "classical", "all",
        ],
        ...,
    ] = ("model", "convex_hull")  # fmt: skip
    """What to evaluate, beside --models; classical: all of them but model. alpha_wrap, ball_pivoting and poisson need
    pymeshlab."""
    split: Literal["train", "val", "test", "all"] = "test"
    """Which shapes."""
    categories: tuple[str, ...] = ()
    """Only these categories."""
    groups: tuple[str, ...] = ()
    """Categories joined by +, such as car+truck, to be summed up together too: each shape counts the same."""
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
    curves: tuple[Curve, ...] = ()
    """What else to vary, one thing at a time: the number of contacts (--curve-counts), the noise of their positions
    (--noises), the strategy of the exploration (--strategies), the orientation of the object (--orientations)."""
    published: Path | None = None
    """CSV file of figures that others published, of other data, to stand in a table apart. Its columns: source, method,
    category, measure, value."""
    curve_contacts: int = 512
    """Number of contacts on the curves over noise, strategy and orientation."""
    curve_counts: tuple[int, ...] = CONTACTS
    """Numbers of contacts on their curve."""
    noises: tuple[float, ...] = NOISES
    """Standard deviations of the contacts' positions, in shares of the longest side."""
    strategies: tuple[Literal["gp", "random_walk", "scan_lines", "uniform"], ...] = STRATEGIES
    """Explorations simulated anew, beside the stored trajectories."""
    orientations: tuple[Literal["up", "free"], ...] = ORIENTATIONS
    """Turns of the object, beside the given one: by any angle about the up axis, freely."""
    protocols: tuple[Literal["surface", "paper"], ...] = ("surface", "paper")
    """What to measure."""
    resolution: int = 128
    """Cells along the longest side in the extraction of networks and Gaussian processes."""
    samples: int = 100_000
    """Points on each surface whose distances are averaged."""
    gallery: int = 2
    """Shapes a category in the pictures; 0: no picture."""
    jobs: int = 1
    """Processes; each works on one shape at a time."""
    device: str = "auto"
    """Where networks run: auto, cpu or cuda."""
    seed: int = 0
    """Of samples, noise, turns and bootstrap."""
    resume: bool = False
    """Go on with what the output folder already holds."""
    force: bool = False
    """Replace what the output folder already holds."""
