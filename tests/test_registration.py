"""Public names, and how Gymnasium comes to know the tasks."""

import gymnasium
import pytest
from interpreter import told_without

import lemma
from lemma.registration import LEVELS
from lemma.tasks.names import SUITE, gym_id


def test_what_is_wrong_with_a_module_is_not_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(name: str) -> None:
        raise AttributeError("'NoneType' object has no attribute 'glGetError'")

    monkeypatch.setattr(lemma, "import_module", fail)
    monkeypatch.delitem(vars(lemma), "SUITE", raising=False)
    with pytest.raises(ImportError, match="glGetError"):
        exec("from lemma import SUITE")


def test_names_are_those_of_the_tasks() -> None:
    assert list(lemma.TASKS)[: len(SUITE)] == list(lemma.SUITE) == list(SUITE)
    assert [lemma.TASKS[name].gym_id for name in SUITE] == [
        *("lemma/Pass-v0", "lemma/Pass2-v0", "lemma/Stack-v0", "lemma/Stack2-v0"),
        *("lemma/Poke-v0", "lemma/PokeStack-v0", "lemma/Hook-v0", "lemma/HookStack-v0"),
    ]


def test_import_registers() -> None:
    for task in SUITE:
        assert gymnasium.spec(gym_id(task)).entry_point == "lemma.registration:make"


@pytest.mark.slow
@pytest.mark.parametrize(
    "code",
    [
        "import lemma, gymnasium; gymnasium.make('lemma/Hook-v0')",
        pytest.param(
            "import gymnasium, lemma; gymnasium.make('lemma/Hook-v0')",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "import gymnasium; gymnasium.make('lemma:lemma/Hook-v0')",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_any_order_of_imports_will_do(code: str) -> None:
    told_without((), code)


@pytest.mark.parametrize("level", list(LEVELS))
def test_make_takes_names_and_ids(level: str) -> None:
    by_name = lemma.make("poke_stack", level=level)
    by_id = lemma.make("lemma/PokeStack-v0", level=level)
    assert type(by_name) is type(by_id)
    assert by_name.config == by_id.config
    assert by_name.config.split == "train"


def test_public_names_are_listed_and_resolve() -> None:
    assert set(lemma.__all__) <= set(dir(lemma))
    for name in lemma.__all__:
        assert getattr(lemma, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Robot'"):
        lemma.Robot  # noqa: B018
