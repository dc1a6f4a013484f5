"""Cloud files: what is read is what the file holds, or an error says why not."""

from __future__ import annotations

import builtins
import math
import os
import struct
import subprocess
import sys
import types
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mdcs_pipeline.arrays import finite_points
from mdcs_pipeline.errors import ConfigError, InputError, MissingExtraError
from mdcs_pipeline.io.clouds import CLOUD_SUFFIXES, frame_files, read_points
from mdcs_pipeline.io.open3d_bridge import import_open3d, line_set, points_of
from mdcs_pipeline.stage import input_ports, output_ports
from mdcs_pipeline.stages.read import Read

# Far from the origin, with digits that float32 loses.
POINTS = np.array([[1e6 + 0.123456789, 2.0, 3.0], [-4.0, 5.5, 6.0], [7.0, 8.0, 9.000000001]])
WITH_NAN = np.array([[1e6 + 0.123456789, 2.0, 3.0], [4.0, math.nan, 6.0], [7.0, 8.0, math.inf]])


@pytest.fixture
def o3d():
    return pytest.importorskip("open3d", exc_type=ImportError)


def rows(points, tail=""):
    return "".join(" ".join(repr(float(v)) for v in row) + tail + "\n" for row in points)


def put(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def ply(kind, count, body, properties=("double x", "double y", "double z"), more=()):
    head = ["ply", f"format {kind} 1.0", "comment made by a test", f"element vertex {count}"]
    head += [f"property {item}" for item in properties]
    text = "\n".join([*head, *more, "end_header"]) + "\n"
    return text.encode() + (body if isinstance(body, bytes) else body.encode())


def pcd(data, count, body, fields="x y z", size="8 8 8", kind="F F F", **lines):
    head = {
        "VERSION": "0.7",
        "FIELDS": fields,
        "SIZE": size,
        "TYPE": kind,
        "COUNT": " ".join("1" for _ in fields.split()),
        "WIDTH": count,
        "HEIGHT": 1,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": count,
        **lines,
        "DATA": data,
    }
    text = "# .PCD v0.7 - test\n" + "".join(
        f"{key} {value}\n" for key, value in head.items() if value is not None
    )
    return text.encode() + (body if isinstance(body, bytes) else body.encode())


def literal_lzf(data: bytes) -> bytes:
    """Pack bytes as LZF runs of literals, which need no compressor."""
    chunks = (data[i : i + 32] for i in range(0, len(data), 32))
    return b"".join(bytes([len(chunk) - 1]) + chunk for chunk in chunks)


def compressed(points, **lines):
    columns = np.ascontiguousarray(points.T).tobytes()
    packed = literal_lzf(columns)
    body = struct.pack("<II", len(packed), len(columns)) + packed
    return pcd("binary_compressed", len(points), body, **lines)


def refused(path, *words):
    """Read a bad file; its error must name the file and all of `words`."""
    with pytest.raises(InputError) as caught:
        read_points(path)
    text = str(caught.value)
    assert str(path) in text
    for word in words:
        assert word in text, text
    return text


# --- every format, exactly -------------------------------------------------------------

GOOD = {
    "plain.xyz": rows(POINTS),
    "crlf.xyz": rows(POINTS).replace("\n", "\r\n"),
    "comments.xyz": "# x y z\n\n" + rows(POINTS) + "\n# end\n",
    "intensity.xyz": rows(POINTS, " 17"),
    "normals.xyzn": rows(POINTS, " 0 0 1"),
    "plain.pts": "3\n" + rows(POINTS),
    "intensity.pts": "3\n" + rows(POINTS, " 5"),
    "colour.pts": "3\n" + rows(POINTS, " 5 255 0 0") + "\n\n",
    "ascii.ply": ply("ascii", 3, rows(POINTS)),
    "blank.ply": ply("ascii", 3, rows(POINTS).replace("\n", "\n\n")),
    "crlf.ply": ply("ascii", 3, rows(POINTS)).replace(b"\n", b"\r\n"),
    "little.ply": ply("binary_little_endian", 3, POINTS.astype("<f8").tobytes()),
    "big.ply": ply("binary_big_endian", 3, POINTS.astype(">f8").tobytes()),
    "newline.ply": ply("binary_little_endian", 3, POINTS.astype("<f8").tobytes() + b"\n"),
    "ascii.pcd": pcd("ascii", 3, rows(POINTS)),
    "binary.pcd": pcd("binary", 3, POINTS.tobytes()),
    "compressed.pcd": compressed(POINTS),
    "organised.pcd": pcd("binary", 3, POINTS.tobytes(), WIDTH=1, HEIGHT=3),
    "old.pcd": pcd("binary", 3, POINTS.tobytes(), POINTS=None, VERSION=".5", COUNT=None),
}


@pytest.mark.parametrize("name", GOOD)
def test_coordinates_are_kept_to_the_last_bit(o3d, tmp_path, name):
    points = read_points(put(tmp_path / name, GOOD[name]))
    assert points.dtype == np.float64
    assert points.flags.c_contiguous
    np.testing.assert_array_equal(points, POINTS)


@pytest.mark.parametrize("suffix", [".XYZ", ".Ply", ".PCD", ".Pts", ".XYZN"])
def test_suffix_may_be_of_any_case(o3d, tmp_path, suffix):
    name = next(name for name in GOOD if name.endswith(suffix.lower()))
    path = put(tmp_path / f"cloud{suffix}", GOOD[name])
    np.testing.assert_array_equal(read_points(str(path)), POINTS)


@pytest.mark.parametrize(
    ("name", "data"),
    {
        "a.xyz": rows(WITH_NAN),
        "a.pts": "3\n" + rows(WITH_NAN),
        "binary.ply": ply("binary_little_endian", 3, WITH_NAN.astype("<f8").tobytes()),
        "ascii.pcd": pcd("ascii", 3, rows(WITH_NAN)),
        "binary.pcd": pcd("binary", 3, WITH_NAN.tobytes()),
        "compressed.pcd": compressed(WITH_NAN),
    }.items(),
)
def test_points_that_are_not_finite_are_kept(o3d, tmp_path, name, data):
    points = read_points(put(tmp_path / name, data))
    np.testing.assert_array_equal(points, WITH_NAN)


def test_text_ply_keeps_nan_and_refuses_infinity(o3d, tmp_path):
    """Open3D stops at an infinity in a text PLY and leaves unset memory.

    That memory held the right numbers at times, so comparing what came back passed by luck.
    """
    points = np.where(np.isinf(WITH_NAN), np.nan, WITH_NAN)
    path = put(tmp_path / "a.ply", ply("ascii", 3, rows(points)))
    np.testing.assert_array_equal(read_points(path), points)
    refused(put(path, ply("ascii", 3, rows(WITH_NAN))), "line 11", "infinity", "binary PLY")


def test_pcd_of_doubles_is_not_zero(o3d, tmp_path):
    """Open3D's legacy reader turns 8-byte PCD coordinates into zeros, without a warning.

    Clouds in float32, which most PCD files are, read right and would hide it.
    """
    path = put(tmp_path / "a.pcd", pcd("binary", 3, POINTS.tobytes()))
    assert np.count_nonzero(read_points(path)) == 9


def test_pcd_of_floats_with_padding_and_other_fields(o3d, tmp_path):
    kinds = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("_", "u1", 4), ("ring", "u2"), ("t", "f8")]
    table = np.zeros(3, kinds)
    table["x"], table["y"], table["z"] = POINTS.T
    data = pcd(
        "binary",
        3,
        table.tobytes(),
        fields="x y z _ ring t",
        size="4 4 4 1 2 8",
        kind="F F F U U F",
        COUNT="1 1 1 4 1 1",
    )
    points = read_points(put(tmp_path / "lidar.pcd", data))
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, POINTS.astype(np.float32))


