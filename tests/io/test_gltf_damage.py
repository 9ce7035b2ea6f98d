"""glTF files that are broken in every way we know: each is an error of one line or, if asked for, a counted repair."""

import copy
import dataclasses
import json
import re
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable

import gltf_writer as gltf
import hypothesis
import jax
import numpy as np
import pytest
from hypothesis import strategies as st
from watch import watched

import jaxraster as jr
from jaxraster.errors import AssetWarning, Error, InputError, LimitError
from jaxraster.io.asset import LARGEST
from jaxraster.io.gltf import read_gltf
from jaxraster.io.reading import Limits, Reading
from jaxraster.scene import check_scene

RNG = np.random.default_rng(3)
# A cube of 24 vertices and 12 triangles: what the tables call "1 of 12 faces" is one of these.
SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32)
UVS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
INDICES = (4 * np.arange(6)[:, None] + [0, 1, 2, 0, 2, 3]).astype(np.uint16).ravel()
PIXELS = RNG.integers(0, 256, (5, 7, 3)).astype(np.uint8)


def side(normal: np.ndarray) -> np.ndarray:
    """The four corners of a cube's side, counter-clockwise from outside."""
    u = np.roll(np.abs(normal), 1)
    v = np.cross(normal, u)
    return normal + np.array([-1, 1, 1, -1])[:, None] * u + np.array([-1, -1, 1, 1])[:, None] * v


CUBE = {
    "POSITION": np.concatenate([side(n) for n in SIDES]).astype(np.float32),
    "NORMAL": SIDES.repeat(4, axis=0),
    "TANGENT": np.concatenate([np.roll(np.abs(SIDES), 1, axis=1), np.ones((6, 1))], axis=1)
    .astype(np.float32)
    .repeat(4, 0),
    "TEXCOORD_0": np.tile(UVS, (6, 1)),
}


def cube(indices=INDICES, **arrays) -> dict:
    """A document of a textured cube under a node, with a camera and a lamp."""
    document = gltf.new()
    mesh = gltf.mesh(document, np.asarray(indices), {"material": 0}, **(CUBE | arrays))
    document["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.25, 1], "baseColorTexture": {"index": 0}},
            "normalTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0]}}},
            "extensions": {"KHR_materials_ior": {"ior": 1.4}},
        }
    ]
    document["images"] = [{"bufferView": gltf.view(document, gltf.png(PIXELS)), "mimeType": "image/png"}]
    document["samplers"], document["textures"] = [{"wrapS": 33071}], [{"source": 0, "sampler": 0}]
    document["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}]
    document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 90}]}}
    gltf.node(document, mesh=mesh, rotation=[0, 0.6, 0, 0.8], children=[1, 2])
    gltf.node(document, camera=0, translation=[0, 0, 6])
    gltf.node(document, translation=[2, 3, 4], extensions={"KHR_lights_punctual": {"light": 0}})
    document["scenes"] = [{"nodes": [0]}]
    return document


def edit(document: dict, path: str, value) -> dict:
    *parents, last = [int(key) if key.isdigit() else key for key in path.split("/")[1:]]
    target = document
    for key in parents:
        target = target[key]
    target[last] = value
    return document


def changed(path: str, value) -> Callable[[], dict]:
    return lambda: edit(cube(), path, value)


def with_index(value: int, count: int = 1) -> Callable[[], dict]:
    """The cube with an index replaced in the last of `count` faces."""
    indices = INDICES.copy()
    indices[-3 * count :: 3] = value
    return lambda: cube(indices)


def with_value(name: str, value: float) -> Callable[[], dict]:
    """The cube with a number of its last vertex replaced; that vertex is in one face."""
    array = CUBE[name].copy()
    array[-1, 0] = value
    return lambda: cube(**{name: array})


def read(document: dict, folder, **rules):
    path = gltf.write(document, folder / "model")
    with watched(folder):
        return read_gltf(path, Reading(**rules))


# ------------------------------------------------------------------------------------------------ repair and strict

