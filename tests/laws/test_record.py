"""Records: frozen, keyword-only, and pytrees whose treedef is what compiles."""

import dataclasses
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float, TypeCheckError

from jaxraster.plan import Plan
from jaxraster.record import is_static, record, static
from jaxraster.scene import Camera, Directional, Lights, Point, Spot


@record
class Inner:
    """A record in a record."""

    weight: float = 1.0
    order: int = static(2)


@record
class Outer:
    """Leaves of every sort, and static fields."""

    values: Float[Array, " n"]
    gain: float = 0.5
    inner: Inner | None = Inner()
    name: str = static("plain")
    sizes: tuple = static((1, 2))

    def validate(self):
        if self.name == "":
            raise ValueError("Outer.name must not be empty")


VALUES = jnp.arange(3.0)


def test_records_are_frozen_and_keyword_only():
    outer = Outer(values=VALUES)
    with pytest.raises(dataclasses.FrozenInstanceError):
        outer.gain = 1.0
    with pytest.raises(TypeError, match="positional"):
        Outer(VALUES)
    with pytest.raises(TypeError, match="values"):
        Outer()
    with pytest.raises(TypeError, match="gian"):
        Outer(values=VALUES, gian=1.0)


def test_a_record_goes_through_a_pytree_and_back():
    outer = Outer(values=VALUES, gain=0.25, inner=Inner(weight=3.0, order=5), name="tall", sizes=(4, ("a", None)))
    leaves, treedef = jax.tree.flatten(outer)
    assert [leaf is VALUES for leaf in leaves] == [True, False, False] and leaves[1:] == [0.25, 3.0]
    back = treedef.unflatten(leaves)
    assert type(back) is Outer and type(back.inner) is Inner
    assert (back.values is VALUES, back.gain, back.inner.weight) == (True, 0.25, 3.0)
    assert (back.inner.order, back.name, back.sizes) == (5, "tall", (4, ("a", None)))
    assert jax.tree.leaves(Outer(values=VALUES, inner=None)) == [VALUES, 0.5]


def test_anything_may_stand_in_a_leaf_s_place():
    """Rebuilding does not construct: no cast, no check, no type."""
    outer = Outer(values=VALUES)
    nothing = jax.tree.map(lambda leaf: None, outer)
    assert (nothing.values, nothing.gain, nothing.inner.weight, nothing.inner.order) == (None, None, None, 2)
    shapes = jax.eval_shape(lambda o: o, outer)
    assert shapes.values == jax.ShapeDtypeStruct((3,), jnp.float32) and shapes.name == "plain"
    assert jax.tree.map(lambda leaf: 7, outer).gain == 7 and type(jax.tree.map(lambda leaf: 7, outer).gain) is int
    axes = jax.tree.map(lambda leaf: 0, outer)
    assert jax.vmap(lambda o: o.values[0] * o.gain, in_axes=(axes,))(
        Outer(values=VALUES[:, None], gain=VALUES, inner=Inner(weight=VALUES))
    ).tolist() == [0, 1, 4]


def test_records_stack_and_map():
    several = [Inner(weight=VALUES[i]) for i in range(3)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *several)
    assert stacked.weight.tolist() == [0, 1, 2] and stacked.order == 2
    doubled = jax.vmap(lambda inner: dataclasses.replace(inner, weight=2 * inner.weight))(stacked)
    assert type(doubled) is Inner and doubled.weight.tolist() == [0, 2, 4]


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (VALUES, "ArrayImpl"),
        (np.float32(1), "float32"),
        (np.int64(3), "int64"),
        (0.5, "float"),
        ([1, 2], "list"),
        ({1}, "set"),
        ((1, VALUES), "ArrayImpl"),
        ((1, (2, [3])), "list"),
        ((0.5, 1), "float"),
        (Inner(), "Inner"),
        (("a", print), "builtin_function_or_method"),
    ],
)
def test_a_static_field_takes_only_what_keys_a_compilation(value, named):
    """An array would be noticed only by the second call, and a list never compares equal."""
    message = rf"^Outer\.sizes is static: expected int, str, bool or a tuple of these, got {named}$"
    with pytest.raises(TypeError, match=message):
        Outer(values=VALUES, sizes=value)
    with pytest.raises(TypeError, match=message):
        dataclasses.replace(Outer(values=VALUES), sizes=value)