def test_pcd_of_integers_becomes_float(o3d, tmp_path):
    whole = np.array([[1, 2, 3], [-4, 5, 6]], "<i4")
    data = pcd("binary", 2, whole.tobytes(), size="4 4 4", kind="I I I")
    points = read_points(put(tmp_path / "a.pcd", data))
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, whole)


FACES = ("element face 2", "property list uchar int vertex_indices")


def test_vertices_of_a_text_mesh(o3d, tmp_path):
    data = ply("ascii", 3, rows(POINTS) + "3 0 1 2\n3 2 1 0\n", more=FACES)
    np.testing.assert_array_equal(read_points(put(tmp_path / "mesh.ply", data)), POINTS)


def test_vertices_of_a_binary_mesh(o3d, tmp_path):
    faces = struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 0)
    body = POINTS.astype("<f8").tobytes() + faces
    data = ply("binary_little_endian", 3, body, more=FACES)
    np.testing.assert_array_equal(read_points(put(tmp_path / "mesh.ply", data)), POINTS)


def test_ply_with_float_coordinates_colours_and_lists_at_its_vertices(o3d, tmp_path):
    colour = ("uchar red", "uchar green", "uchar blue")
    names = ("float x", "float y", "float z", *colour, "list uchar int tags")
    text = ply("ascii", 2, "1 2 3 255 8 9 2 7 7\n4 5 6 0 8 9 0\n", names)
    np.testing.assert_array_equal(
        read_points(put(tmp_path / "a.ply", text)), [[1, 2, 3], [4, 5, 6]]
    )
    body = struct.pack("<3f4B2i", 1, 2, 3, 255, 8, 9, 2, 7, 7)
    body += struct.pack("<3f4B", 4, 5, 6, 0, 8, 9, 0)
    binary = ply("binary_little_endian", 2, body, names)
    np.testing.assert_array_equal(
        read_points(put(tmp_path / "b.ply", binary)), [[1, 2, 3], [4, 5, 6]]
    )