P = "/meshes/0/primitives/0"
IMAGE = "bufferView"
# What is broken: the document, what the error says, what a repair says, and how many faces are left.
REPAIRS = {
    "index beyond the vertices": (
        with_index(255),
        f"{P}/indices: index 255 but only 24 vertices",
        f"dropped 1 of 12 faces: index 255 but only 24 vertices: {P}/indices",
        11,
    ),
    "restart index": (with_index(65535), "index 65535 but only 24 vertices", "dropped 1 of 12 faces: .*", 11),
    "position not a number": (
        with_value("POSITION", np.nan),
        "/accessors/0: 1 of 24 elements are not finite",
        "dropped 1 of 12 faces: 1 of 24 elements are not finite: /accessors/0",
        11,
    ),
    "position infinite": (with_value("POSITION", -np.inf), "/accessors/0: 1 of 24", "dropped 1 of 12 faces: .*", 11),
    "position too far": (
        with_value("POSITION", 1e38),
        r"/nodes/0: puts vertices .*e\+3[78] m away; at most 1\.844e\+18",
        "dropped 1 of 12 faces: puts vertices .*: /nodes/0",
        11,
    ),
    "normal not a number": (
        with_value("NORMAL", np.nan),
        "/accessors/1: 1 of 24 elements are not finite",
        "dropped NORMAL of 1 vertices: 1 of 24 elements are not finite: /accessors/1",
        12,
    ),
    "uv infinite": (
        with_value("TEXCOORD_0", np.inf),
        "/accessors/3: 1 of 24",
        "dropped TEXCOORD_0 of 1 vertices: .*",
        12,
    ),
    "attribute of another length": (
        changed("/accessors/2/count", 23),
        f"{P}/attributes: TANGENT has 23 elements for 24 vertices",
        "dropped TANGENT of 24 vertices: .*",
        12,
    ),
    "corners left over": (
        changed("/accessors/4/count", 35),
        f"{P}/indices: 35 corners do not make whole triangles",
        f"dropped 2 corners: 35 corners do not make whole triangles: {P}/indices",
        11,
    ),
    "material that is not there": (
        changed(f"{P}/material", 9),
        f"{P}: material is 9, but there are 1",
        f"dropped a material: material is 9, but there are 1: {P}",
        12,
    ),
    "picture that is not there": (
        changed("/images", [{"uri": "gone.png"}]),
        "/images/0/uri: gone.png cannot be read: No such file",
        "dropped a texture: .*gone.png cannot be read.*: /images/0",
        12,
    ),
    "picture outside the folder": (
        changed("/images", [{"uri": "../../secret.png"}]),
        "/images/0/uri: ../../secret.png lies outside the file's folder",
        "dropped a texture: .*: /images/0",
        12,
    ),
    "picture cut off": (
        lambda: edit(cube(), "/images/0", {"uri": gltf.data_uri(gltf.png(PIXELS)[:60])}),
        "/images/0: is broken: ",
        "dropped a texture: is broken: .*: /images/0",
        12,
    ),
}


@pytest.mark.parametrize("name", REPAIRS)
def test_what_is_broken_is_an_error_or_dropped_and_counted(tmp_path, name):
    build, error, note, faces = REPAIRS[name]
    for strict in (False, True):
        with pytest.raises(InputError, match=error) as caught:
            read(build(), tmp_path, strict=strict)
        assert "\n" not in str(caught.value)
    asset = read(build(), tmp_path, repair=True)
    (told,) = asset.notes
    assert re.fullmatch(note, told), told
    assert asset.mesh.faces.shape[0] == faces
    assert_valid(asset)


def test_nothing_left_is_no_scene(tmp_path):
    for build in (with_index(255, 12), lambda: cube(POSITION=np.full((24, 3), np.nan, np.float32))):
        with pytest.raises(InputError, match="/: contains no triangles"):
            read(build(), tmp_path, repair=True)


MENDS = {
    "factor above 1": (f"/materials/0/{'pbrMetallicRoughness'}/metallicFactor", 1e9, r"metallicFactor is clamped"),
    "factor below 0": ("/materials/0/pbrMetallicRoughness/roughnessFactor", -5, "roughnessFactor is clamped"),
    "colour above 1": ("/materials/0/pbrMetallicRoughness/baseColorFactor", [2, 0, 0, 1], "baseColorFactor is clamped"),
    "emission below 0": ("/materials/0/emissiveFactor", [0, -1, 0], "emissiveFactor is clamped"),
    "quaternion of length 2": ("/nodes/0/rotation", [0, 0, 0, 2], "no unit quaternion is scaled to one"),
    "quaternion of length 0": ("/nodes/0/rotation", [0, 0, 0, 0], "no unit quaternion is taken as none"),
}


@pytest.mark.parametrize("name", MENDS)
def test_what_is_put_right_is_said_and_strict_forbids_it(tmp_path, name):
    path, value, message = MENDS[name]
    (told,) = read(changed(path, value)(), tmp_path).notes
    assert message in told
    with pytest.raises(InputError, match=f"{message}.*, which strict forbids"):
        read(changed(path, value)(), tmp_path, strict=True)


def test_strict_reads_what_is_whole(tmp_path):
    assert read(cube(), tmp_path, strict=True).notes == ()
    with pytest.raises(ValueError, match="repair and strict exclude each other"):
        Reading(repair=True, strict=True)


