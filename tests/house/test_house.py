"""What keeps the house simple: lengths, the drive's interface, names, codes."""

from __future__ import annotations

import ast
from collections import defaultdict

import pytest

from drivers.drive import Drive
from tests.house.codes import page
from tests.house.source import ROOT, functions, modules

LONGEST_MODULE = 500  # lines
LONGER = {"drivers/virtual/firmware.py": 560}  # one state machine, its loops and its time
LONG_FUNCTION, LONG_FUNCTIONS = 60, 0.005  # lines; share of the functions
VERBS = 12


def test_no_module_is_longer_than_can_be_read_at_once() -> None:
    lengths = {path: len((ROOT / path).read_text("utf-8").splitlines()) for path in modules()}
    longer = {path: n for path, n in lengths.items() if n > LONGER.get(path, LONGEST_MODULE)}
    assert longer == {}


def test_few_functions_are_long() -> None:
    lengths = [(node.end_lineno or 0) - node.lineno + 1 for _, node in functions()]
    long = sum(length > LONG_FUNCTION for length in lengths)
    assert long <= LONG_FUNCTIONS * len(lengths)


def test_a_drive_has_at_most_twelve_verbs() -> None:
    verbs = [name for name, value in vars(Drive).items() if callable(value) and name[0] != "_"]
    assert 0 < len(verbs) <= VERBS


def test_nobody_reaches_through_a_drive_into_its_profile() -> None:
    found = [
        f"{path}:{node.lineno}"
        for path, tree in modules().items()
        if path.startswith("commissioning/")
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Attribute)
        and node.value.attr == "profile"
        and ast.unparse(node.value.value).endswith("drive")
    ]
    assert found == []


def test_a_class_has_a_name_of_its_own() -> None:
    places = defaultdict(set)
    for path, tree in modules().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].add(path)
    assert {name: at for name, at in places.items() if len(at) > 1} == {}


def test_what_an_error_says_is_not_patched() -> None:
    found = [
        f"{path}:{node.lineno}"
        for path, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr == "args"
        and isinstance(node.ctx, ast.Store)
    ]
    assert found == []


def test_every_code_is_in_the_docs() -> None:
    assert page() == (ROOT / "docs" / "codes.md").read_text("utf-8")


@pytest.mark.parametrize(
    "head", ["## Errors", "## Reasons of a verdict", "## Why something is not done"]
)
def test_there_are_codes_of_every_kind(head: str) -> None:
    part = page().partition(head)[2].partition("\n## ")[0]
    assert part.count("\n| `") > 10
