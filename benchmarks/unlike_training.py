"""python -m benchmarks.unlike_training PYBULLET_DATA MESHES: objects unlike the training's, for `touchnet simulate`.

The package pybullet brings links of robots and grippers, toys, and a thousand random objects that were made to be
grasped. This writes them as PLY files by kind: bodies that are there several times (mirrored, coarser, as convex
pieces) once, and every 25th random object. COLLADA files are left out.
"""

import argparse
import re
from pathlib import Path

import numpy as np
import trimesh

LINKS = (
    "a1/meshes", "aliengo/meshes", "differential", "franka_panda/meshes/collision", "gripper/meshes", "husky/meshes",
    "kuka_iiwa/meshes", "laikago", "mini_cheetah/meshes", "quadruped", "racecar/meshes",
    "xarm/xarm_description/meshes/xarm6/visual", "xarm/xarm_gripper/meshes",
)  # fmt: skip
TOYS = (
    "bunny.obj", "duck.obj", "lego/lego.obj", "soccerball.obj", "stone.obj", "teddy2_VHACD_CHs.obj",
    "torus/torus_textured.obj", "toys/concave_box.obj", "toys/prism.obj", "toys/shape_sorter.obj", "domino/domino.obj",
    "tray/tray_textured.obj", "kiva_shelf/meshes/pod_lowres.stl",
)  # fmt: skip
AGAIN = re.compile(r"_lores|_vhacd|_collision|_mirror|_zup|_mod\b|_scaled|_[46]inch|user_rail")


def chosen(folder: Path) -> list[tuple[str, Path]]:
    """(kind, path) of every file, in the order of their names."""
    links = [
        ("robot", path)
        for place in LINKS
        for path in sorted((folder / place).rglob("*"))
        if path.suffix.lower() in (".obj", ".stl") and not AGAIN.search(path.stem)
    ]
    random = sorted((folder / "random_urdfs").rglob("*.obj"))[::25]
    return [*links, *(("toy", folder / name) for name in TOYS), *(("random", path) for path in random)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("source", type=Path, metavar="PYBULLET_DATA", help="the folder pybullet_data")
    parser.add_argument("output", type=Path, metavar="MESHES", help="the folder to write")
    options = parser.parse_args()
    if not (options.source / "random_urdfs").is_dir():
        parser.error(f"PYBULLET_DATA should hold random_urdfs, {options.source} does not")

    seen: set[tuple] = set()
    written: set[Path] = set()
    for kind, path in chosen(options.source):
        mesh = trimesh.load(path, force="mesh", process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        shape = (kind, len(mesh.faces), *np.round(np.sort(mesh.extents / mesh.extents.max()), 3).tolist())
        if len(mesh.faces) < 8 or shape in seen:
            continue
        seen.add(shape)
        # A body that is there as OBJ and as STL has one name: the STL file takes the place of the other.
        target = options.output / kind / ("_".join(path.relative_to(options.source).with_suffix("").parts) + ".ply")
        target.parent.mkdir(parents=True, exist_ok=True)
        trimesh.Trimesh(mesh.vertices, mesh.faces).export(target)
        written.add(target)
    print(f"{len(written)} meshes in {options.output}")


if __name__ == "__main__":
    main()