def test_ply_list_in_front_of_the_coordinates(o3d, tmp_path):
    names = ("list uchar int tags", "float x", "float y", "float z")
    path = put(tmp_path / "a.ply", ply("ascii", 2, "1 7 1 2 3\n0 4 5 6\n", names))
    np.testing.assert_array_equal(read_points(path), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("dtype", ["<f4", "<f8", ">f8", "<f2", "<i4"])
def test_npy_keeps_or_widens_its_type(tmp_path, dtype):
    array = np.array([[1, 2, 3], [4, 5, 6]], dtype)
    np.save(tmp_path / "a.npy", array)
    points = read_points(tmp_path / "a.npy")
    assert points.dtype == (np.float32 if dtype == "<f4" else np.float64)
    np.testing.assert_array_equal(points, array)


@pytest.mark.parametrize(
    "held",
    [
        {"points": POINTS, "other": np.zeros((5, 3))},
        {"positions": POINTS, "normals": POINTS * 0},
        {"xyz": POINTS, "labels": np.zeros(3), "colours": np.zeros((3, 4))},
    ],
)
def test_npz_finds_the_points(tmp_path, held):
    np.savez_compressed(tmp_path / "a.npz", **held)
    np.testing.assert_array_equal(read_points(tmp_path / "a.npz"), POINTS)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    points=arrays(
        np.float64, st.tuples(st.integers(1, 9), st.just(3)), elements=st.floats(width=64)
    ),
    name=st.sampled_from(["a.npy", "b.ply", "c.pcd", "d.xyz", "e.pts", "f.ply", "g.pcd"]),
)
def test_any_doubles_survive(o3d, tmp_path, points, name):
    path = tmp_path / name
    if name == "f.ply":
        points = np.nan_to_num(points, nan=np.nan)  # no infinity: see the test of text PLY
    if name == "a.npy":
        np.save(path, points)
    elif name == "b.ply":
        put(path, ply("binary_little_endian", len(points), points.astype("<f8").tobytes()))
    elif name == "c.pcd":
        put(path, pcd("binary", len(points), points.tobytes()))
    elif name == "d.xyz":
        put(path, rows(points))
    elif name == "e.pts":
        put(path, f"{len(points)}\n" + rows(points))
    elif name == "f.ply":
        put(path, ply("ascii", len(points), rows(points)))
    else:
        put(path, pcd("ascii", len(points), rows(points)))
    np.testing.assert_array_equal(read_points(path), points)


# --- bad files ---------------------------------------------------------------------------

