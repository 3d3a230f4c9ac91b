"""Data: closing meshes, labelling points, simulating touches, reading and writing them."""

from touchnet.data.closest_points import ClosestPoints
from touchnet.data.dataset import ShapeFile, ShapeRecord, TouchDataset
from touchnet.data.exploration import Surface, Touches, coverage, simulate_touches
from touchnet.data.files import Points, read_mesh, read_points, split_strokes, write_mesh
from touchnet.data.gp import GaussianProcess
from touchnet.data.importers import find_meshes, load_mesh
from touchnet.data.occupancy import contains, label_box, label_near, sample_surface
from touchnet.data.shapes import build_procedural, procedural_mesh
from touchnet.data.watertight import inspect_mesh, make_watertight

__all__ = [
    "ClosestPoints",
    "GaussianProcess",
    "Points",
    "ShapeFile",
    "ShapeRecord",
    "Surface",
    "TouchDataset",
    "Touches",
    "build_procedural",
    "contains",
    "coverage",
    "find_meshes",
    "inspect_mesh",
    "label_box",
    "label_near",
    "load_mesh",
    "make_watertight",
    "procedural_mesh",
    "read_mesh",
    "read_points",
    "sample_surface",
    "simulate_touches",
    "split_strokes",
    "write_mesh",
]
