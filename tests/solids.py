"""Balls and boxes, whose right answers are known, and a small data set of them; shared by the tests of measures."""

from pathlib import Path

import numpy as np
import trimesh

from touchnet.data.dataset import Index, ShapeRecord, write_index, write_shape
from touchnet.metrics import inside_mesh, sample_surface

TOUCHES = 96


def sphere(radius: float, *, centre: tuple[float, float, float] = (0, 0, 0), subdivisions: int = 4) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def write_shape_file(directory: Path, name: str, mesh: trimesh.Trimesh, split: str = "test") -> ShapeRecord:
    """One shape with two trajectories of points drawn from its surface."""
    generator = np.random.default_rng(len(name))
    mesh.apply_scale(1 / mesh.extents.max())
    vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    surface, face = sample_surface(mesh, 400, generator=generator)
    touched = [generator.permutation(400)[:TOUCHES] for _ in range(2)]
    near = np.concatenate([surface[:200] + generator.normal(size=(200, 3)) * sigma for sigma in (0.01, 0.05)])
    near, box = near.astype(np.float16), generator.uniform(*mesh.bounds, (300, 3)).astype(np.float16)
    normals = mesh.face_normals[face].astype(np.float16)
    tensors = {
        "vertices": vertices,
        "faces": faces,
        "touches": np.stack([surface[some] for some in touched]).astype(np.float32),
        "touch_normals": np.stack([normals[some] for some in touched]),
        "strokes": np.zeros((2, TOUCHES), dtype=np.int16),
        "variance": np.ones((2, TOUCHES), dtype=np.float32),
        "near": near,
        "near_inside": np.packbits(inside_mesh(near, mesh)),
        "box": box,
        "box_inside": np.packbits(inside_mesh(box, mesh)),
        "surface": surface.astype(np.float32),
        "surface_normals": normals,
    }
    file = f"shapes/{name}.safetensors"
    said = {"id": name, "category": name.split("/")[0], "centre": "[0, 0, 0]", "scale": "1", "closed_by": "nothing"}
    digest = write_shape(directory / file, tensors, said)
    return ShapeRecord(name, name.split("/")[0], split, "made here", "MIT", file, digest)


def write_solids(directory: Path) -> Path:
    """Two balls and two boxes to test with, in a data set directory."""
    records = [
        write_shape_file(directory, "ball/round", trimesh.creation.icosphere(subdivisions=3)),
        write_shape_file(directory, "ball/oblong", trimesh.creation.capsule(height=1, radius=0.4)),
        write_shape_file(directory, "box/cube", trimesh.creation.box((1, 1, 1))),
        write_shape_file(directory, "box/brick", trimesh.creation.box((1, 0.5, 0.4))),
    ]
    write_index(directory, Index(0, {"sigmas": [0.01, 0.05]}, records, []))
    return directory
