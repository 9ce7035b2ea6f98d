"""The table of rows as Markdown, with the machine that it was measured on, and its place in the documentation."""

import contextlib
import os
import pathlib
import platform

import jax
import numpy as np

from .measure import Row

PAGE = pathlib.Path(__file__).parents[1] / "docs" / "benchmarks.md"
BEGIN, END = "<!-- the table of python -m benchmarks --write: begin -->", "<!-- end -->"


def head(peers: list[str]) -> str:
    """The table's first two lines."""
    columns = ["workload", "px", "compile, s", "ours, ms", "memory, MiB", "differ", *(f"{peer}, ms" for peer in peers)]
    return f"| {' | '.join(columns)} |\n|---{'|--:' * (len(columns) - 1)}|"


def line(row: Row, peers: list[str]) -> str:
    """A line of the table: behind every time, its ratio to the calibration's."""

    def cell(time: float | None, unit: float = 1.0) -> str:
        return "–" if time is None else f"{time / unit:.2f} ({time / row.calibration:.2f})"

    differ = "–" if row.differ is None else f"{100 * row.differ:.3f} %"
    cells = [row.workload, str(row.size), cell(row.compile, 1e3), cell(row.steady), f"{row.memory / 2**20:.1f}", differ]
    return f"| {' | '.join([*cells, *(cell(row.peers.get(peer)) for peer in peers)])} |"


def means(rows: list[Row], peers: list[str]) -> str:
    """The geometric mean of each peer's time over ours, of the rows that it could draw."""
    logs = {peer: [np.log(row.peers[peer] / row.steady) for row in rows if peer in row.peers] for peer in peers}
    return ", ".join(f"{peer} {np.exp(np.mean(log)):.2f} ({len(log)} rows)" for peer, log in logs.items() if log)


def machine() -> str:
    """Processor, cores, system and versions; no date and no name."""
    processor, system = platform.processor() or platform.machine(), platform.system()
    with contextlib.suppress(OSError, StopIteration):
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(text.split(":")[1].strip() for text in lines if text.startswith("model name"))
    with contextlib.suppress(OSError):
        system = platform.freedesktop_os_release()["PRETTY_NAME"]
    python, device = platform.python_version(), jax.devices()[0].device_kind
    return f"{processor}, {os.cpu_count()} cores, {system}, Python {python}, jax {jax.__version__} on {device}"


def write(rows: list[Row], peers: list[str], about: list[str]) -> None:
    """Put the table, and a list of lines about it, where the page keeps them."""
    before, _, rest = PAGE.read_text().partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"{PAGE} must hold the lines {BEGIN!r} and {END!r}; put them where the table belongs")
    table = "\n".join([head(peers), *(line(row, peers) for row in rows)])
    notes = "\n".join(f"- {text}" for text in about)
    PAGE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{notes}\n\n{END}{after}")
