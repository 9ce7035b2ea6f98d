"""For all tests: pages (README.md, docs) run where the scene they load exists; no process runs out of memory maps."""

import pathlib

import jax
import pytest

# Linux allows a process 65,530 (vm.max_map_count), without which XLA crashes; a program holds tens, a file thousands.
MOST_MAPS = 25_000


@pytest.fixture(autouse=True, scope="module")
def few_maps():
    """Let go of compiled programs between files, when there are many."""
    yield
    maps = pathlib.Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


@pytest.fixture(autouse=True)
def page_folder(request, monkeypatch, tmp_path_factory):
    """For a page, make `helmet.gltf` in an empty folder and go there; a green metal dome stands in for the helmet."""
    if request.node.path.suffix != ".md":
        return
    monkeypatch.syspath_prepend(pathlib.Path(__file__).parent / "tests")
    import gltf_writer as gltf
    import numpy as np

    from jaxraster.geometry.shapes import uv_sphere

    folder = tmp_path_factory.mktemp("page")
    sphere = uv_sphere(1.0, 24, 12)
    document = gltf.new()
    arrays = {"POSITION": np.asarray(sphere.vertices), "NORMAL": np.asarray(sphere.normals)}
    metal = {"baseColorFactor": [0.3, 0.6, 0.4, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.3}
    gltf.put(document, "materials", {"pbrMetallicRoughness": metal})
    mesh = gltf.mesh(document, np.asarray(sphere.faces, np.uint16).reshape(-1), {"material": 0}, **arrays)
    gltf.put(document, "scenes", {"nodes": [gltf.node(document, mesh=mesh)]})
    gltf.write(document, folder / "helmet", "data")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.chdir(folder)
