"""The README's two lines are what is run on every change."""

import os
import pathlib
import re

ROOT = pathlib.Path(__file__).parents[2]


def test_the_two_lines_are_what_is_run():
    """The first block of the README is, line for line, what `.ci/run` does after its preamble."""
    block = (ROOT / "README.md").read_text().split("```sh\n")[1].split("```")[0]
    script = (ROOT / ".ci" / "run").read_text()
    preamble, commands = script.split("\n\n", 1)
    assert block.count("\n") == 2
    assert commands == block
    assert "set -euo pipefail" in preamble and os.access(ROOT / ".ci" / "run", os.X_OK)


def test_links_lead_somewhere():
    """Every page and picture that a page of ours links to is a file of the project; pictures are at most 300 kB."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    texts = {page: re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL) for page in pages}
    links = [(page, link) for page, text in texts.items() for link in re.findall(r"\]\(([^)#\s]+)", text)]
    files = [page.parent / link for page, link in links if "://" not in link]
    assert len(files) > len(pages) / 2
    assert [str(path) for path in files if not path.exists()] == []
    assert [str(path) for path in files if path.suffix == ".png" and path.stat().st_size > 300_000] == []
