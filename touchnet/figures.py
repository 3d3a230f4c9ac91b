"""Pictures of meshes and touches without a graphics card: a small software renderer and contact sheets of its tiles.

Up is +y, as in the model's cube. The camera is orthographic.
"""

import itertools
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from matplotlib import colormaps, font_manager
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from touchnet.data import GaussianProcess, Touches
from touchnet.metrics import is_closed, sample_surface
from touchnet.outputs import atomic_output
from touchnet.raster import cover

Picture = NDArray[np.uint8]  # (H, W, 3)
Tile = trimesh.Trimesh | NDArray[np.generic] | str | None

PAPER = (255, 255, 255)
INK = (40, 44, 52)
SURFACE = (0.62, 0.71, 0.80)
BACK_FACE = (0.80, 0.45, 0.38)  # seen only through holes
TOUCH = (0.85, 0.35, 0.13)
SUPERSAMPLING = 3
CREASE = np.cos(np.radians(40))  # faces that meet at more are not smoothed into each other
KEY_LIGHT = np.array([-0.45, 0.65, 0.62])  # directions in the camera's axes: right, up, towards the viewer
FILL_LIGHT = np.array([0.75, 0.05, 0.55])


class View(NamedTuple):
    """An orthographic camera."""

    turn: NDArray[np.float64]  # (3, 3): the rows point right, up and towards the viewer
    centre: NDArray[np.float64]  # (3,) of the picture
    reach: float  # from the centre to the edges of the square picture

    @classmethod
    def of(cls, points: ArrayLike, *, azimuth: float = 35.0, elevation: float = 22.0, margin: float = 1.08) -> "View":
        """The view that shows all of the points (N, 3), from `azimuth` degrees around +y and `elevation` above."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        around, above = np.radians(azimuth), np.radians(elevation)
        towards = np.array([np.sin(around) * np.cos(above), np.sin(above), np.cos(around) * np.cos(above)])
        right = np.array([np.cos(around), 0.0, -np.sin(around)])
        turn = np.stack([right, np.cross(towards, right), towards])
        seen = points @ turn.T if len(points) else np.zeros((1, 3))
        low, high = seen.min(axis=0), seen.max(axis=0)
        reach = margin * float((high - low)[:2].max()) / 2
        return cls(turn, (low + high) / 2 @ turn, reach if reach > 0 else 1.0)

    def project(self, points: ArrayLike, size: int) -> NDArray[np.float64]:
        """Points (N, 3) to (column, row, nearness), pixel centres at integers; nearness in the same unit as columns."""
        seen = (np.asarray(points, dtype=np.float64) - self.centre) @ self.turn.T
        pixels = seen * (size / (2 * self.reach))
        return np.stack([pixels[:, 0] + (size - 1) / 2, (size - 1) / 2 - pixels[:, 1], pixels[:, 2]], axis=1)


class _Canvas:
    """Colour and depth of a square picture, `SUPERSAMPLING` times finer than what is shown."""

    def __init__(self, view: View, size: int) -> None:
        self.view = view
        self.size = size * SUPERSAMPLING
        self.depth = np.full(self.size * self.size, -np.inf)
        self.colour = np.ones((self.size * self.size, 3))

    def nearest(self, pixel: NDArray[np.int64], depth: NDArray[np.float64]) -> NDArray[np.int64]:
        """Which of the fragments (N,) stay visible, at most one a pixel; their depths are noted."""
        order = np.argsort(depth)
        last = np.full(self.size * self.size, -1)
        last[pixel[order]] = order  # of several writes to one element the last, nearest one stays
        visible = last[last >= 0]
        visible = visible[depth[visible] > self.depth[pixel[visible]]]
        self.depth[pixel[visible]] = depth[visible]
        return visible

    def mesh(self, mesh: trimesh.Trimesh, colours: NDArray[np.float64]) -> None:
        """Draws a mesh whose vertices have colours (V, 3) in [0, 1]."""
        faces = np.asarray(mesh.faces)
        normals = _corner_normals(mesh) @ self.view.turn.T  # (F, 3 corners, 3)
        projected = self.view.project(mesh.vertices, self.size)
        if is_closed(faces):  # then no back of a face is ever seen
            a, b, c = (projected[faces[:, corner], :2] for corner in range(3))
            first, second = b - a, c - a
            front = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
            faces, normals = faces[front], normals[front]
        for part in cover(projected[:, :2], faces, (0, 0), (self.size, self.size)):
            pixel = part.j * self.size + part.i
            depth = (part.weights * projected[:, 2][faces[part.face]]).sum(axis=1)
            seen = self.nearest(pixel, depth)
            face, weights = part.face[seen], part.weights[seen, :, None]
            normal = (weights * normals[face]).sum(axis=1)
            colour = (weights * colours[faces[face]]).sum(axis=1)
            # Rows count downwards, so a face turned to the viewer runs clockwise over them.
            back = part.left[seen]
            normal[back] *= -1
            colour[back] = BACK_FACE
            self.colour[pixel[seen]] = _lit(colour, normal)

    def balls(self, points: NDArray[np.float64], colours: NDArray[np.float64], radius: float) -> None:
        """Draws points (N, 3) as balls of `radius` pixels of the shown picture."""
        radius *= SUPERSAMPLING
        side = np.arange(-int(radius), int(radius) + 1)
        column, row = (axis.ravel() for axis in np.meshgrid(side, side))
        within = column**2 + row**2 <= radius**2
        column, row = column[within], row[within]
        height = np.sqrt(radius**2 - column**2 - row**2)
        normal = np.stack([column, -row, height], axis=1) / radius
        projected = self.view.project(points, self.size)
        at = np.round(projected[:, :2]).astype(np.int64)
        columns, rows = at[:, :1] + column, at[:, 1:] + row  # (N, K)
        seen = (columns >= 0) & (columns < self.size) & (rows >= 0) & (rows < self.size)
        ball, part = np.nonzero(seen)
        pixel = (rows * self.size + columns)[seen]
        visible = self.nearest(pixel, projected[ball, 2] + height[part])
        self.colour[pixel[visible]] = _lit(colours[ball[visible]], normal[part[visible]])

    def picture(self) -> Picture:
        size = self.size
        depth = self.depth.reshape(size, size)
        colour = self.colour.reshape(size, size, 3)
        drawn = np.isfinite(depth)
        if drawn.any():
            # Where the surroundings are nearer than the surface itself less light arrives; and edges against
            # something farther stand out.
            near, far = depth[drawn].max(), depth[drawn].min()
            shown = np.where(drawn, depth, far).astype(np.float32)
            for sigma, strength in ((0.006, 0.35), (0.03, 0.55)):
                lift = (gaussian_filter(shown, sigma * size) - shown) / (sigma * size * 4)
                colour = colour * np.where(drawn, 1 - strength * np.clip(lift, 0, 0.6), 1)[..., None]
            haze = 0.16 * (near - depth[drawn]) / max(near - far, 1e-9)
            colour[drawn] = colour[drawn] * (1 - haze[:, None]) + haze[:, None]
        small = colour.reshape(size // SUPERSAMPLING, SUPERSAMPLING, -1, SUPERSAMPLING, 3).mean(axis=(1, 3))
        return np.round(255 * np.clip(small, 0, 1)).astype(np.uint8)


def _lit(colour: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1)
    key, fill = (np.clip(normal @ (light / np.linalg.norm(light)), 0, 1) for light in (KEY_LIGHT, FILL_LIGHT))
    sky = 0.5 + 0.5 * normal[:, 1]
    return colour * (0.34 + 0.62 * key + 0.14 * fill + 0.16 * sky)[:, None] + 0.10 * (key**24)[:, None]


def _corner_normals(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(F, 3, 3) normals at the corners of the faces: smooth over gentle edges, flat at creases."""
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    triangles = vertices[faces]
    flat = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])  # length: twice the area
    smooth = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(smooth, faces[:, corner], flat)
    smooth = _unit(smooth)[faces]
    flat = np.repeat(_unit(flat)[:, None], 3, axis=1)
    gentle = (smooth * flat).sum(axis=-1, keepdims=True) > CREASE
    return np.where(gentle, smooth, flat)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def draw_mesh(
    mesh: trimesh.Trimesh,
    *,
    size: int = 256,
    view: View | None = None,
    colour: tuple[float, float, float] = SURFACE,
    values: ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
) -> Picture:
    """Picture of a mesh; the insides of faces, seen through holes, are red.

    Args:
        mesh: faces counter-clockwise seen from outside.
        size: pixels a side.
        view: the camera; by default one that shows the whole mesh.
        colour: of the surface, red, green and blue in [0, 1].
        values: (V,) numbers shown as colours instead (viridis).
        limits: the values at the ends of the colour scale; by default the least and the greatest.
    """
    canvas = _Canvas(view or View.of(mesh.vertices), size)
    if values is None:
        colours = np.broadcast_to(np.asarray(colour, dtype=np.float64), (len(mesh.vertices), 3))
    else:
        colours = _coloured(values, len(mesh.vertices), limits, "viridis")
    canvas.mesh(mesh, colours)
    return canvas.picture()


