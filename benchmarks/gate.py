"""Rows held against those of the last `--write`, times as ratios to the calibration of their own run."""

import json
import pathlib

from .measure import Row

BASELINE = pathlib.Path(__file__).parent / "baseline.json"
# How many times what it was each may be.
ALLOWED = {
    "steady": 1.5,  # repeats within a few percent, and within a half where three times the machine's cores are wanted
    "compile": 3.0,  # takes seconds and is measured once: no moment without other work is short enough to be found
    "memory": 1.1,  # is the same in every run; versions of XLA differ by a little
}


def ratios(row: Row) -> dict[str, float]:
    """What is compared of a row: times over the calibration's, and bytes."""
    return {
        "steady": row.steady / row.calibration,
        "compile": row.compile / row.calibration,
        "memory": row.memory,
    }


def _key(row: Row) -> str:
    return f"{row.workload}, {row.size} px"


def write(rows: list[Row]) -> None:
    """Let these rows be what later ones are held against."""
    table = {_key(row): {name: float(f"{value:.4g}") for name, value in ratios(row).items()} for row in rows}
    BASELINE.write_text(json.dumps(table, indent=2) + "\n")


def offenders(rows: list[Row]) -> list[str]:
    """A line for every number that is worse than it may be, and for every row that there is nothing to compare to."""
    table = json.loads(BASELINE.read_text()) if BASELINE.exists() else {}
    lines = [f"{_key(row)}: not in {BASELINE.name}; write it with --write" for row in rows if _key(row) not in table]
    for row in rows:
        for name, then in table.get(_key(row), {}).items():
            now = ratios(row)[name]
            if now > ALLOWED[name] * then:
                lines.append(f"{_key(row)}: {name} is {now:.4g}, was {then:.4g}, may be {ALLOWED[name]} times as much")
    return lines
