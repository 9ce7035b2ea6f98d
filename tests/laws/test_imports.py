"""The import law: data flows one way through the package, and importing it costs JAX and nothing else."""

import ast
import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]
PACKAGE = ROOT / "jaxraster"

# Left may not import right; names between two "<" are peers.
LAW = """
record errors math check < camera scene buffers < stack < parameters geometry < visibility < surface < brdf
< environment < light < screen < resolve < post < display < metrics < plan < scenes render < reference < bake
< study planner probe inverse < cli < __main__
"""
RANK = {name: rank for rank, group in enumerate(LAW.split("<")) for name in group.split()}
# Reading and writing files is beside the order: it sees little, and only the outermost layers see it.
IO_SEES = {"io", "record", "errors", "scene", "stack", "geometry", "math", "environment"}
SEES_IO = {"io", "study", "planner", "probe", "inverse", "cli"}
OWN = {*RANK, "io"}


def imported(source: str, module: tuple[str, ...]) -> set[str]:
    """The parts of the package that a module imports anywhere in its source; "jaxraster" for an absolute import.

    `module` is its path below the package: ("cli", "render"), ("cli", "__init__") or ("plan",).
    """
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level:
            path = (*module[: len(module) - node.level], *(node.module or "").split("."))
            path = tuple(part for part in path if part)
            found |= {path[0]} if path else {alias.name for alias in node.names}
        else:
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found |= {"jaxraster" for name in names if name.split(".")[0] == "jaxraster"}
    return found


def violations(source: str, module: tuple[str, ...]) -> list[str]:
    """What a module imports against the law."""
    own = module[0]
    if module == ("__init__",):
        allowed = OWN - {"cli", "__main__"}
    elif own == "io":
        allowed = IO_SEES
    else:
        allowed = {name for name in RANK if RANK[name] <= RANK[own]} | ({"io"} if own in SEES_IO else set())
    return sorted(imported(source, module) - allowed)


def modules() -> list[tuple[str, ...]]:
    """Every module's path below the package."""
    return sorted(path.relative_to(PACKAGE).with_suffix("").parts for path in PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("module", modules(), ids=".".join)
def test_imports_point_left(module):
    assert module[0] in OWN | {"__init__"}, f"{module[0]} has no place in the order of the import law; give it one"
    source = (PACKAGE / pathlib.Path(*module)).with_suffix(".py").read_text()
    assert violations(source, module) == []


@pytest.mark.parametrize(
    ("module", "source", "caught"),
    [
        (("math", "safe"), "from ..record import record", []),
        (("math", "safe"), "from ..scene import Mesh", ["scene"]),
        (("math", "safe"), "def f():\n    from .. import scene", ["scene"]),
        (("scene",), "from . import plan, record", ["plan"]),
        (("brdf", "fresnel"), "from . import masking", []),
        (("brdf", "fresnel"), "from ..light.ambient import ambient", ["light"]),
        (("brdf", "__init__"), "from .fresnel import schlick", []),
        (("brdf", "__init__"), "from ..light import ambient", ["light"]),
        (("render",), "from .light import ambient\nfrom .plan import Plan\nimport jax", []),
        (("render",), "import jaxraster.scene", ["jaxraster"]),
        (("render",), "from jaxraster import scene", ["jaxraster"]),
        (("render",), "from . import Frame", ["Frame"]),
        (("io", "mesh"), "from ..geometry.normals import smooth\nfrom .disk import read_file", []),
        (("io", "mesh"), "from ..display import tonemap", ["display"]),
        (("surface", "gather"), "from ..io import disk", ["io"]),
        (("cli", "render"), "from ..io.image import write_image", []),
        (("__init__",), "from .io.load import load as load\nfrom . import scenes as scenes", []),
        (("__init__",), "from .cli import main", ["cli"]),
    ],
)
def test_the_law_sees_a_violation(module, source, caught):
    assert violations(source, module) == caught


def test_import_costs_jax_alone():
    """Nothing slow or optional is loaded; no array is made, for there is no device to make it on."""
    heavy = {"scipy", "trimesh", "imageio", "OpenEXR", "colour", "PIL", "optax", "matplotlib", "beartype"}
    script = f"import sys, jaxraster; print(sorted({heavy} & set(sys.modules)))"

    def run(script: str) -> subprocess.CompletedProcess:
        environment = {**os.environ, "JAX_PLATFORMS": "nowhere"}
        command = [sys.executable, "-W", "error", "-c", script]
        return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60)

    done = run(script)
    assert (done.stdout, done.stderr) == ("[]\n", "")
    assert "nowhere" in run(script + "; import jax.numpy as jnp; jnp.zeros(1)").stderr  # arrays do need a device
