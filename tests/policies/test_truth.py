"""Nobody but oracles gets the truth: no attribute leads from a policy's input to it."""

import weakref
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Any

import pytest
from faulty_policies import given, view
from numba import njit
from reachable import HOPELESS, Confidant, Slotted, Spy, find_secrets, secrets_within

from lemma.core.errors import InvalidConfigError
from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.env.view import View
from lemma.evaluation.run.config import EvaluationConfig
from lemma.evaluation.run.loading import load_policy
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.policies.compose import (
    MultiStep,
    PlannerWithGrounder,
    RetryingPlanner,
)
from lemma.policies.interfaces import (
    Decision,
    OracleInput,
    PastStep,
    Planner,
    Policy,
    PolicyInput,
    is_oracle,
    visible_to,
    wants_cameras,
)
from lemma.policies.oracle import (
    GroundTruthAllocation,
    OracleGrounder,
    OraclePlanner,
)
from lemma.policies.spec import PolicySpec
from lemma.serve.faults import ProtocolError
from lemma.serve.isolation import isolate
from lemma.serve.session import Session
from lemma.tasks.subtask import STOP
from lemma.tasks.suite import load_instance

LONG_S = 60.0
BETWEEN: tuple[Callable[[Spy], Planner], ...] = (
    lambda spy: spy,
    MultiStep,
    RetryingPlanner,
    GroundTruthAllocation,
)
"""Wrappers between a planner and the oracle that grounds its sub-tasks."""


@pytest.fixture(scope="module")
def episode() -> Episode:
    return Episode(load_instance("pass", "val", 0))


def play(policy: Policy, rig: CameraRig | None = None) -> Rollout:
    rollout = Rollout(load_instance("pass", "val", 0), horizon_s=20.0)
    [played] = roll_out([rollout], Player(policy, rig))
    assert played.fault is None, played.fault
    return played


# --- The search finds what can be found --------------------------------------------


def _closure(secret: Any) -> Callable[[], Any]:
    return lambda: secret


def _default(secret: Any) -> Callable[[], Any]:
    def remembers(kept: Any = secret) -> Any:
        return kept

    return remembers


def _wrapper(secret: Any) -> Callable[[], Any]:
    return wraps(secret.info)(lambda: 0)


def _field_of_compiled(secret: Any) -> Any:
    compiled: Any = njit(lambda: 0)
    compiled.kept = secret
    return compiled


HIDINGS: dict[str, Callable[[Any], object]] = {
    "itself": lambda secret: secret,
    "bound method": lambda secret: secret.info,
    "closure": _closure,
    "default": _default,
    "compiled": lambda secret: njit(_closure(secret)),
    "field of compiled": _field_of_compiled,
    "wrapped": _wrapper,
    "partial": lambda secret: partial(print, secret),
    "keyword": lambda secret: partial(print, end=secret),
    "slot": Slotted,
    "items": lambda secret: {"a": [({secret},)]},
    "weak": weakref.ref,
    "iterator": lambda secret: iter(lambda: secret, None),
    "array": lambda secret: secret.simulation.scene.data.qpos[2:3],
    "oracle's input": lambda secret: OracleInput(*parts_of(given()), episode=secret),
    "lazy view": lambda secret: CameraRig().look(secret.simulation.scene),
}


def parts_of(one: PolicyInput) -> tuple[Any, ...]:
    return one.instruction, one.robots, one.view, one.past, one.hands


@pytest.mark.parametrize("hiding", HIDINGS)
def test_the_search_finds_the_truth_wherever_it_is(
    episode: Episode, hiding: str
) -> None:
    assert next(find_secrets([HIDINGS[hiding](episode)]), None)


def test_the_search_finds_nothing_where_there_is_nothing() -> None:
    assert secrets_within(given(), Decision, PolicyInput) == []


# --- Policies of somebody else's ----------------------------------------------------


@pytest.mark.render
def test_no_attribute_leads_to_the_truth_from_what_a_policy_is_given() -> None:
    policy = load_policy(PolicySpec("reachable:Spy", timeout_s=0.0))
    assert isinstance(policy, Spy)
    played = play(policy, CameraRig())
    assert [str(step.result.outcome) for step in played.steps] == ["invalid"]
    first, second = policy.kept
    assert type(first) is type(second) is PolicyInput
    assert [len(one.past) for one in policy.kept] == [0, 1]
    assert second.past[0].view is first.view
    assert type(first.view) is View
    assert set(first.view.cameras) == {"robot_0", "robot_1"}
    assert first.view.rgb.any()
    assert policy.found == []