XYZ = rows(POINTS)
LITTLE = POINTS.astype("<f8").tobytes()
BAD_TEXT = {
    "word.xyz": (XYZ + "foo bar baz\n", "line 4", "column 1 is not a number", "foo bar baz"),
    "tail.xyz": ("1 2 3abc\n", "line 1", "column 3 is not a number"),
    "short.xyz": (XYZ + "1 2\n", "line 4", "2 columns in a row that needs 3", "cut off"),
    "flat.xyz": ("1 2\n3 4\n", "line 1", "2 columns", "z"),
    "commas.xyz": ("1,2,3\n", "line 1", "spaces, not by commas"),
    "semicolons.xyz": ("1;2;3\n", "spaces, not by commas or semicolons"),
    "heading.xyz": ("x y z\n" + XYZ, "line 1", "heading must start with #"),
    "joined.xyz": (XYZ + "1 2 3 4\n", "line 4", "4 columns after rows of 3"),
    "underscore.xyz": ("1_0 2 3\n", "not a number"),
    "notes.xyz": ("# nothing here\n\n", "no points"),
    "binary.xyz": (bytes(range(1, 200)), "line 1"),
    "plain.xyzn": (XYZ, "line 1", "3 columns in a row that needs 6"),
    "count.pts": (XYZ, "line 1", "number of points", ".xyz"),
    "negative.pts": ("-3\n" + XYZ, "line 1"),
    "huge.pts": ("9" * 5000 + "\n" + XYZ, "line 1"),
    "short.pts": ("4\n" + XYZ, "declares 4 points", "ends after 3", "cut off"),
    "long.pts": ("2\n" + XYZ, "line 4", "declares 2 points", "more rows follow"),
    "mac.xyz": ("1 2 3\r4 5 6\r", "line 1", "carriage return"),
    "hole.pts": ("3\n1 2 3\n\n4 5 6\n", "line 3", "0 columns"),
    "word.pts": ("2\n1 2 3\nx 5 6\n", "line 3", "column 1"),
    "five.pts": ("1\n1 2 3 4 5\n", "rows of 5 columns"),
    "mixed.pts": ("2\n1 2 3\n4 5 6 7\n", "line 3", "4 columns after rows of 3"),
    "none.pts": ("0\n", "no points"),
}
BAD_PLY = {
    "lies.ply": (XYZ, "not of the format that '.ply' names"),
    "almost.ply": (b"plyfoo\n", "line 1", "starts with a line 'ply'"),
    "stl.ply": ("solid a\nendsolid a\n", "STL", "convert it"),
    "short.ply": (ply("ascii", 5, XYZ), "declares 5 rows of 'vertex'", "ends after 3"),
    "long.ply": (ply("ascii", 2, XYZ), "line 11", "more rows follow"),
    "word.ply": (ply("ascii", 3, XYZ.replace("5.5", "foo")), "line 10", "column 2", "foo"),
    "wide.ply": (ply("ascii", 3, rows(POINTS, " 7")), "4 columns where the header declares 3"),
    "narrow.ply": (ply("ascii", 1, "1 2\n"), "2 columns in a row that needs 3"),
    "cut.ply": (ply("binary_little_endian", 3, LITTLE[:-9]), "ends after 2", "cut off"),
    "more.ply": (ply("binary_little_endian", 2, LITTLE), "more data follow", "24 bytes"),
    "flat.ply": (
        ply("binary_little_endian", 3, LITTLE, ("double x", "double y")),
        "z is not so",
        "three coordinates",
    ),
    "twice.ply": (ply("ascii", 1, "1 2 3 4\n", ["int x", "int x", "int y", "int z"]), "x is not"),
    "none.ply": (ply("ascii", 0, ""), "no points"),
    "faces.ply": (ply("ascii", 3, XYZ + "3 0 1 2\n", more=FACES), "2 rows of 'face'"),
    "facecut.ply": (
        ply("binary_little_endian", 3, LITTLE + struct.pack("<B2i", 3, 0, 1), more=FACES),
        "'face'",
        "ends after 0",
    ),
    "faceless.ply": (
        ply("binary_little_endian", 3, LITTLE + struct.pack("<B3i", 3, 0, 1, 2), more=FACES),
        "'face'",
        "ends after 1",
    ),
    "header.ply": (b"ply\nformat ascii 1.0\nelement vertex 3\n", "no line end_header"),
    "format.ply": (b"ply\nelement vertex 3\nend_header\n", "no line 'format'"),
    "kind.ply": (b"ply\nformat middle_endian 1.0\nend_header\n", "line 2", "middle_endian"),
    "many.ply": (b"ply\nformat ascii 1.0\nelement vertex -3\nend_header\n", "line 3"),
    "early.ply": (b"ply\nformat ascii 1.0\nproperty int x\nend_header\n", "line 3"),
    "type.ply": (ply("ascii", 1, "1 2 3\n", ["half x", "half y", "half z"]), "half x"),
    "list.ply": (ply("ascii", 1, "1 2 3\n", ["list float int x"]), "list float int x"),
    "empty.ply": (b"ply\nformat ascii 1.0\nend_header\n", "one element 'vertex'", "no element"),
    "edges.ply": (b"ply\nformat ascii 1.0\nelement edge 0\nend_header\n", "vertex", "edge"),
}
for _part in ("nx", "ny", "green", "blue"):
    BAD_PLY[f"{_part}.ply"] = (
        ply("ascii", 3, rows(POINTS, " 1"), ["double x", "double y", "double z", f"float {_part}"]),
        "some of",
        "all three of them, or none",
    )