def test_a_tracer_is_not_static():
    with pytest.raises(TypeError, match=r"Inner\.order is static: .* got \w*Tracer"):
        jax.jit(lambda n: Inner(order=n).weight)(3)


@pytest.mark.parametrize("value", [3, "word", True, None, (), (1, ("a", None, False))])
def test_static_fields_take_numbers_names_and_tuples(value):
    outer = Outer(values=VALUES, sizes=value)
    assert outer.sizes == value and jax.tree.structure(outer) == jax.tree.structure(Outer(values=VALUES, sizes=value))


def test_whole_numbers_become_floats_in_leaves_alone():
    inner = Inner(weight=2, order=3)
    assert (type(inner.weight), inner.weight, type(inner.order)) == (float, 2.0, int)
    assert type(dataclasses.replace(inner, weight=7).weight) is float
    assert jax.grad(lambda i: i.weight**2)(inner).weight == 4

    @record
    class Switch:
        on: bool = True

    assert Switch(on=False).on is False
    array = jnp.arange(3)
    assert Switch(on=array).on is array


def test_key_paths_are_attributes():
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_flatten_with_path(Outer(values=VALUES))[0]]
    assert paths == [".values", ".gain", ".inner.weight"]


def test_the_treedef_is_the_static_part():
    same = [jax.tree.structure(Outer(values=VALUES * i, gain=i)) for i in (1, 2)]
    assert same[0] == same[1] and hash(same[0]) == hash(same[1])
    others = [{"name": "tall"}, {"sizes": (2, 1)}, {"inner": None}, {"inner": Inner(order=3)}]
    treedefs = {jax.tree.structure(Outer(values=VALUES, **other)) for other in others} | {*same}
    assert len(treedefs) == 5


def test_replace_validates_again():
    outer = Outer(values=VALUES)
    changed = dataclasses.replace(outer, name="tall", gain=2)
    assert (changed.name, changed.gain, changed.values is VALUES, outer.name) == ("tall", 2.0, True, "plain")
    for make in (lambda: Outer(values=VALUES, name=""), lambda: dataclasses.replace(outer, name="")):
        with pytest.raises(ValueError, match=r"Outer\.name must not be empty"):
            make()


def test_records_compare_by_identity():
    """Arrays have no truth value; a record is hashable and equal to itself alone."""
    first, second = Inner(), Inner()
    assert first == first and first != second and len({first, second}) == 2
    assert (Outer(values=VALUES) == Outer(values=VALUES)) is False


def test_leaves_do_not_retrace_and_statics_do():
    traced = []

    @jax.jit
    def total(outer):
        traced.append(outer.name)
        return outer.values.sum() * outer.gain * outer.inner.weight * outer.inner.order

    outer = Outer(values=VALUES, gain=2.0)
    assert total(outer) == 12 and len(traced) == 1
    for knob in ({"gain": 3}, {"gain": -1.5}, {"values": VALUES + 1}, {"inner": Inner(weight=9)}):
        total(dataclasses.replace(outer, **knob))
    assert len(traced) == 1
    # An array in a float's place has a type of its own: once.
    for gain in (1.0, 2.0):
        total(dataclasses.replace(outer, gain=jnp.float32(gain)))
    assert len(traced) == 2
    for name in ("tall", "wide", "tall", "plain"):
        total(dataclasses.replace(outer, name=name))
    assert traced == ["plain", "plain", "tall", "wide"]


def test_gradients_are_records():
    outer = Outer(values=VALUES, gain=2.0, inner=None)
    gradient = jax.grad(lambda o: (o.values**2).sum() * o.gain)(outer)
    assert type(gradient) is Outer and gradient.inner is None and gradient.name == "plain"
    assert (gradient.values.tolist(), gradient.gain) == ([0, 4, 8], 5)


def test_shapes_are_checked_in_tests():
    """The hook of this test session sees records too: lights of another rank are refused."""
    with pytest.raises(TypeCheckError, match="direction"):
        Directional(direction=jnp.zeros(3), irradiance=jnp.zeros((1, 3)))


@pytest.mark.parametrize("kind", [Plan, Camera, Directional, Point, Spot, Lights])
def test_public_records_know_their_static_fields(kind):
    """What is static is an int, str, bool or tuple by its annotation, and nothing else is."""
    plain = {int, str, bool, tuple}
    for field in dataclasses.fields(kind):
        assert is_static(field) == (field.type in plain), field.name
    assert all(p.kind is p.KEYWORD_ONLY for p in inspect.signature(kind).parameters.values())