@pytest.mark.render
def test_camera_images_are_kept_for_who_says_that_it_wants_them() -> None:
    scene = Episode(load_instance("pass", "val", 0)).simulation.scene
    rig = CameraRig(64, 48)
    lazy = rig.look(scene)
    assert not rig.capture(scene).cameras
    kept = rig.capture(scene, cameras=True)
    assert (kept.rgb == lazy.rgb).all()
    for name, image in lazy.cameras.items():
        assert (kept.cameras[name].depth_m == image.depth_m).all()
    assert wants_cameras(PlannerWithGrounder(Spy(), OracleGrounder()))
    assert not wants_cameras(PlannerWithGrounder(OraclePlanner(), OracleGrounder()))


@pytest.mark.slow
def test_nor_in_a_process_of_its_own(episode: Episode) -> None:
    policy: Any = isolate("reachable:Spy", LONG_S)
    once = given("go", PastStep(view(1), HOPELESS, "invalid"))
    informed = OracleInput(*parts_of(once), episode=episode)
    [decision] = policy.act([informed])
    policy.close()
    assert (decision.subtask, decision.explanation) == (STOP, "nothing")


@pytest.mark.slow
@pytest.mark.parametrize("between", BETWEEN)
def test_nor_beside_an_oracle(between: Callable[[Spy], Planner]) -> None:
    spy = Spy()
    policy = PlannerWithGrounder(between(spy), OracleGrounder())
    assert is_oracle(policy)
    play(policy)
    assert len(spy.kept) >= 2
    assert {type(one) for one in spy.kept} == {PolicyInput}
    assert spy.found == []


# --- Oracles say so -----------------------------------------------------------------


@pytest.mark.slow
def test_an_oracle_is_told_all_and_its_result_says_so(tmp_path: Path) -> None:
    spec = PolicySpec("reachable:Confidant", timeout_s=0.0)
    policy = load_policy(spec)
    assert isinstance(policy, Confidant)
    played = play(policy)
    assert isinstance(policy.kept[0], OracleInput)
    assert policy.kept[0].episode is played.episode
    assert policy.found
    about = EvaluationConfig(out=tmp_path, policy=spec, episodes=1).about()
    assert about["oracle"] is True


@pytest.mark.parametrize(
    ("spec", "oracle"),
    [
        (PolicySpec("oracle"), True),
        (PolicySpec("episodic-transformer+oracle"), True),
        (PolicySpec("oracle+http://127.0.0.1:1"), True),
        (PolicySpec("reachnet", gta=True), True),
        (PolicySpec("reachable:Confidant", timeout_s=0.0), True),
        (PolicySpec("reachnet"), False),
        (PolicySpec("episodic-transformer+cliport"), False),
        (PolicySpec("http://127.0.0.1:1"), False),
        (PolicySpec("reachable:Spy", timeout_s=0.0), False),
        (PolicySpec("reachable:Confidant"), False),
    ],
)
def test_a_policy_with_an_oracle_in_it_is_one(spec: PolicySpec, oracle: bool) -> None:
    assert spec.oracle is oracle


def test_who_does_not_say_so_by_its_class_is_refused() -> None:
    with pytest.raises(InvalidConfigError, match="derived from"):
        load_policy(PolicySpec("reachable:disguised", timeout_s=0.0))


@pytest.mark.slow
def test_the_truth_does_not_travel() -> None:
    with pytest.raises(InvalidConfigError, match="no other process"):
        load_policy(PolicySpec("reachable:Confidant"))
    with pytest.raises(ProtocolError, match="no other process"):
        Session(Confidant())


def test_parts_are_told_what_they_may_know(episode: Episode) -> None:
    informed = OracleInput(*parts_of(given()), episode=episode)
    assert visible_to(OraclePlanner(), [informed]) == [informed]
    [plain] = visible_to(Spy(), [informed])
    assert type(plain) is PolicyInput
    assert plain.view is informed.view
    assert visible_to(Spy(), [plain]) == [plain]
