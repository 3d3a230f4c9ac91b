"""A closed mesh from a file of contacts, in the unit and frame of the file.

    python examples/reconstruct_file.py examples/touches.csv --up z --output object.ply

`touchnet reconstruct` does the same and more; this is what it looks like from Python. The file that comes with this
folder holds 512 contacts of a simulated finger on a bottle, in millimetres, with normals and stroke numbers.
"""

import argparse
from pathlib import Path

import touchnet
from touchnet.data import read_points, write_mesh
from touchnet.meshes import check_closed
from touchnet.outputs import atomic_output

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("touches", nargs="?", type=Path, default=HERE / "touches.csv", help="contacts in any format")
    parser.add_argument("--output", type=Path, default=Path("object.ply"), help="ply, obj, stl or glb")
    parser.add_argument("--up", choices=["x", "y", "z"], help="the axis that points up, if you know it")
    parser.add_argument("--resolution", type=int, default=128, help="cells along the longest side")
    parser.add_argument("--weights", default="default", help="a name or a .safetensors file")
    options = parser.parse_args()

    touches = read_points(options.touches)
    print(
        f"{len(touches.points)} contacts, {'with' if touches.normals is not None else 'without'} normals, "
        f"{touches.dropped} rows dropped"
    )
    mesh = touchnet.reconstruct_mesh(
        touches.points,
        normals=touches.normals,
        up=options.up,
        weights=options.weights,
        resolution=options.resolution,
    )
    check_closed(mesh)  # raises if an edge had not exactly two faces; it never should
    size = " x ".join(f"{side:.4g}" for side in mesh.extents)
    print(f"{len(mesh.faces)} faces, {size} large, volume {mesh.volume:.4g}, in the unit of the file")
    print(f"half of the contacts are nearer than {mesh.metadata['distance']:.3g} to it")
    with atomic_output(options.output, force=True) as path:
        write_mesh(path, mesh)
    print(options.output)


if __name__ == "__main__":
    main()
