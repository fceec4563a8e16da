"""Honest physics: what is held stays held by friction alone, nothing sinks or rams."""

from collections.abc import Iterator
from itertools import chain

import mujoco
import numpy as np
import pytest
from recorded_episodes import (
    EPISODES,
    TEAMS,
    first_instance,
    recorded,
    run_expert,
)
from small_tables import facing
from tiers import slow_but

from lemma.core.poses import FloatArray, Pose, Pose2
from lemma.env.episode import STILL_S
from lemma.env.simulation import Simulation
from lemma.motion.moves import Moves, Stand
from lemma.robots.gripper import GRIP_FORCE_N
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.scene.objects.stick import HANDLE_LENGTH_M, HOOK_LENGTH_M, STICK_SECTION_M
from lemma.scene.spec import ObjectPlacement
from lemma.tasks.drags import grasp_on_stick

MINUTE_S = 60.0


def pick_up(simulation: Simulation, robot: str, grip: Pose2, low_m: float) -> None:
    """Grasp from above and lift, as a skill does."""
    moves = Moves(simulation.arms[robot])

    def at(height_m: float) -> Stand:
        return (grip.x, grip.y, height_m, grip.yaw)

    motions: Iterator[None] = chain(
        moves.grasp(at(0.3), at(low_m)), moves.rise(at(low_m), 0.3)
    )
    for _ in motions:
        simulation.tick((robot,))
    for _ in range(100):
        simulation.tick((robot,))


def in_hand(simulation: Simulation, robot: str, name: str) -> FloatArray:
    """Return gripper from object, (4, 4), as measured."""
    gripper = simulation.arms[robot].tcp_pose()
    found: FloatArray = np.linalg.inv(gripper) @ simulation.scene.pose(name).matrix()
    return found


CUBE = [(u, v, w) for u in (-1, 1) for v in (-1, 1) for w in (-1, 1)]
CORNERS_M = {
    "cube": 0.5 * CUBE_EDGE_M * np.array(CUBE, dtype=np.float64),
    # The end in the hand, the corner and the tip of the hook.
    "stick": np.array(
        [
            (0.0, 0.0, 0.0),
            (HANDLE_LENGTH_M, 0.0, 0.0),
            (HANDLE_LENGTH_M, HOOK_LENGTH_M - 0.5 * STICK_SECTION_M, 0.0),
        ]
    ),
}


def moved_m(kind: str, before: FloatArray, after: FloatArray) -> float:
    """How far the corner of a thing moved that moved most [m]."""
    points = CORNERS_M[kind]
    change = points @ (after - before)[:3, :3].T + (after - before)[:3, 3]
    return float(np.sqrt((change**2).sum(axis=1)).max())


@pytest.mark.parametrize("arm", slow_but(["ur5", "ur10"], "ur5"))
@pytest.mark.parametrize("kind", ["cube", "stick"])
def test_a_minute_in_the_hand_moves_it_less_than_a_millimetre(
    arm: str, kind: str
) -> None:
    stick = kind == "stick"
    pose = Pose2(-0.15, 0.1, 0.3)
    thing = ObjectPlacement(kind, "yellow" if stick else "red", pose)
    simulation = Simulation(facing(arm, thing))
    grip = grasp_on_stick(pose) if stick else pose
    pick_up(simulation, "robot_0", grip, 0.018 if stick else 0.025)
    assert simulation.held() == {"robot_0": thing.name}
    start = in_hand(simulation, "robot_0", thing.name)
    simulation.rest(MINUTE_S)
    assert simulation.held() == {"robot_0": thing.name}
    end = in_hand(simulation, "robot_0", thing.name)
    # Of the stick, the end far from the hand as well.
    assert moved_m(kind, start, end) < 1e-3


