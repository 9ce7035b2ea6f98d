"""Choosing leaves by path: whole components match, integers stay, gradients pass, and a wrong name is told so."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.parameters import matches, parameters, path_name
from jaxraster.plan import Plan
from jaxraster.scenes import cornell_box

SCENE, CAMERA = cornell_box()
TREE = {"scene": SCENE, "camera": CAMERA}


@pytest.mark.parametrize(
    ("name", "pattern", "found"),
    [
        ("mesh.vertices", "mesh.vertices", True),
        ("mesh.vertices", "vertices", True),
        ("mesh.vertices", "mesh", True),
        ("scene.mesh.vertices", "mesh", True),
        ("scene.mesh.vertices", "scene.mesh", True),
        ("scene.mesh.vertices", "scene.vertices", False),
        ("mesh.vertices", "vert", False),
        ("mesh.vertices", "esh", False),
        ("mesh.vertices", "esh.vert", False),
        ("mesh.vertices", "", False),
        ("mesh.vertices", ".", False),
        ("mesh.vertices", "mesh.", False),
        ("materials.emissive_texture", "emissive", False),
        ("lights.spot.direction", "direction", True),
        ("lights.directional.direction", "lights.spot", False),
    ],
)
def test_a_pattern_is_a_run_of_whole_components(name, pattern, found):
    assert matches(name, pattern) is found


@pytest.mark.parametrize(
    ("tree", "paths", "names"),
    [
        (SCENE, ("vertices",), {"mesh.vertices"}),
        (SCENE, "vertices", {"mesh.vertices"}),
        (SCENE, ("mesh",), {"mesh.vertices", "mesh.normals", "mesh.tangents", "mesh.uvs"}),
        (SCENE, ("direction",), {"lights.directional.direction", "lights.spot.direction"}),
        (SCENE, ("emissive", "materials.emissive", "sky"), {"materials.emissive", "environment.sky"}),
        (SCENE, (), set()),
        (TREE, ("camera",), {"camera.world_from_view", "camera.clip_from_view"}),
        (TREE, ("scene.textures",), {"scene.textures.texels"}),
        ((SCENE, [CAMERA]), ("1.0.world_from_view",), {"1.0.world_from_view"}),
        (Plan(), ("gain", "exposure"), {"ambient.gain", "emission.gain", "background.gain", "exposure"}),
        (Plan(ambient=None), ("gain",), {"emission.gain", "background.gain"}),
    ],
)
def test_paths_find_float_leaves_by_full_name(tree, paths, names):
    values, rebuild = parameters(tree, paths)
    assert set(values) == names
    assert all(jnp.issubdtype(value.dtype, jnp.floating) for value in values.values())
    # Every value is the leaf of that name, and putting them back changes nothing.
    leaves = {path_name(path): leaf for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]}
    assert all(np.array_equal(values[name], leaves[name]) for name in names)
    assert jax.tree.structure(rebuild(values)) == jax.tree.structure(tree)
    for before, after in zip(jax.tree.leaves(tree), jax.tree.leaves(rebuild(values)), strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize(
    ("path", "near"),
    [
        ("materials.base_colour", "materials.base_color"),
        ("verticies", "mesh.vertices"),
        ("iradiance", "lights.directional.irradiance"),
        ("environment.skies", "environment.sky"),
        ("mesh.faces", "mesh."),
        ("material", "material"),
        ("emissive_texture", "materials.emissive"),
        ("xyzzy", "mesh.vertices"),
        ("", "mesh.vertices"),
    ],
)
def test_an_unknown_path_names_the_nearest(path, near):
    """Also one that finds integers alone, such as `mesh.faces`: they have no gradient."""
    with pytest.raises(ValueError) as caught:
        parameters(SCENE, ("vertices", path))
    message = str(caught.value)
    assert message.startswith(f"parameters: no float leaf is named {path!r}; did you mean ") and "\n" not in message
    assert near in message.split("did you mean")[1]


def test_a_tree_without_floats_says_so():
    with pytest.raises(ValueError, match=r"no float leaf is named 'faces'; there is none at all"):
        parameters({"faces": SCENE.mesh.faces}, ("faces",))


def test_rebuild_puts_new_values_in_place_and_leaves_the_rest_alone():
    values, rebuild = parameters(SCENE, ("vertices", "lights.spot.intensity"))
    moved = rebuild({name: value + 1 for name, value in values.items()})
    np.testing.assert_array_equal(moved.mesh.vertices, SCENE.mesh.vertices + 1)
    np.testing.assert_array_equal(moved.lights.spot.intensity, SCENE.lights.spot.intensity + 1)
    assert moved.mesh.faces is SCENE.mesh.faces and moved.materials.double_sided is SCENE.materials.double_sided
    assert moved.mesh.normals is SCENE.mesh.normals
    # The first tree is untouched, and rebuild can be used again.
    assert rebuild(values).mesh.vertices is values["mesh.vertices"]


@pytest.mark.parametrize("change", [{"mesh.vertices": None}, {"mesh.normals": 1.0}])
def test_rebuild_refuses_other_names(change):
    values, rebuild = parameters(SCENE, ("vertices", "sky"))
    wrong = {name: value for name, value in {**values, **change}.items() if value is not None}
    with pytest.raises(ValueError, match=r"rebuild: expected values for \['environment\.sky', 'mesh\.vertices'\], got"):
        rebuild(wrong)


def test_gradients_pass_in_both_modes_and_under_jit():
    """Σ over the tree of leaf · weight has the weights as its gradient: nothing is scaled, mixed up or lost."""
    values, rebuild = parameters(SCENE, ("emissive", "sky", "uvs"))
    key = jax.random.key(0)
    weights = {name: jax.random.normal(key, value.shape) for name, value in values.items()}

    def total(values):
        scene = rebuild(values)
        sums = (
            (scene.materials.emissive * weights["materials.emissive"]).sum(),
            (scene.environment.sky * weights["environment.sky"]).sum(),
            (scene.mesh.uvs * weights["mesh.uvs"]).sum(),
        )
        return sum(sums) + scene.mesh.vertices.sum()

    for gradient in (jax.grad(total)(values), jax.jit(jax.jacfwd(total))(values)):
        assert gradient.keys() == weights.keys()
        for name in weights:
            np.testing.assert_allclose(gradient[name], weights[name], rtol=1e-6)


def test_a_scene_of_tracers_has_parameters_too():
    """The names do not depend on values, so that `parameters` works inside a transformation."""

    def loss(vertices):
        scene = dataclasses.replace(SCENE, mesh=dataclasses.replace(SCENE.mesh, vertices=vertices))
        values, rebuild = parameters(scene, ("vertices",))
        return (rebuild(values).mesh.vertices ** 2).sum()

    np.testing.assert_allclose(jax.jit(jax.grad(loss))(SCENE.mesh.vertices), 2 * SCENE.mesh.vertices, rtol=1e-6)


def test_knobs_that_are_plain_floats_become_arrays():
    """A plan's leaves are Python floats; their gradients are arrays, and what is None stays so."""
    values, rebuild = parameters(Plan(background=None), ("exposure", "ambient"))
    assert all(value.dtype == jnp.float32 and value.shape == () for value in values.values())
    gradient = jax.grad(lambda v: rebuild(v).exposure * 3 + rebuild(v).ambient.gain * 5)(values)
    assert {name: float(value) for name, value in gradient.items()} == {"exposure": 3, "ambient.gain": 5}
    assert rebuild(values).background is None and rebuild(values).emission.gain == 1.0