BAD_PCD = {
    "lies.pcd": (XYZ, "no line of a PCD header"),
    "short.pcd": (pcd("ascii", 5, XYZ), "declares 5 points", "ends after 3"),
    "long.pcd": (pcd("ascii", 2, XYZ), "more rows follow"),
    "word.pcd": (pcd("ascii", 3, XYZ.replace("5.5", "foo")), "column 2", "foo"),
    "row.pcd": (pcd("ascii", 3, "1 2 3\n4 5\n7 8 9\n"), "2 columns in a row that needs 3"),
    "cut.pcd": (pcd("binary", 3, POINTS.tobytes()[:-1]), "3 points of 24 bytes", "holds 2"),
    "more.pcd": (pcd("binary", 2, POINTS.tobytes()), "2 points of 24 bytes", "holds 3"),
    "packed.pcd": (compressed(POINTS)[:-5], "compressed data declared"),
    "unpacked.pcd": (compressed(POINTS, WIDTH=2, POINTS=2), "compressed data hold 72 bytes"),
    "nothing.pcd": (pcd("binary_compressed", 3, b""), "no data follow"),
    "flat.pcd": (pcd("binary", 3, LITTLE[:48], "x y", "8 8", "F F"), "z is not so", "x y"),
    "none.pcd": (pcd("binary", 0, b""), "no points"),
    "header.pcd": (b"# .PCD v0.7\nVERSION 0.7\n", "no line DATA"),
    "size.pcd": (pcd("ascii", 3, XYZ, SIZE=None), "no line SIZE"),
    "width.pcd": (pcd("ascii", 3, XYZ, WIDTH=7), "WIDTH times HEIGHT differs from POINTS"),
    "count.pcd": (pcd("ascii", "three", XYZ), "WIDTH must hold whole numbers", "three"),
    "lengths.pcd": (pcd("ascii", 3, XYZ, size="8 8"), "differ in length"),
    "data.pcd": (pcd("base64", 3, XYZ), "DATA must be", "base64"),
    "kind.pcd": (pcd("ascii", 3, XYZ, size="8 8 3"), "type that PCD does not have"),
    "types.pcd": (pcd("ascii", 3, XYZ, size="8 8 4"), "of one type", "F8, F8, F4"),
    "normal.pcd": (
        pcd("ascii", 1, "1 2 3 4\n", "x y z normal_x", "4 4 4 4", "F F F F"),
        "some fields of a normal",
    ),
}


@pytest.mark.parametrize("name", [*BAD_TEXT, *BAD_PLY, *BAD_PCD])
def test_bad_file_is_refused_before_open3d_sees_it(tmp_path, monkeypatch, name):
    """Also without Open3D: it must not be the one that finds the fault, for it often does not."""
    monkeypatch.setitem(sys.modules, "open3d", None)
    data, *words = {**BAD_TEXT, **BAD_PLY, **BAD_PCD}[name]
    refused(put(tmp_path / name, data), *words)


@pytest.mark.parametrize("suffix", CLOUD_SUFFIXES)
def test_missing_empty_and_folder(tmp_path, suffix):
    refused(tmp_path / f"absent{suffix}", "no such file")
    refused(put(tmp_path / f"empty{suffix}", b""), "empty")
    (tmp_path / f"folder{suffix}").mkdir()
    refused(tmp_path / f"folder{suffix}", "a folder", "frame_files")


def test_missing_file_names_the_nearest_one(tmp_path):
    put(tmp_path / "torus.ply", b"ply")
    refused(tmp_path / "tours.ply", "did you mean 'torus.ply'?")
    refused(tmp_path / "nowhere" / "a.ply", f"there is no folder {tmp_path / 'nowhere'}")


@pytest.mark.parametrize("name", ["cloud.las", "cloud", "cloud.ply.gz"])
def test_unknown_suffix_names_the_known(tmp_path, name):
    text = refused(put(tmp_path / name, b"x"), "suffix")
    assert all(suffix in text for suffix in CLOUD_SUFFIXES)


@pytest.mark.parametrize(
    ("name", "data", "held"),
    [
        ("a.xyz", GOOD["ascii.ply"], "a.ply"),
        ("a.pts", GOOD["ascii.pcd"], "a.pcd"),
        ("a.pcd", GOOD["binary.pcd"].partition(b"\n")[2], None),
        ("a.pcd", GOOD["little.ply"], "a.ply"),
        ("a.ply", b"PK\x03\x04", "a.npz"),
        ("a.npy", b"LASF", "LAS or LAZ"),
        ("a.npz", b"\x93NUMPY", "a.npy"),
    ],
)
def test_suffix_that_lies(o3d, tmp_path, name, data, held):
    path = put(tmp_path / name, data)
    if held is None:
        np.testing.assert_array_equal(read_points(path), POINTS)
    else:
        refused(path, f"the suffix says '{path.suffix}'", held)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path):
    path = put(tmp_path / "a.xyz", XYZ)
    path.chmod(0)
    refused(path, "no permission", "chmod")