def draw_touches(
    points: ArrayLike,
    *,
    size: int = 256,
    view: View | None = None,
    colour: tuple[float, float, float] = TOUCH,
    values: ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
    radius: float | None = None,
    mesh: trimesh.Trimesh | None = None,
) -> Picture:
    """Picture of touches as balls, farther ones paler, with the touched mesh behind them if given.

    Args:
        points: (N, 3); rows that are not finite are left out.
        size: pixels a side.
        view: the camera; by default one that shows all of the points and the mesh.
        colour: of the balls.
        values: (N,) numbers shown as colours instead (plasma), such as the order of touch.
        limits: the values at the ends of the colour scale.
        radius: of a ball in pixels; by default smaller where there are many.
        mesh: drawn as well.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {points.shape}")
    if values is None:
        colours = np.broadcast_to(np.asarray(colour, dtype=np.float64), points.shape)
    else:
        colours = _coloured(values, len(points), limits, "plasma")
    finite = np.isfinite(points).all(axis=1)
    points, colours = points[finite], colours[finite]
    if view is None:
        view = View.of(points if mesh is None else np.concatenate([points, mesh.vertices]))
    if radius is None:
        radius = size / 256 * float(np.clip(40 / np.sqrt(max(len(points), 1)), 1.2, 3.5))
    canvas = _Canvas(view, size)
    if mesh is not None:
        canvas.mesh(mesh, np.broadcast_to(np.array([0.84, 0.86, 0.88]), (len(mesh.vertices), 3)))
    if len(points):
        canvas.balls(points, colours, radius)
    return canvas.picture()


def _coloured(values: ArrayLike, count: int, limits: tuple[float, float] | None, scale: str) -> NDArray[np.float64]:
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (count,):
        raise ValueError(f"values must have shape ({count},), one for each point, got {values.shape}")
    low, high = limits if limits is not None else (values.min(initial=np.inf), values.max(initial=-np.inf))
    return np.asarray(colormaps[scale](np.clip((values - low) / max(high - low, 1e-300), 0, 1)))[:, :3]


# contact sheets.


def save_gallery(
    path: str | os.PathLike[str],
    rows: Iterable[Sequence[Tile]],
    *,
    titles: Sequence[str] | None = None,
    size: int = 256,
    azimuth: float = 35.0,
    elevation: float = 22.0,
) -> None:
    """Writes a PNG of rows of tiles, such as touches, reconstruction and truth of one shape.

    All tiles of a row share one view, that of its last mesh (of its points, without a mesh).

    Args:
        path: of the file, which appears whole or not at all.
        rows: each a sequence of tiles: a mesh, points (N, 3), a finished picture (H, W, 3) uint8, `None` for a method
            that gave no surface; strings are the row's caption.
        titles: of the columns; by default touches, reconstruction, truth where rows have three tiles.
        size: pixels a side of a tile.
        azimuth, elevation: of the camera, in degrees.

    Raises:
        ValueError: no row, a tile of another shape, or titles that do not fit the number of tiles.
    """
    captions, pictures = [], []
    for row in rows:
        captions.append("   ".join(tile for tile in row if isinstance(tile, str)))
        tiles = [tile for tile in row if not isinstance(tile, str)]
        pictures.append(draw_row(tiles, size=size, azimuth=azimuth, elevation=elevation))
    columns = max((len(row) for row in pictures), default=0)
    if columns == 0:
        raise ValueError("rows must hold at least one tile, got none")
    if titles is None:
        titles = ("touches", "reconstruction", "truth") if columns == 3 else ()
    if len(titles) not in (0, columns):
        raise ValueError(f"titles must name the {columns} columns, got {len(titles)}")

    gap, text = max(2, size // 32), max(11, size // 17)
    head = int(2.0 * text) if titles else gap
    caption = int(1.6 * text) if any(captions) else 0
    height = head + len(pictures) * (caption + size + gap)
    sheet = Image.new("RGB", (gap + columns * (size + gap), height), PAPER)
    pen = ImageDraw.Draw(sheet)
    font, bold = _font(text, "normal"), _font(text, "bold")
    for column, title in enumerate(titles):
        middle = gap + column * (size + gap) + size // 2
        pen.text((middle, head // 2), title, fill=INK, font=bold, anchor="mm")
    for index, (words, row) in enumerate(zip(captions, pictures, strict=True)):
        top = head + index * (caption + size + gap)
        if caption:
            pen.line([(gap, top + 1), (sheet.width - gap, top + 1)], fill=(222, 225, 230))
            pen.text((gap, top + caption // 2 + 1), words, fill=INK, font=font, anchor="lm")
        for column, picture in enumerate(row):
            corner = (gap + column * (size + gap), top + caption)
            if picture is None:
                middle = (corner[0] + size // 2, corner[1] + size // 2)
                pen.text(middle, "no surface", fill=(150, 155, 165), font=font, anchor="mm")
            else:
                sheet.paste(Image.fromarray(picture), corner)
    with atomic_output(Path(path), force=True) as temporary:
        sheet.save(temporary, format="PNG")


def save_exploration(
    path: str | os.PathLike[str],
    mesh: trimesh.Trimesh,
    touches: Touches,
    *,
    counts: Sequence[int] | None = None,
    gp: GaussianProcess | None = None,
    size: int = 256,
) -> None:
    """Writes a PNG of an exploration as it goes on (as figure 4 of the paper): contacts, and what is still unknown.

    The upper row shows the contacts so far on the mesh, coloured by their order; the lower row the surface coloured by
    the posterior variance, from dark (known) to light (nothing known).

    Args:
        path: of the file, which appears whole or not at all.
        mesh: that was touched.
        touches: contacts in order, in the frame of the mesh.
        counts: numbers of contacts to show, ascending; by default a 64th, a 16th, a quarter and all of them.
        gp: an empty Gaussian process to which the contacts are added; by default one like the exploration's.
        size: pixels a side of a tile.

    Raises:
        ValueError: no contacts, or counts that are not ascending within their number.
    """
    n = len(touches.points)
    if n == 0:
        raise ValueError("touches must hold at least one contact, got none")
    counts = sorted({max(1, n // part) for part in (64, 16, 4, 1)}) if counts is None else list(counts)
    if not counts or counts[0] < 1 or counts[-1] > n or any(b <= a for a, b in itertools.pairwise(counts)):
        raise ValueError(f"counts must ascend from at least 1 to at most {n}, got {counts}")
    longest = float(mesh.extents.max())
    gp = gp or GaussianProcess("matern32", length_scale=0.15 * longest)
    # The variance changes over a few hundredths of the side: large faces are cut up to show it, and it is
    # interpolated from a few thousand places to the vertices.
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.04 * longest, max_iter=12)
    fine = trimesh.Trimesh(vertices, faces, process=False)
    places, _ = sample_surface(fine, 4000, generator=np.random.default_rng(0))
    distance, near = cKDTree(places).query(fine.vertices, k=3)
    weights = 1 / (distance + 1e-3 * longest)
    weights /= weights.sum(axis=1, keepdims=True)

    view = View.of(mesh.vertices)
    above, below, known = [], [], 0
    for count in counts:
        gp.add(touches.points[known:count])
        known = count
        order = np.arange(count)
        above.append(draw_touches(touches.points[:count], size=size, view=view, values=order, mesh=mesh, limits=(0, n)))
        values = (gp.variance(places)[near] * weights).sum(axis=1)
        below.append(draw_mesh(fine, size=size, view=view, values=values, limits=(0, 1)))
    strokes = [len(np.unique(touches.strokes[:count])) for count in counts]
    titles = [f"contacts: {count}, strokes: {stroke}" for count, stroke in zip(counts, strokes, strict=True)]
    save_gallery(path, [("contacts, by order", *above), ("variance", *below)], titles=titles, size=size)


def draw_row(
    tiles: Sequence[Tile], *, size: int = 256, azimuth: float = 35.0, elevation: float = 22.0
) -> list[Picture | None]:
    """Pictures of the tiles of a row (see `save_gallery`), all under one view; `None` for what has no surface."""
    meshes = [tile for tile in tiles if isinstance(tile, trimesh.Trimesh) and len(tile.faces)]
    clouds = [tile for tile in tiles if isinstance(tile, np.ndarray) and tile.shape[1:] == (3,)]
    shown = [meshes[-1].vertices] if meshes else clouds[-1:]
    view = View.of(np.concatenate(shown) if shown else np.zeros((0, 3)), azimuth=azimuth, elevation=elevation)
    drawn: list[Picture | None] = []
    for tile in tiles:
        if isinstance(tile, trimesh.Trimesh):
            drawn.append(draw_mesh(tile, size=size, view=view) if len(tile.faces) else None)
        elif tile is None:
            drawn.append(None)
        elif isinstance(tile, np.ndarray) and tile.shape[1:] == (3,):
            drawn.append(draw_touches(tile, size=size, view=view))
        elif isinstance(tile, np.ndarray) and tile.shape[2:] == (3,) and tile.dtype == np.uint8:
            fits = tile.shape[:2] == (size, size)
            drawn.append(tile if fits else np.asarray(Image.fromarray(tile).resize((size, size))))
        else:
            kind = f"{tile.dtype} of shape {tile.shape}" if isinstance(tile, np.ndarray) else type(tile).__name__
            raise ValueError(f"a tile must be a mesh, points (N, 3), a picture (H, W, 3) of uint8 or None, got {kind}")
    return drawn


def _font(size: int, weight: str) -> ImageFont.FreeTypeFont:
    # The font that matplotlib brings along, so pictures look the same everywhere.
    return ImageFont.truetype(
        font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight=weight)), size
    )