def test_load_says_the_same(tmp_path):
    """`load` raises the reader's error and warns of its notes; the caller's rules reach it."""
    path = gltf.write(with_index(255)(), tmp_path / "model")
    with pytest.raises(InputError, match="index 255 but only 24 vertices; export it again, or drop it with repair"):
        jr.load(path)
    with pytest.warns(AssetWarning, match="model.glb: dropped 1 of 12 faces") as caught:
        scene, _ = jr.load(path, repair=True)
    assert len(caught) == 1 and scene.mesh.faces.shape == (11, 3)
    with pytest.raises(
        LimitError, match=r"brings the scene's triangles to 11; at most 10 are allowed \(limit triangles\)"
    ):
        jr.load(path, repair=True, limits=Limits(triangles=10))


# ------------------------------------------------------------------------------------------------ limits


def chain(length: int) -> dict:
    """The cube at the end of a chain of nodes."""
    document = cube()
    document["nodes"] = [{"children": [i + 1], "translation": [0, 1e-3, 0]} for i in range(length - 1)]
    document["nodes"].append({"mesh": 0})
    return document


def instances(count: int) -> dict:
    document = cube()
    document["nodes"], document["scenes"] = [{"mesh": 0}] * count, [{"nodes": list(range(count))}]
    return document


def without_data(count: int) -> dict:
    document = edit(cube(), "/accessors/0/count", count)
    del document["accessors"][0]["bufferView"]
    return document


LIMITS = {
    # document, limits, the line
    "file": (cube, {"file_bytes": 1000}, r"model.glb: has \d+ bytes; at most 1000 are allowed \(limit file_bytes\)"),
    "triangles": (cube, {"triangles": 11}, r"brings the scene's triangles to 12; at most 11 .* \(limit triangles\)"),
    "instances": (lambda: instances(1000), {"triangles": 5000}, "brings the scene's triangles to 5004; at most 5000"),
    "nodes": (lambda: instances(1000), {"nodes": 999}, r"/nodes: has 1000 nodes; at most 999 .* \(limit nodes\)"),
    "pixels of a picture": (cube, {"image_pixels": 34}, r"7 x 5 .*at most 34 are allowed \(limit image_pixels\)"),
    "side of a picture": (cube, {"image_side": 6}, r"side of 7 pixels; at most 6 are allowed \(limit image_side\)"),
    "texels": (cube, {"texels": 34}, r"/images/0: brings .* texels.* to 35; at most 34 are allowed \(limit texels\)"),
    "2e9 elements": (
        lambda: without_data(2_000_000_000),
        {},
        "/accessors/0: brings what it claims without data to 24000000000",
    ),
    "1e12 elements": (
        lambda: without_data(10**12),
        {},
        "/accessors/0: brings what it claims without data to 12000000000000",
    ),
    "claims": (
        lambda: without_data(100_000),
        {"claimed_bytes": 10**6},
        r"without data to 1200000; .*\(limit claimed_bytes\)",
    ),
}


@pytest.mark.parametrize("name", LIMITS)
def test_every_limit_is_named_and_refuses_before_memory_is_asked_for(tmp_path, name):
    build, limits, message = LIMITS[name]
    with pytest.raises(LimitError, match=message) as caught:
        read(build(), tmp_path, limits=Limits(**limits))
    assert "\n" not in str(caught.value)


TIMED = """
import sys, time
from jaxraster.io.gltf import read_gltf
read_gltf(sys.argv[1])
seconds = []
for _ in range(3):
    began = time.process_time()
    read_gltf(sys.argv[2])
    seconds.append(time.process_time() - began)
print(min(seconds))
"""


@pytest.mark.parametrize("build", [lambda: chain(50_000), lambda: instances(20_000)], ids=["chain", "instances"])
def test_deep_chains_and_many_instances_take_under_a_second(tmp_path, build):
    """In a process of its own, where no type is checked; the best of three, twice over for other work on the core."""
    paths = gltf.write(cube(), tmp_path / "small"), gltf.write(build(), tmp_path / "large")
    told = subprocess.run([sys.executable, "-c", TIMED, *map(str, paths)], capture_output=True, text=True, check=True)
    assert float(told.stdout) < 2


def test_a_chain_that_multiplies_ends_in_an_error(tmp_path):
    document = chain(200)
    for node in document["nodes"]:
        node["scale"] = [10, 10, 10]
    with pytest.raises(InputError, match=r"its world transform holds 1e\+19; at most 1\.844e\+18 is drawn"):
        read(document, tmp_path)
    assert np.finfo(np.float32).max > 99 * LARGEST**2