@pytest.mark.parametrize(
    ("error", "word"),
    [(PermissionError(13, "denied"), "no permission"), (OSError(5, "disk on fire"), "on fire")],
)
@pytest.mark.parametrize("opening", [1, 2])
def test_system_refuses_at_either_opening(tmp_path, monkeypatch, error, word, opening):
    path = put(tmp_path / "a.xyz", XYZ)
    really, count = Path.open, 0

    def refuse(self, *args, **kwargs):
        nonlocal count
        count += 1
        if count == opening:
            raise error
        return really(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", refuse)
    refused(path, word)
    assert count == opening


def test_bad_numpy_files(tmp_path):
    np.save(tmp_path / "flat.npy", np.zeros((5, 2)))
    refused(tmp_path / "flat.npy", "(N, 3)", "(5, 2)")
    np.save(tmp_path / "none.npy", np.zeros((0, 3)))
    refused(tmp_path / "none.npy", "no points")
    np.save(tmp_path / "text.npy", np.array([["a", "b", "c"]]))
    refused(tmp_path / "text.npy", "real numbers")
    np.save(tmp_path / "objects.npy", np.array([{}, []], object), allow_pickle=True)
    refused(tmp_path / "objects.npy", "Python objects")
    np.save(tmp_path / "cut.npy", np.zeros((50, 3)))
    put(tmp_path / "cut.npy", (tmp_path / "cut.npy").read_bytes()[:-9])
    refused(tmp_path / "cut.npy", "damaged")
    put(tmp_path / "zip.npz", b"PK\x03\x04 and then nothing")
    refused(tmp_path / "zip.npz", "damaged")


def test_bad_npz_names_its_keys(tmp_path):
    np.savez(tmp_path / "two.npz", a=POINTS, b=POINTS)
    refused(tmp_path / "two.npz", "2 arrays of the shape (N, 3)", "a (3, 3)", "'points'")
    np.savez(tmp_path / "no.npz", c=np.zeros(4))
    refused(tmp_path / "no.npz", "no arrays of the shape (N, 3)", "c (4,)")
    np.savez(tmp_path / "bad.npz", points=np.zeros((4, 2)))
    refused(tmp_path / "bad.npz", "'points'", "(4, 2)")
    np.savez(tmp_path / "curve.npz", format="mdcs-skeleton", node_ids=[1], nodes=POINTS)
    refused(tmp_path / "curve.npz", "a skeleton, not a cloud")
    with zipfile.ZipFile(tmp_path / "bits.npz", "w") as archive:
        archive.writestr("points.npy", b"\x93NUMPY\x01\x00 broken")
    refused(tmp_path / "bits.npz", "damaged")


def fake_open3d(cloud, found=True):
    """Return a stand-in for the module whose readers give `cloud`, or raise it."""

    class Silence:
        def __enter__(self):
            return self

        def __exit__(self, *parts):
            return None

    def read(*args, **kwargs):
        if isinstance(cloud, Exception):
            raise cloud
        positions = types.SimpleNamespace(numpy=lambda: cloud)
        point = type("Map", (), {"__contains__": lambda *_: found, "positions": positions})()
        return types.SimpleNamespace(points=cloud, point=point)

    module = types.ModuleType("open3d")
    module.utility = types.SimpleNamespace(
        VerbosityContextManager=lambda _: Silence(), VerbosityLevel=types.SimpleNamespace(Error=0)
    )
    module.io = types.SimpleNamespace(read_point_cloud=read)
    module.t = types.SimpleNamespace(io=module.io)
    return module


@pytest.mark.parametrize("name", ["plain.xyz", "ascii.ply", "ascii.pcd"])
def test_count_that_comes_back_is_checked(tmp_path, monkeypatch, name):
    path = put(tmp_path / name, GOOD[name])
    monkeypatch.setitem(sys.modules, "open3d", fake_open3d(POINTS[:2]))
    refused(path, "declares 3 points, Open3D read 2")


@pytest.mark.parametrize(
    "text",
    ["2\n1 2 3 \n4 5 6 \n", "2\n1 2 3 7 .5 0 0\n4 5 6 7 1 0 0\n", "2\n1\t2\t3\n4\t5\t6\n"],
)
def test_points_that_open3d_misreads_are_refused(o3d, tmp_path, text):
    """Such PTS rows come back as unset memory, in the right number.

    Counting what comes back, as the other tests do, does not see it.
    """
    path = put(tmp_path / "a.pts", text)
    try:
        points = read_points(path)
    except InputError as error:
        assert "Open3D" in str(error)
    else:  # a later Open3D may read them
        np.testing.assert_array_equal(points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("name", ["plain.xyz", "plain.pts", "ascii.ply", "ascii.pcd"])
@pytest.mark.parametrize("wrong", [6.9e-310, math.nan, 3.0001])
def test_every_coordinate_of_a_text_file_is_compared(tmp_path, monkeypatch, name, wrong):
    points = POINTS.copy()
    points[1, 2] = wrong
    monkeypatch.setitem(sys.modules, "open3d", fake_open3d(points))
    refused(put(tmp_path / name, GOOD[name]), "misread 1 of 3 points", "point 2", "single spaces")


def test_open3d_that_gives_nothing_or_fails(tmp_path, monkeypatch):
    path = put(tmp_path / "a.pcd", GOOD["ascii.pcd"])
    monkeypatch.setitem(sys.modules, "open3d", fake_open3d(POINTS, found=False))
    refused(path, "Open3D read 0")
    monkeypatch.setitem(sys.modules, "open3d", fake_open3d(RuntimeError("own words")))
    refused(path, "Open3D cannot read", "own words")


def test_open3d_keeps_silent(o3d, tmp_path, capfd):
    """Open3D and the C libraries in it print past Python, so the descriptors are watched."""
    for name, data in GOOD.items():
        read_points(put(tmp_path / name, data))
    for name, (data, *_) in {**BAD_TEXT, **BAD_PLY, **BAD_PCD}.items():
        with pytest.raises(InputError):
            read_points(put(tmp_path / name, data))
    shown = capfd.readouterr()
    assert shown.out == ""
    assert shown.err == ""


def test_verbosity_is_put_back(o3d, tmp_path):
    before = o3d.utility.get_verbosity_level()
    read_points(put(tmp_path / "a.xyz", XYZ))
    assert o3d.utility.get_verbosity_level() == before


# --- folders -----------------------------------------------------------------------------


def test_frames_in_natural_order(tmp_path):
    names = ["frame_10.ply", "frame_2.ply", "Frame_1.PLY", "frame_2b.npy", "9.xyz", "a.pcd"]
    for name in [*names, "notes.txt", ".frame_0.ply"]:
        put(tmp_path / name, b"x")
    (tmp_path / "frame_3.ply").mkdir()
    assert [path.name for path in frame_files(tmp_path)] == [
        "9.xyz",
        "a.pcd",
        "Frame_1.PLY",
        "frame_2.ply",
        "frame_2b.npy",
        "frame_10.ply",
    ]


def test_frames_of_no_folder(tmp_path):
    put(tmp_path / "notes.txt", b"x")
    with pytest.raises(InputError, match="no cloud file") as caught:
        frame_files(str(tmp_path))
    assert "1 other files" in str(caught.value)
    assert ".ply" in str(caught.value)
    for path in (tmp_path / "absent", tmp_path / "notes.txt"):
        with pytest.raises(InputError, match="a folder of cloud files") as caught:
            frame_files(path)
        assert str(path) in str(caught.value)


# --- Open3D itself -----------------------------------------------------------------------


def failing_import(monkeypatch, error):
    really = builtins.__import__

    def importing(name, *args, **kwargs):
        if name == "open3d":
            raise error
        return really(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.setattr(builtins, "__import__", importing)


def test_missing_extra_names_both_and_never_both_at_once(tmp_path, monkeypatch):
    failing_import(monkeypatch, ModuleNotFoundError("No module named 'open3d'", name="open3d"))
    path = put(tmp_path / "a.xyz", XYZ)
    with pytest.raises(MissingExtraError) as caught:
        read_points(path)
    text = str(caught.value)
    assert "mdcs-pipeline[open3d]" in text
    assert "mdcs-pipeline[open3d-cpu]" in text
    assert "never both" in text


DEBIAN_PACKAGES = (
    "libusb-1.0-0",
    "libegl1",
    "libgl1",
    "libx11-6",
    "libudev1",
    "libidn2-0",
    "libgomp1",
)
LIBUSB = "libusb-1.0.so.0: cannot open shared object file: No such file or directory"


@pytest.mark.parametrize("kind", [ImportError, OSError])
def test_missing_system_library_names_the_debian_packages(monkeypatch, kind):
    failing_import(monkeypatch, kind(LIBUSB))
    with pytest.raises(MissingExtraError) as caught:
        import_open3d()
    text = str(caught.value)
    assert "libusb-1.0.so.0" in text
    for name in DEBIAN_PACKAGES:
        assert name in text


def test_other_faults_of_the_import(monkeypatch):
    failing_import(monkeypatch, ModuleNotFoundError("No module named 'dash'", name="dash"))
    with pytest.raises(MissingExtraError, match="a Python package that it needs") as caught:
        import_open3d()
    assert "pip install dash" in str(caught.value)
    failing_import(monkeypatch, ImportError("cannot import name 'core'"))
    with pytest.raises(MissingExtraError, match="cannot be imported") as caught:
        import_open3d()
    assert "overwrite each other" in str(caught.value)


def test_points_of_never_imports_open3d():
    code = (
        "import sys; from mdcs_pipeline.io.open3d_bridge import points_of; "
        "import mdcs_pipeline.io.clouds, mdcs_pipeline.io.write; "
        "assert points_of([[1, 2, 3]]) is None; "
        "heavy = {'open3d', 'matplotlib', 'k3d', 'networkx'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_points_of_a_strange_module(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", types.ModuleType("open3d"))
    assert points_of(POINTS) is None
    monkeypatch.delitem(sys.modules, "open3d")
    assert points_of(POINTS) is None


def test_points_of_legacy_clouds_outlive_them(o3d):
    """numpy's own view of a legacy cloud shows freed memory once the points are replaced."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
    points = points_of(cloud)
    cloud.points = o3d.utility.Vector3dVector(np.full((100 * len(POINTS), 3), 7.0))
    np.testing.assert_array_equal(points, POINTS)
    assert points_of(POINTS) is None
    assert points_of(o3d.geometry.TriangleMesh()) is None


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_points_of_tensor_clouds_are_a_view(o3d, dtype):
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(POINTS.astype(dtype)))
    points = points_of(cloud)
    assert points.dtype == dtype
    np.testing.assert_array_equal(points, POINTS.astype(dtype))
    assert np.shares_memory(points, cloud.point.positions.numpy())
    assert points_of(o3d.t.geometry.PointCloud()).shape == (0, 3)


def test_line_set(o3d):
    edges = np.array([[0, 1], [1, 2]])
    lines = line_set(POINTS, edges)
    np.testing.assert_array_equal(np.asarray(lines.points), POINTS)
    np.testing.assert_array_equal(np.asarray(lines.lines), edges)
    empty = line_set(np.empty((0, 3)), np.empty((0, 2), np.int64))
    assert len(empty.points) == len(empty.lines) == 0


# --- the stage ---------------------------------------------------------------------------


def test_finite_points_are_the_same_array():
    points, dropped = finite_points(POINTS, "refuse")
    assert points is POINTS
    assert dropped == 0


def test_points_that_are_not_finite_are_dropped_or_refused():
    before = WITH_NAN.copy()
    points, dropped = finite_points(WITH_NAN)
    np.testing.assert_array_equal(points, WITH_NAN[:1])
    assert dropped == 2
    np.testing.assert_array_equal(WITH_NAN, before)
    with pytest.raises(InputError, match="2 of 3 points") as caught:
        finite_points(WITH_NAN, "refuse")
    assert "row 1" in str(caught.value)


def test_read_stage(tmp_path):
    np.save(tmp_path / "a.npy", WITH_NAN)
    stage = Read(path=tmp_path / "a.npy", frame_id="lidar")
    cloud = stage().cloud
    np.testing.assert_array_equal(cloud.positions, WITH_NAN[:1])
    assert cloud.dropped == 2
    assert cloud.header.frame_id == "lidar"
    assert input_ports(Read) == {}
    assert list(output_ports(Read)) == ["cloud"]
    with pytest.raises(InputError, match="2 of 3") as caught:
        Read(path=tmp_path / "a.npy", nonfinite="refuse")()
    assert "a.npy" in str(caught.value)


def test_read_stage_with_nothing_finite(tmp_path):
    np.save(tmp_path / "a.npy", WITH_NAN[1:])
    with pytest.raises(InputError, match="all points") as caught:
        Read(path=tmp_path / "a.npy")()
    assert "a.npy" in str(caught.value)


def test_read_settings():
    with pytest.raises(ConfigError, match="path"):
        Read()
    with pytest.raises(ConfigError, match="nonfinite"):
        Read(path="a.npy", nonfinite="keep")
    assert all(item.description for item in Read.Settings.model_fields.values())
