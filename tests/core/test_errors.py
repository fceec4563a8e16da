"""Every error of this package can be caught as one, and as what it is in Python."""

import inspect

import pytest

from lemma.core import errors
from lemma.core.errors import LemmaError, UnknownNameError

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
