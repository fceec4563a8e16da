"""An object that falls off the table is lost: all layers say so, and nothing hangs."""

import math

import pytest
from small_tables import cube, facing, move, pad, stick

from lemma.core.poses import Pose, Pose2
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.expert.expert import Expert
from lemma.motion.outcome import Outcome, SkillResult
from lemma.planning.grounding import GeometricGrounder, ground_or_refuse
from lemma.planning.planner import find_plan
from lemma.planning.symbolic_state import SymbolicState
from lemma.scene.spec import RobotPlacement, SceneSpec
from lemma.scene.table import FLOOR_Z_M, TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import Primitive, SubTask

EDGE_M = -TABLE_HALF_Y_M
START, PAD = Pose2(0.35, EDGE_M + 0.45), Pose2(-0.35, EDGE_M + 0.45)
BESIDE = Pose2(0.35, EDGE_M - 0.15)
INSTANCE = Instance(
    task="pass",
    split="free",
    index=0,
    scene=SceneSpec(
        (
            RobotPlacement("ur5", "red", Pose2(0.0, EDGE_M + 0.3, math.pi / 2)),
            RobotPlacement("ur5", "white", Pose2(0.0, 0.9, -math.pi / 2)),
        ),
        (cube("red", *START.xy), cube("blue", 0.0, 0.1), pad("white", *PAD.xy)),
    ),
    goal=Goal.from_pairs((("red_cube", "white_pad"),)),
    instructions=dict.fromkeys(("high_level", "human", "unseen"), "Put it away."),
    distractors=("blue_cube",),
)


def put_on_floor(simulation: Simulation, name: str) -> None:
    scene = simulation.scene
    scene.set_pose(name, Pose((TABLE_HALF_X_M + 0.8, EDGE_M, FLOOR_Z_M + 0.03)))
    simulation.rest(0.3)
    assert scene.fallen == (name,)


def test_on_the_table_nothing_has_fallen() -> None:
    episode = Episode(INSTANCE)
    assert not episode.fallen
    assert episode.info()["fallen"] == []


def test_who_puts_something_beside_the_table_has_thrown_it() -> None:
    episode = Episode(INSTANCE)
    result = episode.execute(move(START, BESIDE))
    assert result.outcome is Outcome.THROWN
    assert "red_cube" in result.explanation
    assert episode.thrown == ("red_cube",)
    assert episode.is_over
    assert not episode.is_success
    assert episode.fallen == ("red_cube",)
    assert episode.failure == "thrown"


def test_a_skill_that_aims_at_it_is_told_that_it_is_lost() -> None:
    episode = Episode(INSTANCE)
    scene = episode.simulation.scene
    scene.set_pose("red_cube", Pose((*BESIDE.xy, -0.5)))
    assert episode.fallen == ("red_cube",)
    result = episode.execute(move(BESIDE, PAD))
    assert (result.outcome, result.ok) == (Outcome.FALLEN, False)
    assert "red_cube has fallen off the table" in result.explanation


def test_a_goal_whose_object_is_lost_has_no_plan_and_no_success() -> None:
    episode = Episode(INSTANCE)
    scene = episode.simulation.scene
    assert find_plan_of(episode) is not None
    put_on_floor(episode.simulation, "red_cube")
    assert find_plan_of(episode) is None
    subtask, grounded = Expert(scene, INSTANCE.goal).act()
    assert (subtask.primitive, grounded) == (Primitive.STOP, None)
    episode.stop()
    assert not episode.is_success
    assert episode.info()["fallen"] == ["red_cube"]


def find_plan_of(episode: Episode) -> object:
    now = SymbolicState.observe(episode.simulation.scene)
    return find_plan(now, INSTANCE.goal, GeometricGrounder(INSTANCE.scene))


def test_an_expert_notices_what_fell_while_it_was_at_work() -> None:
    episode = Episode(INSTANCE)
    expert = Expert(episode.simulation.scene, INSTANCE.goal)
    assert expert.act()[1] is not None
    put_on_floor(episode.simulation, "red_cube")
    assert expert.act() == (SubTask("", Primitive.STOP, "", ""), None)


def test_a_lost_distractor_harms_nobody() -> None:
    episode = Episode(INSTANCE)
    put_on_floor(episode.simulation, "blue_cube")
    plan = find_plan_of(episode)
    assert plan is not None
    assert episode.execute(move(START, PAD)).ok
    episode.stop()
    assert episode.is_success
    assert episode.fallen == ("blue_cube",)


@pytest.mark.parametrize(
    "subtask",
    [
        SubTask("robot_0", Primitive.MOVE, "red_cube", "white_pad"),
        SubTask("robot_0", Primitive.MOVE, "blue_cube", "red_cube"),
        SubTask("robot_0", Primitive.PREHOOK, "stick", "red_cube"),
    ],
)
def test_plan_level_refuses_what_needs_it(subtask: SubTask) -> None:
    spec = facing(
        "ur5",
        cube("red", 0.0, 0.2),
        cube("blue", 0.0, -0.2),
        pad("white", 0.0, 0.4),
        stick(Pose2(-0.3, -0.4)),
    )
    simulation = Simulation(spec)
    put_on_floor(simulation, "red_cube")
    now = SymbolicState.observe(simulation.scene)
    grounder = GeometricGrounder(spec)
    assert grounder.ground(subtask, now) is None
    result = ground_or_refuse(subtask, now, grounder)
    assert isinstance(result, SkillResult)
    assert result.outcome is Outcome.FALLEN
    assert result.duration_s == 0.0


def test_a_stick_that_hangs_over_the_edge_lies_there_still() -> None:
    """Its middle counts, not the end where its frame is."""
    spec = facing("ur5", stick(Pose2(0.0, 0.5)), cube("red", 0.0, 0.2))
    simulation = Simulation(spec)
    scene = simulation.scene
    tilt = math.radians(-20.0) / 2
    scene.set_pose(
        "stick", Pose((0.0, 0.5, -0.05), (math.cos(tilt), 0.0, math.sin(tilt), 0.0))
    )
    assert not scene.fallen
    scene.set_pose(
        "stick", Pose((0.0, 0.5, -0.2), (math.cos(tilt), 0.0, math.sin(tilt), 0.0))
    )
    assert scene.fallen == ("stick",)
