"""Hands of different force: who cannot carry a thing does not, whatever it tries."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from recorded_episodes import played
from tiers import slow_but

import lemma
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose2, quaternion_from_matrix
from lemma.dataset.recipe.replay import replay
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.motion.moves import Motion, Moves, Stand
from lemma.motion.outcome import REFUSED, Outcome
from lemma.planning.grounding import GeometricGrounder, ground_or_refuse
from lemma.planning.symbolic_state import SymbolicState
from lemma.robots.gripper import FINGER_OPENING_M
from lemma.robots.hand import HANDS, STANDARD, WEAK
from lemma.robots.reach import reach_of
from lemma.robots.ur.kinematics import top_down
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.entity import kind_of
from lemma.scene.spec import ObjectPlacement, RobotPlacement, SceneSpec
from lemma.tasks.goal import On
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive, SubTask
from lemma.tasks.suite import load_instance
from lemma.tasks.teams.coalitions import lack_of, needed
from lemma.tasks.teams.strong import HEAVY_KG
from lemma.tasks.zones import Territory


def heavy_of(instance: Instance) -> str:
    [name] = [o.name for o in instance.scene.objects if o.mass_kg is not None]
    return name


def strong_of(instance: Instance) -> int:
    return [robot.hand for robot in instance.scene.robots].index(STANDARD)


def reaches_both(instance: Instance, robot: int) -> bool:
    """Whether a robot reaches the heavy cube and the one that it goes onto."""
    placed, there = instance.scene.robots[robot], instance.goal.pairs[0]
    reach, poses = reach_of(placed.arm), map(instance.scene.placement, there)
    return all(reach.margin(placed.base, p.pose.x, p.pose.y) > 0.0 for p in poses)


def direct() -> Instance:
    """The first table on which the strong robot reaches both, as a weak one does."""
    listed = (load_instance("strong", "val", index) for index in range(40))
    return next(one for one in listed if reaches_both(one, strong_of(one)))


def tempted(instance: Instance) -> int:
    """The weak robot that reaches both."""
    weak = {0, 1, 2} - {strong_of(instance)}
    return next(robot for robot in weak if reaches_both(instance, robot))


# --- One robot and a heavy cube ----------------------------------------------------


def carry(arm: str, hand: str, mass_kg: float | None) -> tuple[Simulation, Outcome]:
    """Let a robot move a cube onto a pad, and rest."""
    far = 0.8 * reach_of(arm).travel_m
    start, end = Pose2(far, -0.3, 0.4), Pose2(far, 0.3)
    things = (
        ObjectPlacement("cube", "red", start, mass_kg),
        ObjectPlacement("pad", "blue", end),
    )
    robot = RobotPlacement(arm, "white", Pose2(0.0, 0.0), hand)
    simulation = Simulation(SceneSpec((robot,), things))
    result = simulation.execute(GroundedSubTask("robot_0", Primitive.MOVE, start, end))
    simulation.rest(0.5)
    return simulation, result.outcome


def is_on_pad(simulation: Simulation) -> bool:
    return On("red_cube", "blue_pad").holds(simulation.scene)


CASES = [
    ("ur5", STANDARD, HEAVY_KG, Outcome.SUCCESS),
    ("ur5", WEAK, HEAVY_KG, Outcome.OVERLOAD),
    ("ur5", WEAK, None, Outcome.SUCCESS),
    ("ur10", STANDARD, HEAVY_KG, Outcome.SUCCESS),
    ("ur10", WEAK, HEAVY_KG, Outcome.OVERLOAD),
    ("ur5", STANDARD, 4.5, Outcome.OVERLOAD),
    ("ur10", STANDARD, 4.5, Outcome.SUCCESS),
]


@pytest.mark.parametrize(("arm", "hand", "mass_kg", "ends"), slow_but(CASES, CASES[1]))
def test_hand_and_arm_say_what_is_too_heavy(
    arm: str, hand: str, mass_kg: float | None, ends: Outcome
) -> None:
    simulation, outcome = carry(arm, hand, mass_kg)
    assert outcome is ends
    assert is_on_pad(simulation) == (ends is Outcome.SUCCESS)
    assert not simulation.held()
    assert Outcome.OVERLOAD in REFUSED


def without_rule(self: Moves, low: Stand) -> Motion:
    yield from ()


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["ur5", "ur10"])
def test_without_the_rule_a_weak_hand_slips_off(
    arm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Moves, "_feel_weight", without_rule)
    simulation, outcome = carry(arm, WEAK, HEAVY_KG)
    assert outcome is Outcome.DROPPED
    assert not is_on_pad(simulation)
    assert is_on_pad(carry(arm, STANDARD, HEAVY_KG)[0])


# --- In the family -----------------------------------------------------------------


@pytest.mark.parametrize(
    "level", ["plan", pytest.param("skill", marks=pytest.mark.slow)]
)
def test_a_weak_robot_that_reaches_it_is_refused(level: str) -> None:
    instance = direct()
    episode, robot = Episode(instance), f"robot_{tempted(instance)}"
    top, bottom = instance.goal.pairs[0]
    now = SymbolicState.observe(episode.simulation.scene)
    asked = SubTask(robot, Primitive.MOVE, top, bottom)
    refused = ground_or_refuse(asked, now, GeometricGrounder(instance.scene))
    assert not hasattr(refused, "grounded")
    if level == "skill":
        ends = now.poses[top], now.poses[bottom]
        refused = episode.execute(GroundedSubTask(robot, Primitive.MOVE, *ends))
        assert episode.instance.goal.progress(episode.simulation.scene) < 1.0
    assert refused.outcome is Outcome.OVERLOAD
    assert "weighs 2.4 kg" in refused.explanation
    assert "weak hand) carries 0.98 kg" in refused.explanation


def waypoints(instance: Instance, robot: int) -> Iterator[tuple[Stand, float, int]]:
    """Yield stands of a hand, openings [m] and steps: as `move`, and slower."""
    top, bottom = (instance.scene.placement(n) for n in instance.goal.pairs[0])
    base, opened = instance.scene.robots[robot].base, FINGER_OPENING_M
    grip_m = top.entity.kind.grasp.height_m if top.entity.kind.grasp else 0.0
    quarter = 0.5 * np.pi
    away = np.arctan2(top.pose.y - base.y, top.pose.x - base.x)
    yaw = top.pose.yaw + quarter * round((away - top.pose.yaw) / quarter)
    for opening, z, steps in (
        (opened, 0.2, 60),
        (opened, grip_m, 40),
        (0.0, grip_m, 30),
    ):
        yield (*top.pose.xy, z, yaw), opening, steps
    yield (*top.pose.xy, 0.2, yaw), 0.0, 60
    put_m = kind_of(bottom.name).height_m + grip_m + 0.001
    for opening, z, steps in ((0.0, 0.2, 80), (0.0, put_m, 60), (opened, put_m, 30)):
        yield (*bottom.pose.xy, z, yaw), opening, steps
    yield (*bottom.pose.xy, 0.25, yaw), opened, 60


def lead(instance: Instance, robot: int) -> tuple[bool, float]:
    """Lead one hand by poses; return whether it is done, and the height of the cube."""
    env = lemma.make(
        "strong", level="control", control="ee_pose", split="val", index=instance.index
    ).unwrapped
    assert isinstance(env, ControlEnv)
    env.reset()
    arms, top = env.episode.simulation.arms, instance.goal.pairs[0][0]
    scene = env.episode.simulation.scene

    def row(pose: np.ndarray, opening: float) -> list[float]:
        return [*pose[:3, 3], *quaternion_from_matrix(pose[:3, :3]), opening]

    rows = [row(arm.tcp_pose(), FINGER_OPENING_M) for arm in arms.values()]
    highest = 0.0
    for stand, opening, steps in waypoints(instance, robot):
        rows[robot] = row(top_down(*stand), opening)
        action = np.array(rows, np.float32).reshape(env.action_space.shape)
        for _ in range(steps):
            if any(env.advance(action)[1:]):
                break
            highest = max(highest, scene.position(top)[2])
    first = instance.goal.placements[0]
    return first.holds(scene), highest - kind_of(top).origin_m


@pytest.mark.slow
def test_motor_commands_do_not_help_a_weak_hand() -> None:
    """The same commands to the strong robot put the cube where it shall lie."""
    instance = direct()
    done, raised_m = lead(instance, tempted(instance))
    assert not done
    # A jerk of the hand may toss it a little.
    assert raised_m < CUBE_EDGE_M
    assert lead(instance, strong_of(instance))[0]


@pytest.mark.parametrize("index", range(6))
def test_the_strong_robot_is_needed_for_its_hand(index: int) -> None:
    instance = load_instance("strong", "test", index)
    scene, strong = instance.scene, strong_of(instance)
    assert needed(Territory(scene.robots), scene.objects, instance.goal) == (0, 1, 2)
    alike = tuple(replace(robot, hand=STANDARD) for robot in scene.robots)
    others = set(needed(Territory(alike), scene.objects, instance.goal))
    assert others == {0, 1, 2} - {strong}


def test_a_team_of_weak_hands_says_what_it_lacks() -> None:
    listed = (load_instance("strong", "test", index) for index in range(60))
    instance = next(one for one in listed if not one.distractors)
    weak = tuple(replace(robot, hand=WEAK) for robot in instance.scene.robots)
    lack = lack_of(Territory(weak), instance.scene.objects, instance.goal)
    assert lack is not None
    said = lack.words(("red robot", "white robot", "blue robot"))
    phrase = heavy_of(instance).replace("_", " ")
    assert said == f"No robot that reaches the {phrase} can carry it."


@pytest.mark.slow
def test_a_demonstration_replays_to_the_bit() -> None:
    record = played("strong").record
    assert record.success
    assert replay(record).is_exact


def test_others_have_neither_hands_nor_masses_in_their_data() -> None:
    assert load_instance("strong", "val", 0).to_dict()["hands"].count(WEAK) == 2
    plain = load_instance("sort", "val", 0)
    assert not {"hands", "masses_kg"} & set(plain.to_dict())
    data = plain.to_dict() | {"hands": [STANDARD, WEAK, STANDARD]}
    read = Instance.from_dict(data)
    assert [robot.hand for robot in read.scene.robots] == data["hands"]
    assert read.to_dict() == data
    for wrong in ({"hands": [WEAK]}, {"masses_kg": {"stick": 1.0}}):
        with pytest.raises(InvalidConfigError):
            Instance.from_dict(plain.to_dict() | wrong)


def test_privileged_observations_say_who_carries_what() -> None:
    instance = direct()
    env = lemma.make(
        "strong",
        level="plan",
        split="val",
        index=instance.index,
        observation="privileged",
    )
    found, _ = env.reset()
    assert found["masses_kg"].max() == np.float32(HEAVY_KG)
    assert found["carries_kg"].argmax() == strong_of(instance)
    assert found["carries_kg"].min() == np.float32(HANDS[WEAK].carries_kg)


def touches(instance: Instance, placed: ObjectPlacement) -> set[int]:
    territory, kind = Territory(instance.scene.robots), placed.entity.kind
    x, y = (np.array([at]) for at in placed.pose.xy)
    return {r for r in range(3) if not territory.cannot(r, kind, x, y)[0]}


def test_who_touches_the_heavy_cube_touches_no_pad() -> None:
    """Over its rim a hand that cannot lift the cube would tip it."""
    for index in range(60):
        instance = load_instance("strong", "test", index)
        scene, strong = instance.scene, strong_of(instance)
        who = touches(instance, scene.placement(heavy_of(instance)))
        assert strong in who
        [weak] = who - {strong}
        pads = [o for o in scene.objects if o.entity.kind.fixed]
        assert pads
        assert not any(weak in touches(instance, pad) for pad in pads)