@pytest.mark.parametrize("offset_m", slow_but([0.0, 0.02], 0.02))
def test_a_tower_of_two_cubes_stands_for_a_minute(offset_m: float) -> None:
    cubes = [
        ObjectPlacement("cube", c, Pose2(0.0, y))
        for c, y in (("red", 0.0), ("blue", 0.3))
    ]
    simulation = Simulation(facing("ur5", *cubes))
    scene = simulation.scene
    scene.set_pose("blue_cube", Pose((offset_m, 0.0, 1.5 * CUBE_EDGE_M)))
    simulation.rest(1.0)
    start = [scene.pose(name).matrix() for name in ("red_cube", "blue_cube")]
    simulation.rest(MINUTE_S)
    end = [scene.pose(name).matrix() for name in ("red_cube", "blue_cube")]
    for before, after in zip(start, end, strict=True):
        assert moved_m("cube", before, after) < 1e-3
    assert end[1][2, 3] == pytest.approx(1.5 * CUBE_EDGE_M, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("team", TEAMS)
def test_a_tower_that_the_expert_built_stands_for_a_minute(team: str) -> None:
    episode = run_expert(first_instance("stack", team))[0]
    scene = episode.simulation.scene
    names = episode.instance.goal.entities
    start = [scene.pose(name).matrix() for name in names]
    episode.simulation.rest(MINUTE_S)
    for name, before in zip(names, start, strict=True):
        assert moved_m("cube", before, scene.pose(name).matrix()) < 1e-3
    assert episode.is_success


@pytest.mark.parametrize(("task", "team"), slow_but(EPISODES, *EPISODES[1::3]))
def test_no_limit_is_exceeded_in_any_step_of_an_episode(task: str, team: str) -> None:
    episode = recorded(task, team)
    worst = episode.extremes
    assert episode.success
    assert worst.steps == pytest.approx((episode.elapsed_s + STILL_S) / 0.005)
    assert worst.penetration_m < 2e-3, " in ".join(worst.penetrating)
    # Something is touched and something is moved, or nothing was watched.
    assert worst.penetration_m > 1e-5
    assert 0.5 < worst.velocity_ratio <= 1.0
    assert 0.2 < worst.effort_ratio <= 1.0


def test_an_object_let_go_falls_and_comes_to_rest_on_the_table() -> None:
    simulation = Simulation(facing("ur5", ObjectPlacement("cube", "red", Pose2(0, 0))))
    scene = simulation.scene
    scene.set_pose("red_cube", Pose((0.0, 0.0, 0.2)))
    simulation.rest(0.1)
    fallen = 0.2 - scene.pose("red_cube").position[2]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.1**2, rel=0.1)
    simulation.rest(1.0)
    assert scene.pose("red_cube").position[2] == pytest.approx(0.025, abs=3e-4)
    assert scene.speed("red_cube") < 1e-3


def test_a_slope_is_slid_down_by_friction_coefficient() -> None:
    """Tilted gravity: below the friction angle a cube stays, above it slides."""
    simulation = Simulation(facing("ur5", ObjectPlacement("cube", "red", Pose2(0, 0))))
    scene = simulation.scene
    friction = float(scene.model.geom("red_cube").friction[0])
    for slope, slides in ((0.8 * friction, False), (1.2 * friction, True)):
        scene.set_pose("red_cube", Pose((0.0, 0.0, 0.025)))
        scene.model.opt.gravity[:] = (0.0, 9.81 * slope, -9.81)
        mujoco.mj_step(scene.model, scene.data, 200)
        assert (scene.pose("red_cube").position[1] > 0.05) == slides


def test_fingers_press_no_harder_than_they_can() -> None:
    cube = ObjectPlacement("cube", "red", Pose2(-0.15, 0.1))
    simulation = Simulation(facing("ur5", cube))
    forces = []

    def look() -> None:
        data, wrench = simulation.scene.data, np.zeros(6)
        for index in range(data.ncon):
            geoms = data.contact.geom[index]
            names = {simulation.scene.model.geom(int(g)).name for g in geoms}
            if names == {"robot_0/pad_left", "red_cube"}:
                mujoco.mj_contactForce(simulation.scene.model, data, index, wrench)
                forces.append(float(wrench[0]))

    pick_up(simulation, "robot_0", cube.pose, 0.025)
    simulation.observers.append(look)
    simulation.rest(0.2)
    per_tick = sum(forces) / 20
    assert per_tick == pytest.approx(GRIP_FORCE_N, rel=0.05)
