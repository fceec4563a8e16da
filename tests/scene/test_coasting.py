"""Objects that move by themselves are thrown; those that robots lead are not."""

import numpy as np
import pytest
from small_tables import cube, facing, pad
from tiers import MODES, slow_but

from lemma.core.poses import Pose
from lemma.env.config import EnvConfig
from lemma.env.control.modes import CONTROLS
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.expert.expert import Expert, solve
from lemma.scene.build import TICK_S
from lemma.scene.coasting import COAST_M, FLIGHT_S
from lemma.scene.objects.cube import CUBE, CUBE_EDGE_M
from lemma.scene.objects.kind import ObjectKind
from lemma.scene.objects.pad import PAD
from lemma.tasks.suite import SUITE, load_instance
from lemma.tasks.zones import REMOTE_M

LYING_M = CUBE_EDGE_M / 2


@pytest.fixture
def simulation() -> Simulation:
    cubes = cube("red", -0.1, 0.0), cube("blue", -0.1, 0.3)
    return Simulation(facing("ur5", *cubes, pad("white", 0.1, 0.0)))


def lift(simulation: Simulation, name: str, by_m: float) -> None:
    pose = simulation.scene.pose(name)
    x, y, z = pose.position
    simulation.scene.set_pose(name, Pose((x, y, z + by_m), pose.quaternion))


def kick(simulation: Simulation, name: str, speed_m_s: float) -> None:
    dof = int(simulation.scene.model.joint(name).dofadr[0])
    simulation.scene.data.qvel[dof] = speed_m_s


def test_nothing_is_thrown_at_rest(simulation: Simulation) -> None:
    simulation.rest(2.0)
    assert simulation.scene.coasting.thrown == ()
    assert not simulation.scene.coasting.is_thrown


@pytest.mark.parametrize(("height_m", "thrown"), [(0.05, False), (0.20, True)])
def test_a_fall_is_flight_if_it_lasts(
    simulation: Simulation, height_m: float, thrown: bool
) -> None:
    assert 0.05 < 0.5 * 9.81 * FLIGHT_S**2 < 0.20
    lift(simulation, "red_cube", height_m)
    simulation.rest(0.5)
    assert simulation.scene.coasting.thrown == (("red_cube",) if thrown else ())


def test_two_that_fall_together_fly(simulation: Simulation) -> None:
    lift(simulation, "red_cube", 0.3)
    x, y, z = simulation.scene.pose("red_cube").position
    upper = Pose((x, y, z + CUBE_EDGE_M - 1e-4), (1.0, 0.0, 0.0, 0.0))
    simulation.scene.set_pose("blue_cube", upper)
    simulation.rest(FLIGHT_S + 2 * TICK_S)
    assert set(simulation.scene.coasting.thrown) == {"red_cube", "blue_cube"}


@pytest.mark.parametrize(("speed_m_s", "thrown"), [(0.3, False), (2.0, True)])
def test_a_slide_is_thrown_if_it_is_long(
    simulation: Simulation, speed_m_s: float, thrown: bool
) -> None:
    kick(simulation, "red_cube", speed_m_s)
    before = np.array(simulation.scene.position("red_cube"))
    simulation.rest(1.0)
    way = np.linalg.norm(np.array(simulation.scene.position("red_cube")) - before)
    assert (way > COAST_M) == thrown
    assert simulation.scene.coasting.is_thrown == thrown


def test_what_somebody_puts_elsewhere_is_not_thrown(simulation: Simulation) -> None:
    simulation.scene.set_pose(
        "red_cube", Pose((0.3, 0.3, LYING_M), (1.0, 0.0, 0.0, 0.0))
    )
    simulation.rest(0.5)
    assert not simulation.scene.coasting.is_thrown


@pytest.mark.parametrize("task", slow_but(SUITE, "poke"))
def test_the_expert_lets_things_move_less_than_a_third_of_what_is_allowed(
    task: str,
) -> None:
    episode = Episode(load_instance(task, "free", 0))
    scene, ways, flights = episode.simulation.scene, [], []

    def look() -> None:
        coasting = scene.coasting
        ways.append(np.linalg.norm(coasting.middles() - coasting.left_m, axis=1).max())
        flights.append((scene.time_s - coasting.since_s).max())

    episode.simulation.observers.append(look)
    list(solve(episode, Expert(scene, episode.instance.goal)))
    assert episode.is_success
    assert max(ways) < 0.3 * COAST_M
    assert max(flights) < 0.3 * FLIGHT_S


@pytest.mark.parametrize("mode", slow_but(CONTROLS, *MODES))
def test_a_throw_is_seen_in_every_control_mode(mode: str) -> None:
    env = ControlEnv(EnvConfig(task="pass", control=mode, split="test"))
    env.set_table(options={"index": 0})
    (top, _), *_ = env.instance.goal.pairs
    dof = int(env.episode.simulation.scene.model.joint(top).dofadr[0])
    env.action_space.seed(0)
    action = env.action_space.sample()
    assert env.advance(action)[1:] == (False, False)
    env.episode.simulation.scene.data.qvel[dof + 2] = 2.0
    # Control steps last 50 ms, so the fourth sees more than the time that is allowed.
    ended = next(end for _ in range(4) if any(end := env.advance(action)[1:]))
    assert ended == (True, False)
    assert env.episode.thrown == (top,)
    assert env.episode.failure == "thrown"


def test_a_throw_ends_the_episode() -> None:
    episode = Episode(load_instance("pass", "free", 0))
    scene = episode.simulation.scene
    (top, _), *_ = episode.instance.goal.pairs
    kept = episode.snapshot()
    kick(episode.simulation, top, 2.0)
    episode.simulation.rest(0.5)
    episode.conclude()
    assert episode.is_over
    assert not episode.is_success
    assert episode.failure == "thrown"
    assert episode.info()["thrown"] == [top] == list(scene.coasting.thrown)
    episode.restore(kept)
    assert not episode.is_over
    assert episode.info()["thrown"] == []


@pytest.mark.parametrize("bottom", [CUBE, PAD], ids=lambda kind: kind.name)
def test_zones_leave_room_for_a_cube_that_coasts(bottom: ObjectKind) -> None:
    """From where a fingertip touches its corner, it gets on nothing of another's."""
    corner_m = 0.5 * 3.0**0.5 * CUBE_EDGE_M
    counts_from_m = bottom.disc_m + REMOTE_M - (bottom.support_m or 0.0)
    assert corner_m + COAST_M + 0.015 < counts_from_m
