"""Acting together as PettingZoo sees it."""

from typing import Any

import pytest
from pettingzoo.test import api_test, parallel_api_test

import lemma
from lemma.core.errors import InvalidActionError
from lemma.expert.expert import Expert
from lemma.tasks.subtask import STOP

OPTIONS: dict[str, Any] = {"split": "test", "index": 0}


@pytest.mark.filterwarnings("ignore:The option 'options' of reset")
def test_pettingzoo_finds_no_fault_in_the_parallel_view() -> None:
    env = lemma.team_parallel_env("carousel", **OPTIONS, horizon_s=2.5)
    parallel_api_test(env, num_cycles=4)


@pytest.mark.filterwarnings("ignore:The option 'options' of reset")
@pytest.mark.filterwarnings("ignore::UserWarning:pettingzoo")
def test_pettingzoo_finds_no_fault_in_the_other_view() -> None:
    env = lemma.team_aec_env("stack2", **OPTIONS, horizon_s=2.5)
    api_test(env, num_cycles=8)


def test_both_views_are_the_central_environment() -> None:
    central = lemma.make("stack2", level="plan", acting="together", **OPTIONS)
    parallel = lemma.team_parallel_env("stack2", **OPTIONS)
    asking = lemma.team_aec_env("stack2", **OPTIONS)
    central.reset()
    parallel.reset()
    asking.reset()
    plan = Expert(central.episode.simulation.scene, central.instance.goal).plan()
    assert plan is not None
    wait = dict.fromkeys(central.order_space.spaces, 0)
    wait["primitive"] = central.action_masks()["robot_0"]["primitive"].size - 1
    firsts = {step.robot: step for step in reversed(plan.subtasks)}
    orders: dict[str, Any] = dict.fromkeys(central.robot_names, wait)
    orders.update(central.encode(*firsts.values()))
    stops = dict.fromkeys(central.robot_names, central.encode(STOP)["robot_0"])
    for given in (orders, stops):
        asked = list(central.team.free)
        central.step({name: given[name] for name in asked})
        parallel.step(given)
        for name in asked:
            assert asking.agent_selection == name
            asking.step(given[name])
    assert central.episode.is_over
    assert parallel.state_hash() == asking.state_hash() == central.state_hash()
    assert parallel.agents == []


def test_a_bad_order_is_refused_and_its_agent_asked_again() -> None:
    env = lemma.team_aec_env("stack2", **OPTIONS)
    env.reset()
    with pytest.raises(InvalidActionError, match="primitive"):
        env.step({"primitive": 99, "pick": 0, "place": 0})
    assert env.agent_selection == "robot_0"


def test_masks_are_computed_once_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    env = lemma.team_parallel_env("stack2", **OPTIONS, horizon_s=2.5)
    inner, asked = env.inner, list[str]()

    def mask(robot: str) -> Any:
        asked.append(robot)
        return inner._busy_mask()

    monkeypatch.setattr(inner, "_mask", mask)
    infos = env.reset()[1]
    assert asked == env.possible_agents
    wait = {name: info["action_mask"] for name, info in infos.items()}
    env.step({name: env.action_space(name).sample(mask=wait[name]) for name in wait})
    assert asked == [*env.possible_agents] * 2
