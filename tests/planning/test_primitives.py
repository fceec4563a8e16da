"""Primitives: the paper's six, two of the ladder, two of teams, and one's push."""

import pickle
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from gymnasium.spaces import Discrete
from own_plugins import EXAMPLES, loaded

import lemma
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.poses import Pose2
from lemma.dataset.recipe.record import record_episode
from lemma.dataset.recipe.replay import replay
from lemma.env.action_spaces import plan_space, skill_space
from lemma.env.skill_env import SkillEnv
from lemma.expert.plan_env import PlanEnv
from lemma.motion.skills import SKILLS
from lemma.planning.primitives import PRIMITIVES, PrimitiveSpec
from lemma.tasks.language.bank import phrase, sub_instruction
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask, primitive_names

SIX = ("move", "prehook", "hook", "prepoke", "poke", "stop")
SHIPPED = (*SIX, "reach", "lift", "carry", "give")
PUSHED = 39
"""Number of an instance in which pushing is the best that the first robot can do."""
PUSH = EXAMPLES / "12_write_a_primitive.py"


def test_the_six_come_first_in_their_order() -> None:
    assert tuple(PRIMITIVES) == tuple(Primitive) == primitive_names() == SHIPPED
    assert tuple(SKILLS) == (*SIX[:-1], "reach", "lift", "carry", "give")
    for space in (skill_space(2), plan_space(2)):
        assert space["primitive"] == Discrete(10)


@pytest.mark.parametrize("name", SHIPPED)
def test_records_say_them_as_the_templates_do(name: str) -> None:
    pick = "stick" if PRIMITIVES[name].tool else "red_cube"
    said = sub_instruction("red robot", name, pick, "blue_cube")
    filled = PRIMITIVES[name].phrase.format(
        robot="red robot", pick=phrase(pick), place=phrase("blue_cube")
    )
    assert said == filled


def test_an_unknown_primitive_is_refused_where_it_is_named() -> None:
    for make in (
        lambda: Primitive("prehok"),
        lambda: SubTask("robot_0", "prehok", "stick", "red_cube"),  # type: ignore[arg-type]
        lambda: GroundedSubTask("robot_0", "prehok", Pose2(0, 0), Pose2(0, 0)),  # type: ignore[arg-type]
    ):
        with pytest.raises(UnknownNameError, match="Did you mean 'prehook'"):
            make()
    subtask = SubTask("robot_0", "hook", "stick", "red_cube")  # type: ignore[arg-type]
    assert subtask.primitive is Primitive.HOOK


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"skill": None}, "has no skill"),
        ({"name": "Push It"}, "name of a primitive cannot be"),
        ({"phrase": "{robot}: push {what}"}, r"Its slots are \{robot\}"),
    ],
)
def test_a_record_that_is_none_is_refused(wrong: dict[str, Any], message: str) -> None:
    spec = PrimitiveSpec(name="push", phrase="", skill=SKILLS["move"])
    wanted = replace(spec, **wrong)
    with loaded():
        with pytest.raises(InvalidConfigError, match=message):
            PRIMITIVES.add(wanted.name, wanted)
        assert primitive_names() == SHIPPED


@pytest.fixture
def push() -> Iterator[Primitive]:
    with loaded(PUSH):
        yield Primitive("push")
    with pytest.raises(UnknownNameError, match="'push'"):
        Primitive("push")


def test_a_primitive_of_ones_own_is_numbered_last(
    push: Primitive,
) -> None:
    assert primitive_names() == (*SHIPPED, "push")
    assert tuple(Primitive) == SHIPPED
    assert skill_space(2)["primitive"] == Discrete(11)
    env = lemma.make("pass", level="skill", split="test", index=PUSHED)
    grounded = GroundedSubTask("robot_1", push, Pose2(0, 0, 1), Pose2(0.1, 0, 1))
    action = env.encode(grounded)
    assert action["primitive"] == 10
    assert env.decode(action) == grounded
    assert env.encode(None)["primitive"] == 5


def test_it_is_one_object_wherever_it_goes(push: Primitive) -> None:
    subtask = SubTask("robot_0", push, "red_cube", "shared")
    assert Primitive("push") is push
    assert pickle.loads(pickle.dumps(subtask)).primitive is push
    assert SubTask.from_dict(subtask.to_dict()) == subtask
    assert str(subtask) == "robot_0 push red_cube -> shared"
    assert f"{push}" == push == "push"


def test_the_expert_plans_it_and_replay_reproduces_it(push: Primitive) -> None:
    record = record_episode(lemma.load_instance("pass", "test", PUSHED))
    assert record.success
    assert [row.primitive for row in record.subtasks] == ["push", "move"]
    assert record.subtasks[0].instruction.endswith(" to the shared space")
    assert replay(record).is_exact


def test_it_is_done_at_plan_and_skill_level(push: Primitive) -> None:
    skill: SkillEnv = lemma.make("pass", level="skill", split="test", index=PUSHED)
    plan: PlanEnv = lemma.make("pass", level="plan", split="test", index=PUSHED)
    expert = lemma.ExpertPolicy(skill)
    skill.reset()
    plan.reset()
    action = expert.act()
    grounded = skill.decode(action)
    assert grounded is not None
    assert grounded.primitive is push
    assert skill.step(action)[4]["outcome"] == "success"
    cube = plan.instance.goal.conjuncts[0].top
    plan.step(plan.encode(SubTask(grounded.robot, push, cube, "shared")))
    assert plan.state_hash() == skill.state_hash()


def test_what_cannot_be_pushed_is_told_at_plan_level(push: Primitive) -> None:
    env = lemma.make("pass", level="plan", split="test", index=PUSHED)
    env.reset()
    cube, pad = env.instance.goal.pairs[0]
    for place, outcome, why in (
        (pad, "invalid", "is pushed to the shared space"),
        ("shared", "unreachable", "cannot reach"),
    ):
        far = "robot_0"
        *_, info = env.step(env.encode(SubTask(far, push, cube, place)))
        assert info["outcome"] == outcome
        assert why in info["explanation"]


def test_without_grounding_it_is_for_skill_level_alone() -> None:
    with loaded():
        spec = PrimitiveSpec(name="wave", phrase="{robot}: wave", skill=SKILLS["move"])
        PRIMITIVES.add("wave", spec)
        env = lemma.make("pass", level="plan", split="test", index=PUSHED)
        env.reset()
        cube, pad = env.instance.goal.pairs[0]
        wave = SubTask("robot_0", Primitive("wave"), cube, pad)
        assert env.step(env.encode(wave))[4]["outcome"] == "unreachable"
