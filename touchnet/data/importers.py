"""Finding meshes: plain files and folders, folders with an INDEX.csv, and the layouts of published data sets."""

import csv
import functools
import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import trimesh

from touchnet.data.dataset import SPLITS, is_below
from touchnet.data.factory import MeshSource, shape_id
from touchnet.data.files import read_mesh

MESH_SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb", ".gltf", ".3mf", ".dae", ".usda", ".vtk", ".msh", ".inp")
LAYOUTS = ("auto", "index", "files", "shapenet", "modelnet", "shapenet_touch")

# ShapeNet names its categories by WordNet synset: those of ShapeNetCore.
SYNSETS = {
    "02691156": "airplane",
    "02747177": "trash bin",
    "02773838": "bag",
    "02801938": "basket",
    "02808440": "bathtub",
    "02818832": "bed",
    "02828884": "bench",
    "02843684": "birdhouse",
    "02858304": "boat",
    "02871439": "bookshelf",
    "02876657": "bottle",
    "02880940": "bowl",
    "02924116": "bus",
    "02933112": "cabinet",
    "02942699": "camera",
    "02946921": "can",
    "02954340": "cap",
    "02958343": "car",
    "02992529": "cellphone",
    "03001627": "chair",
    "03046257": "clock",
    "03085013": "keyboard",
    "03207941": "dishwasher",
    "03211117": "display",
    "03261776": "earphone",
    "03325088": "faucet",
    "03337140": "file cabinet",
    "03467517": "guitar",
    "03513137": "helmet",
    "03593526": "jar",
    "03624134": "knife",
    "03636649": "lamp",
    "03642806": "laptop",
    "03691459": "loudspeaker",
    "03710193": "mailbox",
    "03759954": "microphone",
    "03761084": "microwave",
    "03790512": "motorbike",
    "03797390": "mug",
    "03928116": "piano",
    "03938244": "pillow",
    "03948459": "pistol",
    "03991062": "flowerpot",
    "04004475": "printer",
    "04074963": "remote control",
    "04090263": "rifle",
    "04099429": "rocket",
    "04225987": "skateboard",
    "04256520": "sofa",
    "04330267": "stove",
    "04379243": "table",
    "04401088": "telephone",
    "04460130": "tower",
    "04468005": "train",
    "04530566": "watercraft",
    "04554684": "washing machine",
}


def find_meshes(
    paths: Iterable[str | Path], *, layout: str = "auto", shares: tuple[float, float] = (0.1, 0.1)
) -> list[MeshSource]:
    """The meshes in files and folders, with ids, splits and licences as far as they are known.

    Layouts (auto: the first that fits, in this order):
        index: a folder with INDEX.csv (columns category, split, file, source, licence).
        shapenet_touch: the paper's data set, ShapeNetTouch.json beside complete/<synset>/<id>.obj (or a folder <id>).
        shapenet: ShapeNetCore v1 <synset>/<id>/model.obj or v2 <synset>/<id>/models/model_normalized.obj.
        modelnet: <class>/train/*.off and <class>/test/*.off.
        files: any mesh files; the category is the name of the folder.

    Where a layout has no split (or no validation split), a hash of the id chooses: shares[0] val, shares[1] test.

    Raises:
        FileNotFoundError, ValueError: a path is missing, holds no mesh, or does not have the layout.
    """
    if layout not in LAYOUTS:
        raise ValueError(f"layout should be one of {', '.join(LAYOUTS)}, got {layout!r}")
    val, test = shares
    if val < 0 or test < 0 or val + test > 1:
        raise ValueError(f"the shares of val and test should be ≥ 0 and sum to at most 1, got {val} and {test}")
    found: list[MeshSource] = []
    for path in map(Path, paths):
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file or folder")
        kind = (_guess_layout(path) if layout == "auto" else layout) if path.is_dir() else "files"
        sources = list(_READERS[kind](path, shares))
        if not sources:
            raise ValueError(f"{path}: no meshes found" + (f" in the layout {kind}" if kind != "files" else ""))
        found += sources
    return found


