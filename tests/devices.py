"""Several devices of one processor: they have to be asked for before JAX starts, in a process of its own."""

import os
import pathlib
import subprocess
import sys
import textwrap

ROOT = pathlib.Path(__file__).parents[1]
START = """
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import Mesh, PartitionSpec as P
jax.config.update("jax_num_cpu_devices", {count})
assert len(jax.devices()) == {count}
"""


def run_on_devices(count: int, script: str) -> None:
    """Run a script, which finds jax, jnp, np, Mesh and P, and say how it failed."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    path = os.pathsep.join(str(ROOT / folder) for folder in ("tests", "tests/formulas", "."))
    command = [sys.executable, "-c", START.format(count=count) + textwrap.dedent(script) + "\nprint('done')"]
    run = subprocess.run(
        command, capture_output=True, text=True, timeout=600, env=environment | {"PYTHONPATH": path}, cwd=ROOT
    )
    assert (run.returncode, run.stdout) == (0, "done\n"), run.stderr[-2000:]
