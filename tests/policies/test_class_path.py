"""Policies of other people by name: a class, or what LeRobot trained."""

import sys

import pytest

from lemma.core.errors import InvalidConfigError
from lemma.policies.class_path import class_of, instance_of
from lemma.policies.spec import PolicySpec


def test_a_policy_of_lerobot_is_one_at_control_level() -> None:
    spec = PolicySpec("lerobot:out/act", arguments=(("device", "cuda"),))
    assert spec.controls
    assert not spec.oracle
    with pytest.raises(InvalidConfigError, match="Motor commands allow neither"):
        PolicySpec("lerobot:out/act", gta=True)


def test_one_that_is_told_the_truth_is_an_oracle_by_name() -> None:
    spec = PolicySpec("lerobot-privileged:out/act")
    assert spec.controls
    assert spec.oracle


def test_without_the_lerobot_package_it_is_said_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "lerobot", None)
    with pytest.raises(InvalidConfigError, match=r"'lemma-bench\[lerobot\]'"):
        instance_of("lerobot:out/act")


@pytest.mark.parametrize("name", ["nowhere:Policy", "lemma.core.poses:Policy", ":"])
def test_a_class_that_is_not_there_is_said_to_be_missing(name: str) -> None:
    with pytest.raises(InvalidConfigError, match=r"There is no .*mymodule:MyPolicy"):
        class_of(name)


@pytest.mark.parametrize("name", ["openaiApiKey", "HUB_TOKEN", "password"])
def test_results_hold_no_secret_arguments(name: str) -> None:
    arguments = ((name, "sk-secret"),)
    with pytest.raises(InvalidConfigError, match="environment variable") as caught:
        PolicySpec("my_module:Policy", arguments=arguments)
    assert "sk-secret" not in str(caught.value)
    assert PolicySpec("a:B", arguments=(("max_tokens", 3), ("keyframes", 4)))