# ------------------------------------------------------------------------------------------------ random damage


STAGE, STAGE_CAMERA = jr.scenes.stage()


def assert_valid(asset) -> None:
    """What was read can be drawn: shapes and indices agree, and every number is finite."""
    parts = {name: getattr(asset, name) for name in ("mesh", "materials", "textures")}
    scene = dataclasses.replace(STAGE, **parts, **({"lights": asset.lights} if asset.lights else {}))
    check_scene(scene, asset.cameras[0] if asset.cameras else STAGE_CAMERA)
    for leaf in jax.tree.leaves((parts, asset.cameras)):
        assert np.isfinite(np.asarray(leaf)).all()
    assert asset.mesh.faces.shape[0] > 0


def numbers_of(value, path=()):
    """The paths of all leaves of a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield from numbers_of(part, (*path, key))
    if not isinstance(value, dict | list):
        yield path


WHOLE = cube()
DOCUMENT = {key: value for key, value in WHOLE.items() if key != "bytes"} | {
    "buffers": [{"byteLength": len(WHOLE["bytes"])}]
}
LEAVES = sorted(numbers_of(DOCUMENT), key=str)
ODD = st.sampled_from(
    [None, -1, 0, 1, 2, 3.5, 255, 2**31, 10**12, 1e39, "", "x", "../x", "http://x/y", [], {}, True, [[]]]
)


def put(document, path, value) -> None:
    for key in path[:-1]:
        document = document[key]
    document[path[-1]] = value


def get(document, path):
    for key in path:
        document = document[key]
    return document


@st.composite
def damaged(draw) -> bytes:
    """A GLB with a value of its JSON swapped or replaced, bytes flipped in its data or anywhere, or its end cut off."""
    document, kind = copy.deepcopy(DOCUMENT), draw(st.sampled_from(["swap", "replace", "data", "bytes", "cut"]))
    if kind in ("swap", "replace"):
        path, other = draw(st.sampled_from(LEAVES)), draw(st.sampled_from(LEAVES))
        put(document, path, get(DOCUMENT, other) if kind == "swap" else draw(ODD))
    data = bytearray(gltf.glb(json.dumps(document).encode(), bytes(WHOLE["bytes"])))
    if kind in ("data", "bytes"):
        first = len(data) - len(WHOLE["bytes"]) if kind == "data" else 0
        for _ in range(draw(st.integers(1, 6 if kind == "data" else 2))):
            data[draw(st.integers(first, len(data) - 1))] ^= draw(st.integers(1, 255))
    return bytes(data[: draw(st.integers(0, len(data) - 1))] if kind == "cut" else data)


def test_random_damage_gives_a_scene_or_one_typed_error(tmp_path):
    """Of 1,000 damaged files some are still read, with and without repair; none hangs, grows, or reaches out."""
    outcomes = {"read": 0, "repaired": 0, "refused": 0}

    @hypothesis.settings(max_examples=1000, deadline=None, derandomize=True, database=None)
    @hypothesis.given(damaged(), st.booleans())
    def check(data, repair):
        path = tmp_path / "damaged.glb"
        path.write_bytes(data)
        try:
            with watched(tmp_path):
                asset = read_gltf(path, Reading(repair=repair))
        except Error as error:
            assert "\n" not in str(error) and str(error).startswith(str(path))
            outcomes["refused"] += 1
        else:
            assert_valid(asset)
            outcomes["repaired" if any(note.startswith("dropped") for note in asset.notes) else "read"] += 1

    check()
    assert min(outcomes.values()) > 20, outcomes


def test_every_truncation_is_noticed(tmp_path):
    data = gltf.write(cube(), tmp_path / "whole").read_bytes()
    for size in range(0, len(data), 4):
        (tmp_path / "cut.glb").write_bytes(data[:size])
        with pytest.raises(InputError) as caught:
            read_gltf(tmp_path / "cut.glb", Reading(repair=True))
        assert str(caught.value).startswith(str(tmp_path / "cut.glb"))


def test_the_undamaged_file_is_drawn(tmp_path):
    """So that the others are known to fail for what was done to them."""
    path = gltf.write(cube(), tmp_path / "model")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene, camera = jr.load(path)
    plan, _ = jr.plan_for(scene, camera, width=16, height=12)
    frame = jax.jit(jr.render)(scene, camera, plan)
    assert 20 < (frame.visibility.face >= 0).sum() < 16 * 12
    assert np.isfinite(frame.image).all() and frame.image.std() > 0.01
    assert struct.unpack_from("<4sI", path.read_bytes()) == (b"glTF", 2)