def load_mesh(path: str | Path) -> trimesh.Trimesh:
    """One mesh from a file; scenes and files of several parts are joined.

    Formats that touchnet does not parse itself go to trimesh, then to meshio where it is installed.

    Raises:
        ValueError, OSError: one line that names the file.
    """
    path = Path(path)
    if path.suffix.lower() in (".ply", ".obj", ".off", ".stl", ".glb"):
        return read_mesh(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # third-party readers raise whatever a damaged or unknown file makes them stumble over
        mesh = _load_by_meshio(path, error)
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ValueError(f"{path}: expected a mesh, found no faces")
    return mesh


def _load_by_meshio(path: Path, first: Exception) -> trimesh.Trimesh:
    try:
        import meshio
    except ImportError:
        raise ValueError(f"{path}: not a readable mesh ({type(first).__name__}: {first})") from None
    try:
        said = meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio leaves the interpreter on some files
        raise ValueError(f"{path}: not a readable mesh ({type(error).__name__}: {error})") from None
    faces = [block.data for block in said.cells if block.type == "triangle"]
    faces += [block.data[:, order] for block in said.cells if block.type == "quad" for order in ([0, 1, 2], [0, 2, 3])]
    if not faces:
        raise ValueError(f"{path}: expected a mesh, found no faces")
    import numpy as np

    return trimesh.Trimesh(said.points[:, :3], np.concatenate(faces), process=False)


def _source(identity: str, split: str, path: Path, source: str, licence: str) -> MeshSource:
    # The size stands for the contents: reading every file of a large collection before the first shape would take long.
    return MeshSource(
        identity, split, functools.partial(load_mesh, path), f"{path.stat().st_size} bytes", source, licence
    )


def _by_hash(identity: str, shares: tuple[float, float]) -> str:
    place = int.from_bytes(hashlib.sha256(identity.encode()).digest()[:8], "big") / 2**64
    val, test = shares
    return "val" if place < val else "test" if place < val + test else "train"


def _guess_layout(folder: Path) -> str:
    if (folder / "INDEX.csv").is_file():
        return "index"
    if (folder / "ShapeNetTouch.json").is_file():
        return "shapenet_touch"
    children = [child for child in folder.iterdir() if child.is_dir()]
    if any(child.name in SYNSETS for child in children):
        return "shapenet"
    if any((child / "train").is_dir() and any((child / "train").glob("*.off")) for child in children):
        return "modelnet"
    return "files"


def _read_index(folder: Path, shares: tuple[float, float]) -> Iterator[MeshSource]:
    with (folder / "INDEX.csv").open(newline="", encoding="utf-8-sig") as file:
        rows = csv.DictReader(file)
        missing = {"category", "file"} - set(rows.fieldnames or ())
        if missing:
            raise ValueError(f"{folder / 'INDEX.csv'}: no column {', '.join(sorted(missing))}")
        for row in rows:
            path = folder / row["file"]
            if not is_below(row["file"]):
                raise ValueError(f"{folder / 'INDEX.csv'}, line {rows.line_num}: {row['file']!r} leaves the folder")
            if not path.is_file():
                raise FileNotFoundError(f"{folder / 'INDEX.csv'}, line {rows.line_num}: {row['file']} is missing")
            identity = shape_id(row["category"], path.stem)
            split = row.get("split") or _by_hash(identity, shares)
            if split not in SPLITS:
                raise ValueError(f"{folder / 'INDEX.csv'}, line {rows.line_num}: split {split!r} is not known")
            yield _source(identity, split, path, row.get("source") or "unknown", row.get("licence") or "unknown")


def _read_files(path: Path, shares: tuple[float, float]) -> Iterator[MeshSource]:
    if path.is_file():
        identity = shape_id(path.resolve().parent.name or "mesh", path.stem)
        yield _source(identity, _by_hash(identity, shares), path, "unknown", "unknown")
        return
    for file in sorted(path.rglob("*")):
        if file.suffix.lower() in MESH_SUFFIXES and file.is_file():
            inner = file.relative_to(path).with_suffix("")
            category = inner.parts[0] if len(inner.parts) > 1 else path.resolve().name
            identity = shape_id(category, "-".join(inner.parts[1:] or inner.parts))
            yield _source(identity, _by_hash(identity, shares), file, "unknown", "unknown")


def _read_shapenet(folder: Path, shares: tuple[float, float]) -> Iterator[MeshSource]:
    for synset in sorted(child for child in folder.iterdir() if child.name in SYNSETS):
        for model in sorted(child for child in synset.iterdir() if child.is_dir()):
            for name in ("models/model_normalized.obj", "model.obj", "models/model.obj"):
                if (model / name).is_file():
                    identity = shape_id(SYNSETS[synset.name], model.name)
                    yield _source(identity, _by_hash(identity, shares), model / name, "ShapeNetCore", "ShapeNet terms")
                    break


def _read_modelnet(folder: Path, shares: tuple[float, float]) -> Iterator[MeshSource]:
    for kind in sorted(child for child in folder.iterdir() if child.is_dir()):
        for given in ("train", "test"):
            for path in sorted((kind / given).glob("*.off")):
                identity = shape_id(kind.name, path.stem)
                split = given
                if given == "train" and _by_hash(identity, (shares[0], 0.0)) == "val":
                    split = "val"  # ModelNet has none of its own
                yield _source(identity, split, path, "ModelNet", "ModelNet terms")


def _read_shapenet_touch(folder: Path, shares: tuple[float, float]) -> Iterator[MeshSource]:
    for category, split, model, complete, _ in shapenet_touch_items(folder):
        if complete is not None:
            yield _source(shape_id(category, model), split, complete, "ShapeNetTouch", "ShapeNet terms")


def shapenet_touch_items(folder: str | Path) -> Iterator[tuple[str, str, str, Path | None, list[Path]]]:
    """What the paper's data set lists: category, split, model, its complete mesh (or None), its recorded trajectories.

    ShapeNetTouch.json is a list of categories, each with `taxonomy_id`, `taxonomy_name` and the lists of model ids
    `train`, `test` and `val`; files lie in complete/<synset>/<model>.obj (or in a folder of that name) and
    partial/<synset>/<model>/path2048_00.pcd, _01 and so on; some copies have a folder train, test
    or val above <synset>.
    """
    folder = Path(folder)
    path = folder / "ShapeNetTouch.json"
    try:
        said: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
        lists = [
            (str(one["taxonomy_id"]), str(one.get("taxonomy_name", "")), split, list(map(str, one.get(split, ()))))
            for one in said
            for split in SPLITS
        ]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: not a list of categories with taxonomy_id, train, test and val ({error})") from error
    for synset, name, split, models in lists:
        category = SYNSETS.get(synset, name or synset)
        for model in models:
            complete: Path | None = None
            partial: list[Path] = []
            for above in ("", split):
                base = folder / "complete" / above / synset
                meshes = [base / f"{model}.obj", *sorted((base / model).rglob("*.obj"))]
                complete = complete or next((mesh for mesh in meshes if mesh.is_file()), None)
                partial = partial or sorted((folder / "partial" / above / synset / model).glob("*.pcd"))
            yield category, split, model, complete, partial


_READERS = {
    "index": _read_index,
    "files": _read_files,
    "shapenet": _read_shapenet,
    "modelnet": _read_modelnet,
    "shapenet_touch": _read_shapenet_touch,
}
