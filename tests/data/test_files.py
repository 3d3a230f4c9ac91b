"""Reading points and meshes: every case of the shared folder's group F, the formats around them, and damaged files."""

import io
import json
import locale
import re
import shutil
import struct
import subprocess
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from touchnet.data.files import MESH_SUFFIXES, Points, check_float32, read_mesh, read_points, split_strokes, write_mesh
from touchnet.data.readers.pcd import decompress_lzf
from touchnet.data.readers.rows import POINT_SUFFIXES
from touchnet.meshes import check_closed

XYZ = np.array([[0.5, -1.25, 2.0], [1e-3, 4.0, -0.75], [3.0, 0.0, 7.5], [-2.5, 1.0, 0.125]])
F05 = "F05_plain_for_locale_test.xyz"
NORMALS = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0, -0.8]])


def write(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def rows(values, delimiter=" "):
    return "".join(delimiter.join(f"{value:.17g}" for value in row) + "\n" for row in values)


@pytest.fixture(autouse=True)
def quiet_means_quiet():
    """A warning that a test does not expect is a failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


# the shared cases.


@pytest.fixture
def cases(shared_data):
    return shared_data / "cases"


@pytest.fixture
def plain(cases):
    text = (cases / F05).read_text()
    return np.array([[float(word) for word in line.split()] for line in text.splitlines()])


def test_f01_nan_row_is_dropped_and_counted(cases):
    with pytest.warns(UserWarning, match=r"dropped 1 of 5 rows .*\(first: line 3\)"):
        points = read_points(cases / "F01_nan_row.xyz")
    assert points.points.shape == (4, 3)
    assert points.dropped == 1
    assert np.isfinite(points.points).all()
    with pytest.raises(ValueError, match=r"F01_nan_row\.xyz: expected finite coordinates, found 1 of 5 .*line 3"):
        read_points(cases / "F01_nan_row.xyz", strict=True)


@pytest.mark.parametrize(
    "name",
    [
        "F03_comma_separated.xyz",
        F05,
        "F06_crlf_ascii.ply",
        "F08_points_only.ply",
        "F10_binary_mixed_fields.pcd",
        "F19_xyzrgb_header.txt",
        "F25_no_final_newline.ply",
    ],
)
def test_f_cases_hold_the_same_12_points(cases, plain, name):
    points = read_points(cases / name, strict=True)
    # The PCD holds float32 of more digits than the text.
    assert np.abs(points.points - plain).max() <= (1e-6 if name.endswith(".pcd") else 0)
    assert points.dropped == 0
    assert (points.normals is not None) == (name == "F25_no_final_newline.ply")
    if points.normals is not None:
        assert np.allclose(np.linalg.norm(points.normals, axis=1), 1, atol=1e-15)


@pytest.fixture
def decimal_comma(tmp_path, monkeypatch):
    """A locale that writes 0,5: an installed one, or one made from the sources of `locales`."""
    old = locale.setlocale(locale.LC_NUMERIC)
    made = tmp_path / "locales"
    made.mkdir()
    if shutil.which("localedef"):
        subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", made / "de_DE.UTF-8"], capture_output=True)
        if (made / "de_DE.UTF-8").exists():
            monkeypatch.setenv("LOCPATH", str(made))
    for name in ("de_DE.UTF-8", "de_DE", "fr_FR.UTF-8", "German_Germany"):
        try:
            locale.setlocale(locale.LC_NUMERIC, name)
        except locale.Error:
            continue
        yield
        locale.setlocale(locale.LC_NUMERIC, old)
        return
    pytest.skip("no locale with a decimal comma is installed, nor the sources to make one (Debian: locales)")


def test_f05_does_not_depend_on_the_locale(cases, plain, decimal_comma, tmp_path):
    assert f"{0.5:n}" == "0,5"
    assert (read_points(cases / F05).points == plain).all()
    tetrahedron = np.array([[0.5, 0, 0], [0, 0.25, 0], [0, 0, 0.125], [0, 0, 0]])
    for name in ("mesh.ply", "mesh.obj", "mesh.stl", "mesh.glb"):
        mesh = trimesh.Trimesh(tetrahedron, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], process=False)
        write_mesh(tmp_path / name, mesh)
        np.testing.assert_allclose(trimesh.load_mesh(tmp_path / name).bounds, mesh.bounds, atol=1e-6)


def test_f13_zero_points(cases):
    with pytest.raises(ValueError, match=r"F13_zero_points\.pcd: no points in this file"):
        read_points(cases / "F13_zero_points.pcd")


def test_f15_one_point(cases):
    assert read_points(cases / "F15_one_point.xyz").points.tolist() == [[0.1, -0.2, 0.3]]


def test_f17_keeps_millimetres(cases):
    points = read_points(cases / "F17_millimetres_offset.xyz").points
    assert np.abs(np.linalg.norm(points - [61, -22.5, 403.25], axis=1) - 48).max() < 0.01


def test_f22_transposed(cases):
    with pytest.raises(ValueError, match=r"shape \(N, 3\) or \(N, 6\), found \(3, 12\) \(transpose it\)"):
        read_points(cases / "F22_transposed_3xN.npy")


def test_f27_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError) as error:
        read_points(tmp_path / "absent.ply")
    assert error.value.filename == str(tmp_path / "absent.ply")


def test_real_recording(shared_data):
    points = read_points(shared_data / "data/touches/head-digitization/headB.csv", strict=True)
    assert points.points.shape == (5151, 3)
    strokes = split_strokes(points.points)
    assert 5 <= strokes[-1] <= 60
    named = read_points(shared_data / "data/touches/head-digitization/headB_fiducials.csv")
    assert named.points[2].tolist() == [0.157477, 0.0, 0.0]


# text.


@pytest.mark.parametrize(
    "text",
    [
        rows(XYZ),
        rows(XYZ, ","),
        rows(XYZ, ", "),
        rows(XYZ, " , "),
        rows(XYZ, ";"),
        rows(XYZ, "\t"),
        rows(XYZ, "|"),
        rows(XYZ, ":"),
        rows(XYZ, "   "),
        rows(XYZ).replace("\n", "\r\n"),
        rows(XYZ).replace("\n", "\r"),
        rows(XYZ).replace("\n", "\n\n"),
        rows(XYZ).rstrip("\n"),
        rows(XYZ, ",").replace("\n", ",\n"),
        "\ufeff" + rows(XYZ),
        "# made by hand\n" + rows(XYZ) + "# the end\n",
        "// comment\n% comment\n" + rows(XYZ).replace("\n", " # contact\n"),
        "4\n" + rows(XYZ),
        "x,y,z\n" + rows(XYZ, ","),
        '"x","y","z"\n' + "".join(",".join(f'"{v:.17g}"' for v in row) + "\n" for row in XYZ),
        "X [mm]\tY [mm]\tZ [mm]\n" + rows(XYZ, "\t"),
        "//X Y Z\n" + rows(XYZ),
        "Points:0,Points:1,Points:2\n" + rows(XYZ, ","),
        "Recorded today\nx;y;z\nmm;mm;mm\n" + rows(XYZ, ";"),
        "z;x;y\n" + rows(XYZ[:, [2, 0, 1]], ";"),
        "name,time,pos_x,pos_y,pos_z\n" + "".join(f"tip{i},,{a},{b},{c}\n" for i, (a, b, c) in enumerate(XYZ)),
        rows(XYZ, ";").replace(".", ","),
        rows(XYZ, " ").replace(".", ","),
        rows(XYZ, "\t").replace(".", ","),
        "[" + ",\n ".join(str(row) for row in XYZ.tolist()) + "]\n",
        "".join(f"({a}, {b}, {c})\n" for a, b, c in XYZ),
        rows(np.hstack([XYZ, [[255, 0, 0]] * 4])),
        rows(np.hstack([XYZ, [[0.5]] * 4])),
        rows(XYZ).replace("\n", " left wing\n"),
    ],
)
def test_text_dialects(tmp_path, text):
    points = read_points(write(tmp_path, "touches.txt", text), strict=True)
    assert np.array_equal(points.points, XYZ)
    assert points == Points(points.points, None, None, 0)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1"])
def test_text_encodings(tmp_path, encoding):
    text = "# Prüfling\n" + rows(XYZ)
    assert np.array_equal(read_points(write(tmp_path, "touches.xyz", text.encode(encoding))).points, XYZ)


def test_text_normals_by_name_or_by_length(tmp_path):
    for text in (rows(np.hstack([XYZ, NORMALS])), "x y z nx ny nz\n" + rows(np.hstack([XYZ, 7 * NORMALS]))):
        points = read_points(write(tmp_path, "touches.xyz", text))
        assert np.array_equal(points.points, XYZ)
        assert np.allclose(points.normals, NORMALS, atol=1e-15)


def test_colours_are_not_normals(tmp_path):
    colours = np.tile([1.0, 0.0, 0.0], (4, 1))
    assert read_points(write(tmp_path, "touches.xyz", rows(np.hstack([XYZ, colours])))).normals is None


def test_strokes_by_name(tmp_path):
    text = "x,y,z,stroke\n" + rows(np.hstack([XYZ, [[0], [0], [1], [5]]]), ",")
    assert read_points(write(tmp_path, "touches.csv", text)).strokes.tolist() == [0, 0, 1, 5]
    with pytest.warns(UserWarning, match="1 of 4 stroke numbers that are not whole: the stroke column is not used"):
        assert read_points(write(tmp_path, "touches.csv", text.replace(",5\n", ",5.5\n"))).strokes is None


def test_a_column_of_time_is_noticed(tmp_path):
    generator = np.random.default_rng(0)
    points = generator.normal(size=(20, 3))
    path = write(tmp_path, "log.txt", rows(np.hstack([np.arange(20)[:, None] * 0.1, points])))
    with pytest.warns(UserWarning, match="column 1 grows from row to row like a time or a counter"):
        assert np.array_equal(read_points(path).points, points)
    with pytest.raises(ValueError, match="column 1 grows"):
        read_points(path, strict=True)


def test_missing_values_are_dropped(tmp_path):
    text = "x,y,z\n1,2,3\n,2,3\n4,N/A,6\n7,8,inf\n1e300,0,0\n7,8,9\n"
    with pytest.warns(UserWarning, match=r"dropped 4 of 6 rows .*first: line 3"):
        points = read_points(write(tmp_path, "touches.csv", text))
    assert points.points.tolist() == [[1, 2, 3], [7, 8, 9]]
    assert points.dropped == 4


def test_an_interrupted_last_row_is_dropped(tmp_path):
    path = write(tmp_path, "touches.csv", rows(XYZ, ",") + "1.5,0.")
    with pytest.warns(UserWarning, match="dropped the last row, which is incomplete"):
        points = read_points(path)
    assert (len(points.points), points.dropped) == (4, 1)
    with pytest.raises(ValueError, match="the last row is incomplete"):
        read_points(path, strict=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no points in an empty file"),
        ("\n \n", "no points in this file"),
        ("x y z\n", "no points in this file: only words, such as 'x y z'"),
        ("nan nan nan\n", "each of the 1 rows has a coordinate that is not a number"),
        ("1 2 3\n4 5 six\n7 8 9\n", r"line 2: expected a number in column 3, found 'six'"),
        ("1 2 3\n4 5\n7 8 9\n", r"line 2: expected 3 columns separated by white space, found 2: '4 5'"),
        ("1,2,3\n4,5,6,7\n", r"line 2: expected 3 columns separated by ',', found 4"),
        ("1 2 3\n4 5 1_0\n", r"line 2: expected a number in column 3, found '1_0'"),
        ("1 2\n3 4\n", r"line 1: expected at least 3 numbers, found '1 2'"),
        ("a b c\nd e f\n1 2\n", r"line 3: expected at least 3 numbers"),
        ("5\n1 2 3\n4 5 6\n", r"announces 5 points in line 1, found 2"),
        ("0,145,0,345,0,139\n0,2,0,045,1,5\n", r"line 2: commas seem both to separate columns"),
        ("1 " * 40_000, r"found a line of more than 65536 bytes"),
        ("0.5,1 2\n", r"line 1: expected at least 3 numbers"),
        ("Once upon a time\nthere was no cloud.\n", r"no points in this file: only words, such as 'Once upon a time'"),
    ],
)
def test_text_errors_are_one_line_and_say_where(tmp_path, text, message):
    path = write(tmp_path, "touches.txt", text)
    with pytest.raises(ValueError, match=message) as error:
        read_points(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.xyz", b"0\x1c"),  # control characters that Python counts as white space
        ("a.xyz", b"\x1f4\n1 2 3\n"),
        ("a.npz", lambda: zip_of(**{"point\n_npy": b"PICKLE"})),
        ("a.npz", lambda: zip_of(**{"point\n_npy": npy(XYZ[:, :2])})),
    ],
)
def test_what_fuzzing_found(tmp_path, name, content):
    read_or_refuse(write(tmp_path, name, content if isinstance(content, bytes) else content()))


def test_a_header_without_x_y_z(tmp_path):
    path = write(tmp_path, "touches.csv", "a,b,c\n" + rows(XYZ, ","))
    with pytest.warns(UserWarning, match="does not name x, y and z among 3 columns: columns 1-3 are taken"):
        assert np.array_equal(read_points(path).points, XYZ)


def test_binary_that_is_no_known_format(tmp_path):
    with pytest.raises(ValueError, match=r"found a binary file with the suffix '\.las'"):
        read_points(write(tmp_path, "scan.las", b"LASF\0\0\0\0"))


def test_folders_and_devices(tmp_path):
    with pytest.raises(IsADirectoryError, match="is a folder"):
        read_points(tmp_path)
    with pytest.raises(ValueError, match="found a device"):
        read_points("/dev/zero")


def test_standard_input(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(rows(XYZ).encode())))
    assert np.array_equal(read_points("-").points, XYZ)


def test_normals_that_are_not_known(tmp_path):
    normals = NORMALS.copy()
    normals[1] = 0
    header = "x y z nx ny nz\n"
    path = write(tmp_path, "touches.xyz", header + rows(np.hstack([XYZ, normals])))
    with pytest.warns(UserWarning, match="1 of 4 normals that are zero or not finite count as not known"):
        points = read_points(path)
    assert points.dropped == 0
    assert points.normals[1].tolist() == [0, 0, 0]
    with pytest.raises(ValueError, match="expected normals, found 1 of 4"):
        read_points(path, strict=True)
    normals[[0, 2]] = np.nan
    with pytest.warns(UserWarning, match="3 of 4 normals .*: no normals are used"):
        assert read_points(write(tmp_path, "touches.xyz", header + rows(np.hstack([XYZ, normals])))).normals is None


def test_very_small_normals_keep_their_direction(tmp_path):
    text = "x y z nx ny nz\n1 2 3 3e-200 0 4e-200\n"
    assert np.allclose(read_points(write(tmp_path, "t.xyz", text)).normals, [[0.6, 0, 0.8]])


# PLY.

PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "int": "i4", "float": "f4", "double": "f8"}


def ply(form, elements):
    """elements: (name, [(property, type)], rows); a list property has the type "list uchar int" and a tuple."""
    lines = ["ply", f"format {form} 1.0", "comment x", "obj_info y"]
    for name, properties, table in elements:
        lines.append(f"element {name} {len(table)}")
        lines += [f"property {kind} {label}" for label, kind in properties]
    body = b""
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    for _, properties, table in elements:
        for row in table:
            words = []
            for value, (_, kind) in zip(row, properties, strict=True):
                if kind.startswith("list"):
                    _, length, kind = kind.split()
                    words += [(length, len(value))] + [(kind, v) for v in value]
                else:
                    words.append((kind, value))
            if order is None:
                body += (" ".join(repr(v) for _, v in words) + "\n").encode()
            else:
                body += b"".join(np.array(v).astype(order + PLY_TYPES[kind]).tobytes() for kind, v in words)
    return ("\n".join([*lines, "end_header"]) + "\n").encode() + body


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("lists", ["none", "equal", "unequal"])
@pytest.mark.parametrize("kind", ["float", "double"])
def test_ply(tmp_path, form, lists, kind):
    extra = {"none": None, "equal": [(1, 2)] * 4, "unequal": [(), (1,), (1, 2, 3), (4,)]}[lists]
    names = [("red", "uchar"), ("y", kind), ("x", kind), ("z", kind), ("nx", "float"), ("ny", "float"), ("nz", "float")]
    table = [(200, y, x, z, *n) for (x, y, z), n in zip(XYZ.tolist(), NORMALS.tolist(), strict=True)]
    if extra:
        names.insert(2, ("flags", "list uchar int"))
        table = [(*row[:2], e, *row[2:]) for row, e in zip(table, extra, strict=True)]
    before = ("camera", [("path", "list uchar float"), ("id", "int")], [((0.5,), 1), ((1.0, 2.0), 2)])
    after = ("face", [("vertex_indices", "list uchar int")], [((0, 1, 2),), ((0, 1, 2, 3),)])
    content = ply(form, [before, ("vertex", [*names, ("stroke", "short")], [(*row, 3) for row in table]), after])
    points = read_points(write(tmp_path, "touches.ply", content), strict=True)
    assert np.allclose(points.points, XYZ, rtol=1e-7 if kind == "float" else 0, atol=0)
    assert np.allclose(points.normals, NORMALS, atol=1e-7)
    assert points.strokes.tolist() == [3] * 4


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"ply\nformat ascii 1.0\n", "expected a line end_header"),
        (b"ply\nformat ascii 1.0\nend_header\n", "expected an element vertex, found none"),
        (ply("ascii", [("vertex", [(c, "float") for c in "xyz"], [])]), r"no points in this file \(element vertex 0\)"),
        (b"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "line 3: not a line of a PLY header"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n", "line 4: not a line"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "x, y, z, found 'x'"),
        (b"ply\nformat text 1.0\nelement vertex 1\nend_header\n", "expected the format ascii or binary"),
        (b"plywood\n", "expected a PLY file, found one that starts with"),
        (ply("ascii", [("vertex", [(c, "float") for c in "xyz"], [(1.0, 2.0, 3.0)])]) + b"4 5 6\n", "found more"),
        (
            ply("ascii", [("vertex", [(c, "float") for c in "xyz"], [(1.0, 2.0, 3.0)] * 2)])[:-4],
            "line 11: expected 3 columns, found 2|announces 2",
        ),
        (
            ply("binary_big_endian", [("vertex", [(c, "float") for c in "xyz"], [(1.0, 2.0, 3.0)] * 2)])[:-1],
            r"announces 2 of element vertex \(24 bytes\), found 23 bytes",
        ),
    ],
)
def test_ply_errors(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        read_points(write(tmp_path, "touches.ply", content))


# PCD.


def lzf_pack(data):
    """The simplest LZF: literals, except that runs of one byte become an overlapping copy."""
    out, at = b"", 0
    while at < len(data):
        run = 1
        while at + run < len(data) and data[at + run] == data[at] and run < 200:
            run += 1
        if run >= 12:
            out += bytes([0, data[at], 7 << 5, run - 1 - 9, 0])  # one literal, then 2 + 7 + n bytes from 1 byte back
            at += run
        else:
            out += bytes([0, data[at]])
            at += 1
    return out


def pcd(form, points):
    fields = [("x", "F", 4), ("y", "F", 4), ("z", "F", 4), ("_", "U", 1), ("normal_x", "F", 4), ("normal_y", "F", 4)]
    fields += [("normal_z", "F", 4), ("label", "I", 8)]
    count = len(points)
    table = np.zeros(count, dtype=[(n, ("<" + t.lower() + str(s)).replace("<u1", "u1")) for n, t, s in fields])
    table["x"], table["y"], table["z"] = points.T
    table["normal_y"] = 2
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {' '.join(f[0] for f in fields)}\n"
        f"SIZE {' '.join(str(f[2]) for f in fields)}\nTYPE {' '.join(f[1] for f in fields)}\n"
        f"COUNT {' '.join('1' for _ in fields)}\nWIDTH {count // 2}\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {count}\nDATA {form}\n"
    ).encode()
    if form == "ascii":
        return header + "".join(" ".join(str(v) for v in row) + "\n" for row in table.tolist()).encode()
    if form == "binary":
        return header + table.tobytes()
    plain = b"".join(table[name].tobytes() for name in table.dtype.names)
    packed = lzf_pack(plain)
    return header + struct.pack("<II", len(packed), len(plain)) + packed


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path, form):
    points = read_points(write(tmp_path, "touches.pcd", pcd(form, XYZ)), strict=True)
    assert np.allclose(points.points, XYZ, rtol=1e-7, atol=0)
    assert np.array_equal(points.normals, [[0, 1, 0]] * 4)


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_pcd_organised_with_holes(tmp_path, form):
    points = np.full((40, 3), np.nan)
    points[::10] = XYZ
    with pytest.warns(UserWarning, match="dropped 36 of 40 rows"):
        read = read_points(write(tmp_path, "touches.pcd", pcd(form, points)))
    assert np.allclose(read.points, XYZ, rtol=1e-7, atol=0)
    assert read.dropped == 36


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (pcd("binary", XYZ)[:-1], r"announces 4 points \(132 bytes\), found 131 bytes"),
        (pcd("binary_compressed", XYZ)[:-1], r"announces \d+ compressed bytes, found"),
        (pcd("ascii", XYZ) + b"1 2 3 0 0 1 0 0\n", "announces 4 points, found 5"),
        (pcd("binary", XYZ).replace(b"POINTS 4", b"POINTS 400000000000"), "announces 400000000000 POINTS but WIDTH"),
        (pcd("binary", XYZ).replace(b"POINTS 4", b"POINTS many"), "expected whole numbers after POINTS, found 'many'"),
        (pcd("binary", XYZ).replace(b"FIELDS x", b"FIELDS q"), "expected the fields x, y, z, found 'q y z"),
        (pcd("binary", XYZ).replace(b"SIZE 4", b"SIZE 3"), "found F of 3"),
        (pcd("binary", XYZ).replace(b"DATA binary", b"DATA zip"), "expected DATA ascii, binary or binary_compressed"),
        (pcd("binary", XYZ).replace(b"COUNT 1 ", b"COUNT "), "expected as many SIZE, TYPE and COUNT as FIELDS"),
        (b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\n", "expected a line DATA"),
    ],
)
def test_pcd_errors(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        read_points(write(tmp_path, "touches.pcd", content))


def test_pcd_that_would_explode(tmp_path):
    content = (
        pcd("binary_compressed", XYZ).replace(b"WIDTH 2", b"WIDTH 2000000").replace(b"POINTS 4", b"POINTS 4000000")
    )
    body = content.index(b"binary_compressed\n") + len("binary_compressed\n")
    content = content[: body + 4] + struct.pack("<I", 4000000 * 33) + content[body + 8 :]
    with pytest.raises(ValueError, match="would expand to 132000000, more than tenfold"):
        read_points(write(tmp_path, "touches.pcd", content))


def testdecompress_lzf():
    assert decompress_lzf(memoryview(bytes([2]) + b"abc" + bytes([(4 << 5), 2])), 9, "f") == b"abcabcabc"
    plain = b"touch" + b"\0" * 900 + b"net" * 7
    assert decompress_lzf(memoryview(lzf_pack(plain)), len(plain), "f") == plain
    for packed in (bytes([40, 0]), bytes([3]) + b"ab", bytes([7 << 5]), bytes([0])):
        with pytest.raises(ValueError, match="damaged"):
            decompress_lzf(memoryview(packed), 9, "f")
    with pytest.raises(ValueError, match="expected 9 bytes after decompression, found 1"):
        decompress_lzf(memoryview(b"\0a"), 9, "f")


# NumPy.


def npy(array, **options):
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


def npz(save=np.savez, **arrays):
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


@pytest.mark.parametrize(
    "array",
    [
        XYZ,
        XYZ.astype(">f8"),
        np.asfortranarray(XYZ),
        XYZ.reshape(2, 2, 3),
        XYZ[None],
        np.hstack([XYZ, [[0.5]] * 4]),
        np.array([tuple(row) for row in XYZ[:, [2, 0, 1]]], dtype=[("z", "f8"), ("x", "f8"), ("y", ">f8")]),
    ],
)
def test_npy(tmp_path, array):
    assert np.array_equal(read_points(write(tmp_path, "touches.npy", npy(array))).points, XYZ)


def test_npy_with_normals(tmp_path):
    points = read_points(write(tmp_path, "touches.npy", npy(np.hstack([XYZ, NORMALS]))))
    assert np.allclose(points.normals, NORMALS, atol=1e-15)


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("the file was unpickled",))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy(np.array([Trap()], dtype=object), allow_pickle=True), "Python objects, which are never unpickled"),
        (npy(XYZ[:, :2]), r"found \(4, 2\)"),
        (npy(XYZ[0]), r"found \(3,\)"),
        (npy(XYZ + 0j), "expected numbers, found an array of complex128"),
        (npy(XYZ.astype("U8")), "expected numbers, found an array of <U"),
        (npy(XYZ > 0), "expected numbers, found an array of bool"),
        (npy(XYZ[:0]), r"no points in an array of shape \(0, 3\)"),
        (npy(np.zeros((5, 100))), r"found \(5, 100\)"),
        (npy(XYZ)[:-1], r"announces shape \(4, 3\) of float64 \(96 bytes\), found 95 bytes"),
        (npy(XYZ).replace(b"(4, 3)", b"(9**9, 3)"), "the NPY header is damaged"),
        (npy(XYZ)[:9], "expected an NPY header, found 9 bytes"),
        (b"x" * 99, "expected a NPY file, found one that starts with"),
    ],
)
def test_npy_errors(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        read_points(write(tmp_path, "touches.npy", content))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz(tmp_path, save):
    content = npz(save, points=XYZ.astype("f4"), normals=3 * NORMALS, strokes=np.array([0, 0, 1, 1]), other=np.zeros(9))
    points = read_points(write(tmp_path, "touches.npz", content))
    assert np.allclose(points.points, XYZ, rtol=1e-7)
    assert np.allclose(points.normals, NORMALS)
    assert points.strokes.tolist() == [0, 0, 1, 1]
    assert np.array_equal(read_points(write(tmp_path, "one.npz", npz(save, arr_0=XYZ))).points, XYZ)


def zip_of(**members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(name.replace("_npy", ".npy"), content)
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npz(a=XYZ, b=XYZ), "expected an array named points, found 'a, b'"),
        (npz(points=XYZ, normals=NORMALS[:2]), r"\[normals\]: expected shape \(4, 3\), found \(2, 3\)"),
        (npz(points=XYZ, strokes=np.zeros((4, 1))), r"\[strokes\]: expected shape \(4,\), found \(4, 1\)"),
        (zip_of(points_npy=b"PICKLE"), r"\[points\]: expected an NPY array, found b'PICKLE'"),
        (zip_of(data=b"x"), "expected an array named points, found none"),
        (npz(points=XYZ)[:-30], "not a readable NPZ file"),
        (npz(np.savez_compressed, points=np.zeros((4_000_000, 3))), "would expand to 96000128, more than tenfold"),
    ],
)
def test_npz_errors(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        read_points(write(tmp_path, "touches.npz", content))


# meshes as clouds.


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
def test_a_mesh_we_wrote_is_a_cloud(tmp_path, suffix):
    sphere = trimesh.creation.icosphere(subdivisions=2)
    write_mesh(tmp_path / f"sphere.{suffix}", sphere)
    points = read_points(tmp_path / f"sphere.{suffix}", strict=True).points
    assert points.shape == sphere.vertices.shape
    nearest = np.linalg.norm(points[:, None] - sphere.vertices[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-7


@pytest.mark.parametrize("file_type", ["off", "stl_ascii", "obj", "ply", "glb", "stl"])
def test_a_mesh_trimesh_wrote_is_a_cloud(tmp_path, file_type):
    box = trimesh.creation.box((1, 2, 3))
    content = box.export(file_type=file_type)
    points = read_points(write(tmp_path, f"box.{file_type.split('_')[0]}", content)).points
    assert len(np.unique(points, axis=0)) == 8
    assert np.allclose(np.abs(points), [0.5, 1, 1.5])


def test_obj_points(tmp_path):
    text = "# cloud\nmtllib x.mtl\n"
    for (x, y, z), (nx, ny, nz) in zip(XYZ.tolist(), NORMALS.tolist(), strict=True):
        text += f"vn {nx} {ny} {nz}\nv {x} {y} {z} 1 0 0\n"
    points = read_points(write(tmp_path, "cloud.obj", text))
    assert np.array_equal(points.points, XYZ)
    assert np.allclose(points.normals, NORMALS, atol=1e-15)
    assert read_points(write(tmp_path, "mesh.obj", text + "f 1//4 2//3 3//2\n")).normals is None


def test_glb_transforms_are_applied(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), transform=trimesh.transformations.translation_matrix([10, 0, 0]))
    scene.add_geometry(trimesh.creation.box())
    points = read_points(write(tmp_path, "scene.glb", scene.export(file_type="glb"))).points
    assert points.min(axis=0).tolist() == [-0.5, -0.5, -0.5]
    assert points.max(axis=0).tolist() == [10.5, 0.5, 0.5]


def glb(scene, binary=b""):
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "# nothing\n", "no line starts with v"),
        ("a.obj", "v 1 2 3\nv 1 2\n", "line 2: expected 3 columns, found 2"),
        ("a.obj", "v 0,1 0,2 0,3\n", "line 1: expected a number in column 1, found '0,1'"),
        ("a.off", "OFF\n3 1 0\n1 2 3\n", "announces 3 vertices, found 1"),
        ("a.off", "OFF\n999999999999 1 0\n1 2 3\n", "announces 999999999999 vertices, found 1"),
        ("a.off", "OFF\n", "expected the numbers of vertices and faces"),
        ("a.off", "1 2 3\n", "expected a OFF file"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 10**9), "announces 1000000000 triangles"),
        ("a.stl", b"\0" * 84, "no points in this file"),
        ("a.stl", "solid nothing\nendsolid\n", "no line starts with vertex"),
        ("a.glb", b"glTF\2\0\0\0", "not a readable GLB file"),
        (
            "a.glb",
            glb({"accessors": [{"count": 10**12, "type": "VEC3", "componentType": 5126}]}),
            "accessor without data",
        ),
        ("a.glb", glb({"nodes": [{"children": [1, 1]}, {}]}), "the nodes are not a tree"),
        ("a.glb", glb({"nodes": [{"children": [0]}], "scenes": [{"nodes": [0]}]}), "the nodes are not a tree"),
        ("a.glb", glb({"asset": {"version": "2.0"}, "scenes": [{"nodes": []}], "nodes": []}), "GLB file|no mesh"),
    ],
)
def test_mesh_errors(tmp_path, name, content, message):
    with pytest.raises(ValueError, match=message):
        read_points(write(tmp_path, name, content))


def test_meshes_survive_writing_and_reading(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=48)
    mesh.apply_translation([61, -22.5, 403.25])
    for suffix in ("ply", "obj", "stl", "glb"):
        path = tmp_path / f"mesh.{suffix}"
        write_mesh(path, mesh)
        for again in (read_mesh(path), trimesh.load(path, force="mesh")):
            check_closed(again)
            assert again.volume == pytest.approx(mesh.volume, rel=1e-12 if suffix in ("ply", "obj") else 1e-5)
        if suffix in ("ply", "obj"):
            assert np.array_equal(read_mesh(path).vertices, mesh.vertices), "every digit"
            assert np.array_equal(read_mesh(path).faces, mesh.faces)


def test_write_mesh_to_an_open_file():
    file = io.BytesIO()
    write_mesh(file, trimesh.creation.box(), kind="stl")
    assert len(file.getvalue()) == 84 + 12 * 50
    with pytest.raises(ValueError, match="kind should be one of ply, obj, stl, glb with an open file"):
        write_mesh(io.BytesIO(), trimesh.creation.box())


def test_write_mesh_refuses_other_formats(tmp_path):
    with pytest.raises(ValueError, match=r"expected a mesh format out of \.ply \.obj \.stl \.glb, got '\.step'"):
        write_mesh(tmp_path / "mesh.step", trimesh.creation.box())


@pytest.mark.parametrize("kind", ["stl", "glb"])
def test_float32_formats_are_refused_far_from_the_origin(tmp_path, kind):
    mesh = trimesh.creation.icosphere(subdivisions=3)
    check_float32(mesh.vertices, kind=kind, cell=2 / 256)
    mesh.apply_translation([1e6, 0, 0])
    with pytest.raises(ValueError, match=rf"{kind.upper()} holds float32, 0\.0625 apart at .* 1e\+06, too coarse"):
        write_mesh(tmp_path / f"mesh.{kind}", mesh, cell=2 / 256)
    mesh.apply_translation([1e9, 0, 0])
    with pytest.raises(ValueError, match=rf"in which vertices fall together .* instead of \.{kind}"):
        write_mesh(tmp_path / f"mesh.{kind}", mesh)
    assert list(tmp_path.iterdir()) == []
    write_mesh(tmp_path / "mesh.ply", mesh, cell=2 / 256)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", ply("ascii", [("vertex", [(c, "float") for c in "xyz"], [(1.0, 2.0, 3.0)])]), "found no faces"),
        ("a.ply", b"ply\nnonsense", "a.ply"),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 10**9), "announces 1000000000 triangles"),
        ("a.obj", "v nan 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 3\n", "expected finite vertices"),
        ("a.xyz", "1 2 3\n", "a.xyz"),
    ],
)
def test_read_mesh_errors(tmp_path, name, content, message):
    with pytest.raises(ValueError, match=message) as error:
        read_mesh(write(tmp_path, name, content))
    assert "\n" not in str(error.value)


# strokes.


def test_split_strokes():
    along = np.arange(10)[:, None] * [[0.1, 0, 0]]
    assert split_strokes(np.vstack([along, along + 5, along - 5])).tolist() == [0] * 10 + [1] * 10 + [2] * 10
    assert split_strokes(along).tolist() == [0] * 10
    assert split_strokes(np.zeros((3, 3))).tolist() == [0, 0, 0]
    assert split_strokes(np.zeros((1, 3))).tolist() == [0]
    with pytest.raises(ValueError, match=r"shape \(N, 3\), got \(3,\)"):
        split_strokes(np.zeros(3))


# the page for users.


PAGE = Path(__file__).parents[2] / "docs" / "formats.md"


def test_the_page_names_every_format():
    text = PAGE.read_text()
    assert all(f"{suffix} " in text.replace(",", " ") for suffix in (*POINT_SUFFIXES, *MESH_SUFFIXES))


def test_the_snippets_of_the_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, "touches.csv", "x,y,z,stroke\n" + rows(np.hstack([XYZ, [[0], [0], [1], [1]]]), ","))
    snippets = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert snippets
    for snippet in snippets:
        exec(compile(snippet, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == "4 False [0 0 1 1] 0\n"


# damaged files.


@pytest.mark.parametrize("count", [60_000])
@pytest.mark.parametrize("name", ["t.xyz", "t.ply", "t.pcd", "t.npy", "t.obj", "t.npz"])
def test_memory_stays_below_ten_times_the_file(tmp_path, name, count):
    points = np.random.default_rng(0).integers(0, 9, size=(count, 3)).astype(np.float64)
    short = "".join(f"{x:.0f} {y:.0f} {z:.0f}\n" for x, y, z in points)  # 6 bytes a row: the hardest
    header = (
        ply("ascii", [("vertex", [(c, "float") for c in "xyz"], [])]).decode().replace("vertex 0", f"vertex {count}")
    )
    content = {
        "t.xyz": lambda: short,
        "t.ply": lambda: header.replace("vertex 0", f"vertex {count}") + short,
        "t.pcd": lambda: pcd("binary", points),
        "t.npy": lambda: npy(points.astype("f4")),
        "t.obj": lambda: "v " + short[:-1].replace("\n", "\nv ") + "\n",
        "t.npz": lambda: npz(points=points.astype("f4")),
    }[name]()
    path = write(tmp_path, name, content)
    size = path.stat().st_size
    tracemalloc.start()
    try:
        assert len(read_points(path).points) == count
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # A fixed part for the buffers of some thousand lines.
    assert peak < 10 * size + (4 << 20)


SEEDS = {
    "t.xyz": rows(XYZ).encode(),
    "t.csv": ("x,y,z,stroke\n" + rows(np.hstack([XYZ, XYZ[:, :1] > 0]), ",")).encode(),
    "t.pts": ("4\n" + rows(np.hstack([XYZ, NORMALS]))).encode(),
    "a.ply": ply("ascii", [("vertex", [(c, "float") for c in "xyz"], XYZ.tolist())]),
    "l.ply": ply(
        "binary_little_endian",
        [
            ("edge", [("v", "list uchar int")], [((1, 2),), ((3,),)]),
            (
                "vertex",
                [("f", "list uchar short"), *((c, "double") for c in "xyz")],
                [((1,), *row) for row in XYZ.tolist()],
            ),
        ],
    ),
    "b.ply": ply("binary_big_endian", [("vertex", [(c, "float") for c in "xyz"], XYZ.tolist())]),
    "a.pcd": pcd("ascii", XYZ),
    "b.pcd": pcd("binary", XYZ),
    "c.pcd": pcd("binary_compressed", XYZ),
    "t.npy": npy(XYZ),
    "t.npz": npz(points=XYZ, normals=NORMALS),
    "z.npz": npz(np.savez_compressed, points=XYZ),
    "t.obj": ("vn 0 0 1\n" * 4 + "".join(f"v {a} {b} {c}\n" for a, b, c in XYZ)).encode(),
    "t.off": ("OFF\n4 0 0\n" + rows(XYZ)).encode(),
    "a.stl": trimesh.creation.box().export(file_type="stl_ascii").encode(),
    "b.stl": trimesh.creation.box().export(file_type="stl"),
    "t.glb": trimesh.creation.box().export(file_type="glb"),
}


@pytest.mark.parametrize(
    "content",
    [
        b"#\n\n" * 100_000 + b"1 2 3\n",
        b" " * 60_000 + b"\n" + b"\t \n" * 100_000 + b"1 2 3\n",
        b"[" * 60_000 + b"\n1 2 3\n",
        b"ply\n" + b"comment\n" * 100_000 + b"end_header",
        b"VERSION 0.7\n" + b" " * 500_000,
        b"x,y,z\n" + b"," * 60_000,
        b"1,2,3,4,5,6\n" * 50_000 + b"  ,,,0",
    ],
)
def test_hostile_text_does_not_hang(tmp_path, content):
    # Fractions of a second; what grew with the square of the size, or worse, would not end.
    read_or_refuse(write(tmp_path, "t.txt", content))


TOKENS = [
    b"nan",
    b"-",
    b"1e999",
    b"\0",
    b"\n",
    b"\r",
    b"999999999999",
    b" ",
    b",",
    b";",
    b"#",
    b"\xff" * 4,
    b"0",
    b"list ",
]
EDITS = st.lists(
    st.tuples(
        st.sampled_from(["set", "cut", "drop", "repeat", "token"]),
        st.integers(0, 1 << 16),
        st.integers(0, 255),
        st.sampled_from(TOKENS),
    ),
    min_size=1,
    max_size=6,
)


def damaged(content, edits):
    for kind, at, value, token in edits:
        at %= len(content) + 1
        if kind == "set":
            content = content[:at] + bytes([value]) + content[at + 1 :]
        elif kind == "cut":
            content = content[:at]
        elif kind == "drop":
            content = content[:at] + content[at + value :]
        elif kind == "repeat":
            content = content[:at] + content[at : at + value] * 3 + content[at + value :]
        else:
            content = content[:at] + token + content[at:]
    return content


def read_or_refuse(path):
    """What every file must lead to: good points, or one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            points = read_points(path)
        except ValueError as error:
            assert str(error).startswith(str(path))
            assert "\n" not in str(error)
            return
    count = len(points.points)
    assert points.points.shape == (count, 3)
    assert count >= 1
    assert points.points.dtype == np.float64
    assert np.isfinite(points.points).all()
    if points.normals is not None:
        lengths = np.linalg.norm(points.normals, axis=1)
        assert ((lengths == 0) | (np.abs(lengths - 1) < 1e-9)).all()
    assert points.strokes is None or points.strokes.shape == (count,)


@pytest.mark.parametrize("name", SEEDS)
def test_the_seeds_are_read_right(tmp_path, name):
    points = read_points(write(tmp_path, name, SEEDS[name])).points
    assert len(points) == (8 if name in ("a.stl", "b.stl", "t.glb") else 4)


@seed(0)
@settings(max_examples=400, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(sorted(SEEDS)), edits=EDITS)
def test_damaged_files_are_read_or_refused(tmp_path, name, edits):
    read_or_refuse(write(tmp_path, name, damaged(SEEDS[name], edits)))


@seed(0)
@settings(max_examples=200, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(sorted(SEEDS)), content=st.binary(max_size=400) | st.text(max_size=200).map(str.encode))
def test_any_bytes_are_read_or_refused(tmp_path, name, content):
    read_or_refuse(write(tmp_path, name, content))
