"""The same bits on every Python."""

import ast
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

import lemma
from lemma.core.seeding import ordered_sum

PACKAGE = Path(lemma.__file__).parent
SIMULATED = ("core", "robots", "scene", "tasks", "motion", "env", "expert")
"""Folders that decide what is simulated."""
# Of floats, the first is compensated since Python 3.12, the second is new there. The
# others are exact, and so differ from a plain loop, which kernels would need.
FORBIDDEN = {"sum", "sumprod", "fsum", "statistics"}
UNORDERED = {"set", "frozenset"}
ITERATING = {"list", "tuple", "iter", "enumerate", "zip", "map", "filter"}


def test_numbers_are_added_from_first_to_last() -> None:
    # 1e16 swallows each 1; a compensated sum is 1e16 + 2.
    assert ordered_sum([1e16, 1.0, 1.0]) == 1e16
    assert ordered_sum([0.1] * 10) != math.fsum([0.1] * 10) == 1.0
    assert ordered_sum([]) == 0.0


@pytest.mark.parametrize("folder", SIMULATED)
def test_nothing_that_is_simulated_depends_on_the_python(folder: str) -> None:
    found = [
        f"{path.relative_to(PACKAGE)}:{fault}"
        for path in sorted((PACKAGE / folder).rglob("*.py"))
        # Workers decide where something is computed, not what.
        if "workers" not in path.parts
        for fault in faults(path.read_text())
    ]
    assert found == []


@pytest.mark.parametrize(
    "code",
    [
        *("sum(x)", "math.fsum(x)", "from math import sumprod", "import statistics"),
        *("from statistics import mean", "for a in {b, c}: pass", "list(set(x))"),
        *("[a for a in frozenset(x)]", "{a: 1 for a in {b for b in c}}"),
    ],
)
def test_the_check_finds(code: str) -> None:
    assert list(faults(code)) != []


@pytest.mark.parametrize(
    "code", ["x.sum()", "np.sum(x)", "sorted(set(x))", "a in {b, c}", "len(set(x))"]
)
def test_the_check_allows(code: str) -> None:
    assert list(faults(code)) == []


def faults(code: str) -> Iterator[str]:
    """Yield lines that add floats by a sum of Python's, or iterate over a set."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Name) and node.id == "sum":
            yield f"{node.lineno}: sum"
        elif isinstance(node, ast.Attribute) and ast.unparse(node) in {
            f"math.{name}" for name in FORBIDDEN
        }:
            yield f"{node.lineno}: {ast.unparse(node)}"
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name for alias in node.names}
            names.add(getattr(node, "module", None) or "")
            for name in names & FORBIDDEN:
                yield f"{node.lineno}: {name}"
        elif isinstance(node, ast.For | ast.comprehension):
            yield from _unordered(node.iter)
        elif isinstance(node, ast.Call) and _called(node) in ITERATING:
            for argument in node.args:
                yield from _unordered(argument)


def _unordered(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.Set | ast.SetComp) or (
        isinstance(node, ast.Call) and _called(node) in UNORDERED
    ):
        yield f"{node.lineno}: the order of a set"


def _called(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else ""
