"""The house style, as far as a program can see it."""

import ast
import importlib
import inspect
import io
import pathlib
import re
import statistics
import tokenize

import pytest

ROOT = pathlib.Path(__file__).parents[2]
SOURCES = sorted((ROOT / "jaxraster").rglob("*.py"))
HOME_OF_EPSILONS = ROOT / "jaxraster" / "math" / "safe.py"


def future_annotations(source: str) -> list[int]:
    """Lines that import `annotations` from the future: they would hide shapes from the checker of the tests."""
    nodes = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom))
    return [n.lineno for n in nodes if n.module == "__future__" and any(a.name == "annotations" for a in n.names)]


def uninitialised_arrays(source: str) -> list[int]:
    """Lines that say `jnp.empty`: zeros in older versions of JAX, leftovers in newer ones."""
    nodes = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Attribute))
    return [n.lineno for n in nodes if re.fullmatch(r"(jnp|jax\.numpy)\.empty(_like)?", ast.unparse(n))]


def bare_small_literals(source: str) -> list[int]:
    """Lines with a number like 1e-6 and no comment on them or just above."""
    tokens = list(tokenize.generate_tokens(io.StringIO(source).readline))
    comments = {token.start[0] for token in tokens if token.type == tokenize.COMMENT}
    small = {t.start[0] for t in tokens if t.type == tokenize.NUMBER and re.search(r"e-\d", t.string.lower())}
    return sorted(line for line in small if not comments & {line, line - 1})


LAWS = [
    (future_annotations, "from __future__ import annotations", "from __future__ import division"),
    (uninitialised_arrays, "x = jnp.empty(3)", "x = np.empty(3); y = jnp.zeros(3)"),
    (uninitialised_arrays, "x = jax.numpy.empty_like(y)", "empty = jnp"),
    (bare_small_literals, "x = 1e-6", "x = 1e-6  # half an ulp of 16"),
    (bare_small_literals, "# first\n\nx = 2.5E-07", "# half an ulp of 4\nx = 2.5E-07"),
]


@pytest.mark.parametrize(("law", "broken", "kept"), LAWS)
def test_each_law_tells_broken_from_kept(law, broken, kept):
    assert law(broken) == [len(broken.splitlines())]
    assert law(kept) == []


@pytest.mark.parametrize("law", dict.fromkeys(law for law, *_ in LAWS), ids=lambda law: law.__name__)
def test_sources_keep(law):
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in SOURCES
        for line in law(path.read_text())
        if not (law is bare_small_literals and path == HOME_OF_EPSILONS)
    ]
    assert found == [], f"{law.__name__}: {law.__doc__}"


def test_files_are_short():
    """No file is over 300 lines, and half of them are within 140."""
    lines = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in SOURCES}
    median = statistics.median(count for count in lines.values() if count)
    print(f"{len(lines)} files, {sum(lines.values())} lines, median {median:g}, longest {max(lines.values())}")
    assert {name: count for name, count in lines.items() if count > 300} == {}
    assert median <= 140


def test_everything_public_is_documented():
    """Every module has a docstring, and so has every function and record of the package's face."""
    assert [str(path.relative_to(ROOT)) for path in SOURCES if not ast.get_docstring(ast.parse(path.read_text()))] == []
    face = {name: value for name, value in vars(importlib.import_module("jaxraster")).items() if name[0] != "_"}
    assert {"load", "plan_for", "render", "save", "scenes"} <= face.keys()
    assert [name for name, value in face.items() if callable(value) and not inspect.getdoc(value)] == []


def test_no_function_hides_a_package():
    """A name of the face that is also a folder is that folder: `jr.study.run`, not `jr.study`, is a function."""
    face = vars(importlib.import_module("jaxraster"))
    folders = {path.name for path in (ROOT / "jaxraster").iterdir() if (path / "__init__.py").exists()}
    assert [name for name in folders & face.keys() if not inspect.ismodule(face[name])] == []
