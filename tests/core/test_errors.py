"""Every error of this package can be caught as one, and as what it is in Python."""

import ast
import inspect
import pickle
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import lemma
from lemma.core import errors
from lemma.core.errors import LemmaError, UnknownNameError
from lemma.serve.faults import FaultKind, PolicyFailedError

KINDS = [
    record
    for _, record in inspect.getmembers(errors, inspect.isclass)
    if issubclass(record, Exception) and record is not LemmaError
]


@pytest.mark.parametrize("kind", KINDS)
def test_every_error_is_ours_and_a_standard_one(kind: type[Exception]) -> None:
    assert issubclass(kind, LemmaError)
    assert issubclass(kind, ValueError | RuntimeError)


def test_there_are_the_errors_that_users_are_told_of() -> None:
    assert {kind.__name__ for kind in KINDS} >= {
        "UnknownNameError",
        "InvalidActionError",
        "InvalidConfigError",
        "SamplingError",
        "RenderingError",
        "ResetNeededError",
    }


def test_an_unknown_name_says_what_is_wrong_what_is_valid_and_what_to_try() -> None:
    message = str(UnknownNameError("task", "stak", ("pass", "stack")))
    assert message == ("Unknown task 'stak'. Did you mean 'stack'? Valid: pass, stack.")


def test_the_valid_names_may_be_any_iterable() -> None:
    message = str(UnknownNameError("task", "x", (name for name in ("a", "b"))))
    assert message.endswith("Valid: a, b.")


def bases_of(path: Path) -> dict[str, set[str]]:
    """Return the classes of a file with the names of their bases, if it has errors."""
    text = path.read_text()
    if not re.search(r"^class .*Error\b", text, re.MULTILINE):
        return {}
    return {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef)
    }


def modules_with_errors() -> list[str]:
    """Return the modules of the package that define errors, without importing any."""
    root = Path(lemma.__file__).parent
    classes = {path: bases_of(path) for path in sorted(root.rglob("*.py"))}
    names, found = {"LemmaError"}, dict.fromkeys([root / "core/errors.py"])
    before = 0
    while len(names) > before:
        before = len(names)
        for path, bases in classes.items():
            for name, above in bases.items():
                if above & names:
                    names.add(name)
                    found[path] = None
    return [
        ".".join(path.relative_to(root.parent).with_suffix("").parts) for path in found
    ]


MODULES = modules_with_errors()


def errors_in(module: str) -> list[type[LemmaError]]:
    return [
        kind
        for _, kind in inspect.getmembers(import_module(module), inspect.isclass)
        if issubclass(kind, LemmaError) and kind.__module__ == module
    ]


def test_errors_are_found_wherever_they_are_defined() -> None:
    assert MODULES[0] == "lemma.core.errors"
    assert len(MODULES) > 1


@pytest.mark.parametrize("module", MODULES)
@given(data=st.data())
def test_errors_go_from_process_to_process(module: str, data: st.DataObject) -> None:
    if "policies" in module:
        pytest.importorskip("torch", exc_type=ImportError)
    texts = st.text(max_size=20)
    arguments: dict[type[LemmaError], st.SearchStrategy[tuple[Any, ...]]] = {
        UnknownNameError: st.tuples(
            texts, st.one_of(texts, st.integers()), st.sets(texts)
        ),
        PolicyFailedError: st.tuples(st.sampled_from(FaultKind), texts),
    }
    for kind in errors_in(module):
        given_to = data.draw(arguments.get(kind, st.tuples(texts)))
        error = kind(*given_to)
        there = pickle.loads(pickle.dumps(error))
        assert type(there) is kind
        assert str(there) == str(error)
        assert vars(there) == vars(error)
        # And on, to a third process.
        assert str(pickle.loads(pickle.dumps(there))) == str(error)
