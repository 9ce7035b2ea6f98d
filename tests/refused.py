"""A command that is refused: one line on stderr names the culprit, nothing is on stdout, and nothing is written."""

import pathlib
from collections.abc import Callable


def check_refused(run: Callable[[str], int], words: str, code: int, says: str, capsys, folder: pathlib.Path) -> None:
    """Run the words in the folder and expect that exit code, and a line that says so much."""
    before = sorted(folder.rglob("*"))
    assert run(words) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("jaxraster: error: ") and err.count("\n") == 1 and err.endswith("\n")
    assert says in err
    assert sorted(folder.rglob("*")) == before
