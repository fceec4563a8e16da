"""Control level: actions, chunks, memory; what is wrong with them; what lines say."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import run
from control_policies import CALLS, SMALL, Stays
from made_up import timeless
from reachable import secrets_within

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.evaluation.analysis.failure_causes import Cause, cause_of
from lemma.evaluation.evaluation import Evaluation
from lemma.evaluation.lines import read_rows
from lemma.evaluation.records import EPISODES, Row
from lemma.evaluation.run.control import ControlPlayer, ControlRollout
from lemma.policies.control.interfaces import Actions
from lemma.policies.control.oracle import ExpertControl
from lemma.policies.interfaces import Oracle
from lemma.policies.spec import PolicySpec
from lemma.tasks.suite import load_instance

ONE: dict[str, Any] = {"tasks": ["pass"], "episodes": 1, "split": "val"}


def evaluate(policy: object, **others: Any) -> Evaluation:
    return lemma.evaluate(policy, level="control", **(ONE | others))


def with_options(**options: Any) -> Stays:
    policy = Stays()
    # An instance may know better than its class.
    vars(policy)["control_options"] = SMALL | options
    return policy


# --- Episodes ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("task", ["pass", "hook"])
def test_the_expert_solves_tasks_by_joint_positions(task: str) -> None:
    done = evaluate("oracle", tasks=[task])
    (row,) = done.rows
    assert row["success"]
    assert row["lenient"]["success"]
    assert row["failure"] is None
    told = row["control"]
    assert (told["mode"], told["hz"]) == ("joint_position", 20.0)
    assert told["actions"] == round(20.0 * row["elapsed_s"])
    moved = {top for top, _ in load_instance(task, "val", 0).goal.pairs}
    assert set(told["touched"]) == moved
    assert moved <= {each["object"] for each in told["events"]}
    assert row["coordination"]["clearance_mm"] > 0.0
    assert done.result.about["oracle"]


def test_chunks_are_carried_out_before_the_policy_is_asked_again() -> None:
    policy = Stays(chunk=7)
    (row,) = evaluate(policy).rows
    assert [given.step for given in policy.seen] == [0, 7, 14, 21]
    assert [given.memory for given in policy.seen] == [None, 1, 2, 3]
    assert [round(given.time_s, 6) for given in policy.seen] == [0.0, 0.7, 1.4, 2.1]
    assert row["policy_error"]["explanation"].startswith("RuntimeError: 4 calls")
    assert row["control"]["actions"] == 7 * CALLS


def test_who_says_in_which_environment_it_acts_controls() -> None:
    (row,) = lemma.evaluate(Stays(), **ONE).rows
    assert row["control"]["actions"] == 5 * CALLS
    assert timeless([row]) == timeless(evaluate(Stays()).rows)


def test_each_episode_has_a_memory_of_its_own() -> None:
    policy = Stays()
    rows = evaluate(policy, tasks=["pass", "stack"], episodes=2).rows
    assert [row["control"]["asked"] for row in rows] == [CALLS] * 4
    assert {row["control"]["actions"] for row in rows} == {5 * CALLS}


@pytest.mark.render
def test_it_sees_what_the_environment_shows() -> None:
    options: dict[str, Any] = {"observation": "rgbd", "width": 64, "height": 48}
    options["cameras"] = ("overview", "robot_1_wrist")
    policy = with_options(**options)
    evaluate(policy)
    env = ControlEnv(EnvConfig(task="pass", split="val", index=0, **SMALL | options))
    observation, _ = env.reset()
    given = policy.seen[0]
    assert env.observation_space.contains(given.observation)
    for name in ("agent_pos", "agent_vel", "tcp_pose", "instruction"):
        assert np.array_equal(given.observation[name], observation[name])
    for name in ("pixels", "depth"):
        assert set(given.observation[name]) == set(options["cameras"])
        for camera in options["cameras"]:
            shown = given.observation[name][camera]
            assert np.array_equal(shown, observation[name][camera])
    assert given.cameras == env.cameras()


@pytest.mark.render
def test_nothing_leads_from_there_to_the_truth() -> None:
    policy = with_options(observation="rgb", width=64, height=48)
    evaluate(policy)
    assert len(policy.seen) == CALLS + 1
    assert secrets_within(policy.seen) == []


@pytest.mark.slow
def test_a_class_in_another_process_gives_the_same(tmp_path: Path) -> None:
    spec: dict[str, Any] = {"chunk": 6, "says": "and it knows why"}
    here = evaluate(Stays(**spec)).rows
    words = ("--policy-args", "chunk=6,says=and it knows why", "--level", "control")
    out = tmp_path / "there"
    assert command_line("control_policies:Stays", out, *words) == 0
    assert timeless(read_rows(out)) == timeless(here)
    # The same command goes on: there is nothing left to play.
    lines = (out / EPISODES).read_bytes()
    assert command_line("control_policies:Stays", out, *words) == 0
    assert (out / EPISODES).read_bytes() == lines


def command_line(policy: str, out: Path, *words: str) -> object:
    few = ("--tasks", "pass", "--split", "val", "--episodes", "1")
    return run("evaluate", "--policy", policy, "--out", out, *few, *words)


# --- Faults ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("says", "kind", "told"),
    [
        ("nan", "not_finite", "NaN"),
        ("shape", "malformed", r"shape (5, 1, 7). Valid: (2, 7), or (steps, 2, 7)"),
        ("bounds", "malformed", "clip_actions=True"),
        ("text", "malformed", "no array of numbers"),
        ("none", "malformed", "no array of numbers"),
        ("empty", "malformed", "shape (0, 2, 7)"),
    ],
)
def test_bad_actions_cost_their_episode_and_say_why(
    says: str, kind: str, told: str
) -> None:
    (row,) = evaluate(Stays(says=says)).rows
    assert not row["success"]
    assert row["policy_error"]["kind"] == kind
    assert told in row["policy_error"]["explanation"]
    assert cause_of(row) is Cause.POLICY_ERROR


def test_unstable_physics_are_judged_by_the_state_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    advance = ControlEnv.advance

    def diverging(self: ControlEnv, action: Any) -> tuple[float, bool, bool]:
        data = self.episode.simulation.scene.data
        if data.time > 1.0:
            data.qvel[:] = np.nan
        return advance(self, action)

    monkeypatch.setattr(ControlEnv, "advance", diverging)
    (row,) = evaluate(Stays()).rows
    assert (row["success"], row["failure"]) == (False, "policy_error")
    assert row["policy_error"]["kind"] == "unstable"
    # MuJoCo puts what diverges back to the beginning, its time too.
    assert 0.5 < row["elapsed_s"] < 2.5


@pytest.mark.parametrize(
    ("options", "error", "told"),
    [
        ({"hertz": 10}, UnknownNameError, "control_hz"),
        ({"split": "train"}, UnknownNameError, "control_hz"),
        ({"control": "thoughts"}, UnknownNameError, "joint_position"),
        ({"control_hz": 7.0}, InvalidConfigError, "Try 10, 20"),
        ({"cameras": ("roof",)}, UnknownNameError, "overview"),
        ({"observation": "privileged"}, InvalidConfigError, "privileged state"),
    ],
)
def test_an_environment_that_cannot_be_is_refused(
    options: dict[str, Any], error: type[Exception], told: str
) -> None:
    with pytest.raises(error, match=told):
        evaluate(with_options(**options))


class Knows(Stays, Oracle):
    """Is given the truth, and says so."""

    control_options = SMALL | {"observation": "privileged"}


def test_an_oracle_may_see_the_truth_and_its_result_says_so() -> None:
    policy = Knows()
    done = evaluate(policy)
    assert policy.seen[0].observation["goal"].any()
    assert done.result.about["oracle"]


def test_the_expert_refuses_to_play_without_the_truth() -> None:
    policy = Stays()
    evaluate(policy)
    with pytest.raises(InvalidConfigError, match="OracleControlInput"):
        ExpertControl().act(policy.seen[:1])


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ({"level": "skill"}, "level of a policy"),
        ({"level": "control", "gta": True}, "ground-truth"),
        ({"level": "control", "planning": "multi-step"}, "multi-step"),
        ({"arguments": (("a", 1),)}, "takes no arguments"),
    ],
)
def test_what_does_not_go_together_is_refused(spec: dict[str, Any], told: str) -> None:
    with pytest.raises((InvalidConfigError, UnknownNameError), match=told):
        PolicySpec("oracle", **spec)


@pytest.mark.parametrize("args", ["chunk", "=3", "a b=3"])
def test_arguments_without_an_equals_sign_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], args: str
) -> None:
    out = tmp_path / "none"
    assert command_line("control_policies:Stays", out, "--policy-args", args) == 2
    assert "NAME=VALUE" in capsys.readouterr().err


# --- Why it failed -----------------------------------------------------------------


def told(**changed: Any) -> Row:
    plain: dict[str, Any] = {"touched": [], "fallen": [], "events": []}
    return {
        "success": False,
        "failure": "out_of_time",
        "control": plain | changed,
    }


def grasped(name: str) -> dict[str, Any]:
    return {"time_s": 1.0, "robot": "robot_0", "event": "grasped", "object": name}


@pytest.mark.parametrize(
    ("row", "cause"),
    [
        (told(), Cause.UNTOUCHED),
        (told(events=[grasped("stick")]), Cause.UNTOUCHED),
        (told(touched=["red_cube"]), Cause.UNGRASPED),
        (told(touched=["red_cube"], events=[grasped("stick")]), Cause.UNGRASPED),
        (told(touched=["red_cube"], events=[grasped("red_cube")]), Cause.MISPLACED),
        (told(touched=["red_cube"], fallen=["red_cube"]), Cause.FELL),
    ],
)
def test_contacts_and_grasps_tell_why(row: Row, cause: Cause) -> None:
    assert cause_of(row) is cause


def test_who_lets_go_too_early_has_misplaced() -> None:
    class Drops(ExpertControl):
        def act(self, inputs: Any) -> list[Actions]:
            found = super().act(inputs)
            if inputs[0].step:
                raise RuntimeError("enough")
            return [Actions(np.asarray(f.rows)[:60], f.memory) for f in found]

    player = ControlPlayer(Drops())
    rollout = player.begin(load_instance("pass", "val", 0), "high_level")
    assert isinstance(rollout, ControlRollout)
    rollout.take(None, Drops().act([player.policy_input(rollout)])[0])
    seen = rollout.fields(rollout.verdict())["control"]
    assert [each["event"] for each in seen["events"]] == ["grasped"]
    assert rollout.actions == 60


def test_who_controls_is_not_played_at_another_level() -> None:
    with pytest.raises(InvalidConfigError, match="--level control"):
        lemma.evaluate(Stays(), level="skill", **ONE)
    for timeout_s in (0.0, 10.0):
        spec = PolicySpec("control_policies:Stays", timeout_s=timeout_s)
        with pytest.raises(InvalidConfigError, match="--level control"):
            spec.load()


def test_options_must_be_a_dictionary() -> None:
    policy = Stays()
    vars(policy)["control_options"] = ["joint_position"]
    with pytest.raises(InvalidConfigError, match="a dictionary, such as"):
        evaluate(policy)
