"""Numbers and names from outside are checked, whatever their type."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from lemma.core.arguments import known, real, whole
from lemma.core.errors import InvalidConfigError, UnknownNameError


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3), np.array(3)])
def test_whole_numbers_of_any_type_become_integers(value: Any) -> None:
    number = whole("index", value, 0, 5)
    assert (number, type(number)) == (3, int)


@pytest.mark.parametrize(
    "value",
    [True, np.True_, 3.0, "3", None, [3], np.array([3, 4]), -1, 6, 10**400, math.nan],
    ids=repr,
)
def test_what_is_no_whole_number_is_named(value: Any) -> None:
    with pytest.raises(InvalidConfigError, match=r"index=.* from 0 to 5\.$"):
        whole("index", value, 0, 5)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int8(2), Fraction(2)])
def test_numbers_of_any_type_become_floats(value: Any) -> None:
    number = real("horizon_s", value, 1.0)
    assert (number, type(number)) == (2.0, float)


@pytest.mark.parametrize(
    "value",
    [True, "2", None, 1j, [2.0], math.nan, math.inf, -math.inf, 10**400, 0.5],
    ids=lambda value: repr(value)[:20],
)
def test_what_is_no_finite_number_is_named(value: Any) -> None:
    with pytest.raises(InvalidConfigError, match=r"horizon_s=.* at least 1"):
        real("horizon_s", value, 1.0)


@pytest.mark.parametrize(
    "name", ["tset", None, ["test"], np.array(["test", "val"]), {}, 1.5], ids=repr
)
def test_unknown_names_of_any_type_are_named(name: Any) -> None:
    with pytest.raises(UnknownNameError, match=r"Unknown split.*Valid: val, test"):
        known("split", name, ("val", "test"))
    assert known("split", "test", ("val", "test")) == "test"
