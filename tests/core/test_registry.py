"""Registries keep names apart, in order, and answer to typing errors."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import lemma
import lemma.audit.run
from lemma.audit.attack import ATTACKS, attack
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.registry import Registry, fits
from lemma.tasks.library import task
from lemma.tasks.suite import TASKS


@pytest.fixture
def colors() -> Registry[int]:
    registry: Registry[int] = Registry("color", int)
    for name, value in (("red", 1), ("white", 2), ("blue", 3)):
        registry.add(name, value)
    return registry


def test_add_returns_the_record() -> None:
    record = object()
    registry: Registry[object] = Registry("thing", object)
    assert registry.add("a", record) is record
    assert registry["a"] is record


def test_names_come_in_the_order_of_registration(colors: Registry[int]) -> None:
    assert list(colors) == ["red", "white", "blue"]
    assert len(colors) == 3
    assert "red" in colors
    assert "green" not in colors


def add_from(module: str, colors: Registry[int], name: str, value: int) -> None:
    """Add a record as a module of another name would."""
    exec(
        "colors.add(name, value)",
        {"__name__": module, "colors": colors, "name": name, "value": value},
    )


def test_a_name_of_another_module_is_not_taken(colors: Registry[int]) -> None:
    with pytest.raises(InvalidConfigError, match=f"'red' is already .*{__name__}"):
        add_from("somebody", colors, "red", 4)
    assert colors["red"] == 1


@pytest.mark.parametrize(
    ("registry", "shipped", "source"),
    [
        (ATTACKS, "greedy_skills", "attack('skill')(greedy_skills)"),
        (
            TASKS,
            "relay",
            "task('relay', 'Mine.', subtasks=1, distractors=(0, 0))(relay)",
        ),
    ],
)
def test_a_decorator_takes_no_name_of_another_module(
    registry: Registry[Any], shipped: str, source: str
) -> None:
    before = registry[shipped]

    def mine(placer: object) -> None:
        """Do nothing."""

    mine.__name__ = shipped
    names = {"attack": attack, "task": task, shipped: mine, "__name__": "somebody"}
    with pytest.raises(InvalidConfigError, match=f"'{shipped}' is already .* lemma"):
        exec(source, names)
    assert registry[shipped] is before


def test_a_module_replaces_its_own_with_a_warning(colors: Registry[int]) -> None:
    with pytest.warns(UserWarning, match="color 'red' is replaced"):
        colors.add("red", 4)
    assert colors["red"] == 4
    assert list(colors) == ["red", "white", "blue"]


def test_replacing_on_purpose_is_quiet(colors: Registry[int]) -> None:
    colors.add("red", 4, replace=True)
    assert colors["red"] == 4


def test_a_record_has_one_name() -> None:
    class Named:
        name = "a"

    with pytest.raises(InvalidConfigError, match="'a' cannot be added as 'b'"):
        Registry[Named]("thing", Named).add("b", Named())


def test_what_is_refused_on_the_way_in_is_not_kept() -> None:
    def refuse(name: str, record: int) -> None:
        raise InvalidConfigError("no")

    registry: Registry[int] = Registry("thing", int, on_add=refuse)
    with pytest.raises(InvalidConfigError, match="no"):
        registry.add("a", 1)
    assert "a" not in registry


@pytest.mark.parametrize(
    ("wrong", "meant"), [("blu", "blue"), ("wihte", "white"), ("rde", "red")]
)
def test_a_typing_error_is_understood(
    colors: Registry[int], wrong: str, meant: str
) -> None:
    with pytest.raises(UnknownNameError) as caught:
        colors[wrong]
    message = str(caught.value)
    assert f"Unknown color {wrong!r}." in message
    assert f"Did you mean {meant!r}?" in message
    assert "Valid: red, white, blue." in message


def test_nothing_is_guessed_where_nothing_is_near(colors: Registry[int]) -> None:
    with pytest.raises(UnknownNameError) as caught:
        colors["quartz"]
    assert "Did you mean" not in str(caught.value)
    assert "Valid: red, white, blue." in str(caught.value)


@pytest.mark.parametrize("name", [3, None, ["red"], ("red",)])
def test_what_is_no_name_is_refused_like_one(
    colors: Registry[int], name: object
) -> None:
    with pytest.raises(UnknownNameError, match="Valid: red, white, blue"):
        colors[name]  # type: ignore[index]


def test_an_empty_registry_says_so() -> None:
    with pytest.raises(UnknownNameError, match=r"Valid: \(none\)"):
        Registry[int]("thing", int)["a"]


def all_registries() -> list[tuple[str, Registry[Any]]]:
    """Return every registry of the package that a module has a name for."""
    root = Path(lemma.__file__).parent
    found = []
    for path in sorted(root.rglob("*.py")):
        for name in re.findall(r"^([A-Z_]+): Registry\[", path.read_text(), re.M):
            module = ".".join(path.relative_to(root.parent).with_suffix("").parts)
            found.append((name, getattr(import_module(module), name)))
    return found


REGISTRIES = all_registries()


@pytest.mark.parametrize(
    "registry", [one for _, one in REGISTRIES], ids=[name for name, _ in REGISTRIES]
)
class TestEveryRegistry:
    """One contract: a record is checked when it is added, or it is not kept."""

    def test_a_record_of_another_type_is_refused(self, registry: Registry[Any]) -> None:
        others: list[Any] = ["panda.xml", 3, {}, object(), [], lambda *, key: None]
        for record in others:
            with pytest.raises(
                InvalidConfigError, match="cannot be registered"
            ) as caught:
                registry.add("panda", record)
            assert "\n" not in str(caught.value), record
            assert "panda" not in registry, record

    def test_what_no_command_line_could_name_is_refused(
        self, registry: Registry[Any]
    ) -> None:
        first = next(iter(registry), None)
        if first is None:
            return
        record = registry[first]
        names: list[Any] = ["", "a b", "a,b", "a+b", "llm:a", "/a", 3, None]
        for name in names:
            with pytest.raises(InvalidConfigError, match="name of a"):
                registry.add(name, record)
            assert name not in registry

    def test_what_is_registered_would_be_again(self, registry: Registry[Any]) -> None:
        for name in registry:
            registry._check(name, registry[name])


def test_all_registries_are_found() -> None:
    names = {name for name, _ in REGISTRIES}
    assert names >= {"ARMS", "OBJECT_KINDS", "TASKS", "PRIMITIVES", "MODELS", "ATTACKS"}
    assert len(REGISTRIES) >= 14


def test_fields_of_a_record_have_their_types() -> None:
    @dataclass
    class Thing:
        size: tuple[float, ...]
        make: Callable[[int, int], object]

    things: Registry[Thing] = Registry("thing", Thing)
    things.add("a", Thing((1.0, 2), lambda x, y: None))
    with pytest.raises(InvalidConfigError, match=r"'b'.*: size is 'large'.*float"):
        things.add("b", Thing("large", lambda x, y: None))  # type: ignore[arg-type]
    with pytest.raises(InvalidConfigError, match=r"make is .* 2 arguments"):
        things.add("b", Thing((), lambda x: None))  # type: ignore[arg-type,misc]


@pytest.mark.parametrize(
    ("value", "hint", "expected"),
    [
        (None, float | None, True),
        (np.float32(1.0), float, True),
        (True, int, False),
        (True, bool, True),
        (1, float, True),
        (1.0, int, False),
        ([1.0, 2.0], tuple[float, float], True),
        ((1.0,), tuple[float, float], False),
        ((), tuple[float, ...], True),
        ("b", Literal["a", "b"], True),
        ("c", Literal["a", "b"], False),
        (bool, type[int], True),
        (str, type[int], False),
        (7, type[Any], False),
        ({}, Mapping[str, int], True),
        (print, Callable[[int], None], True),
        (len, Callable[[], int], False),
        (len, Callable[..., int], True),
        (3, Any, True),
        (3, "NotImportedHere", True),
    ],
)
def test_a_value_fits_a_type(value: object, hint: Any, expected: bool) -> None:
    assert fits(value, hint) is expected
