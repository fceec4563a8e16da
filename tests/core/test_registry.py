"""Registries keep names apart, in order, and answer to typing errors."""

import pytest

from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.registry import Registry


@pytest.fixture
def colors() -> Registry[int]:
    registry: Registry[int] = Registry("color")
    for name, value in (("red", 1), ("white", 2), ("blue", 3)):
        registry.add(name, value)
    return registry


def test_add_returns_the_record() -> None:
    record = object()
    registry: Registry[object] = Registry("thing")
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
        Registry[Named]("thing").add("b", Named())


def test_what_is_refused_on_the_way_in_is_not_kept() -> None:
    def refuse(name: str, record: int) -> None:
        raise InvalidConfigError("no")

    registry: Registry[int] = Registry("thing", on_add=refuse)
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
        Registry[int]("thing")["a"]
