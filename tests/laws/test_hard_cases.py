"""The page of hard cases is what the tests say, every case is on it, and every test it names exists."""

from hard_case import ELSEWHERE, NOT_BUILT, PAGE, ROOT, case, decorated, missing, page, rows


def test_the_page_is_what_the_tests_say():
    assert PAGE.read_text() == page(), "stale: run `python -m tests.hard_case`"


def test_every_case_has_a_row():
    expected = {f"R{number}" for number in range(1, 22)} | {f"I{number}" for number in range(1, 13)}
    expected |= {f"V{number}" for number in range(1, 13)} | {f"E{number}" for number in range(1, 11)}
    expected |= {f"A{number}" for number in range(1, 8)}
    assert {id for id, *_ in rows()} == expected
    assert len(rows()) == len(ELSEWHERE) + len(decorated()) == len(set(rows()))


def test_every_test_that_is_named_exists():
    named = [test for *_, test in rows() if test != NOT_BUILT]
    assert len(named) > 40 and missing(named) == []
    gone = ["tests/hard_case.py::no_such_test", "tests/no_such_file.py::test"]
    assert missing([*gone, "tests/hard_case.py::case"]) == gone


def test_every_test_of_hard_cases_says_which():
    files = sorted((ROOT / "tests" / "hard_cases").glob("test_*.py"))
    written = [
        f"{file.relative_to(ROOT)}::{line[4:].split('(')[0]}"
        for file in files
        for line in file.read_text().splitlines()
        if line.startswith("def test_")
    ]
    assert {test for *_, test in decorated()} == set(written) and len(files) >= 2


def test_a_case_leaves_its_test_as_it_is():
    assert case("R1", "input", "promise")(page) is page
