"""Stages: what an episode has reached, in order and not undone."""

import gc
from collections.abc import Iterator
from weakref import ref

import pytest
from expert_commands import expert_commands
from tiers import slow_but

from lemma.core.poses import Pose, Pose2
from lemma.env.config import EnvConfig
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.signals.stage_events import StageEvents
from lemma.env.stages import Stage, stages_of
from lemma.expert.expert import Expert, solve
from lemma.expert.together import solve_together
from lemma.motion.outcome import Outcome
from lemma.scene.objects.entity import HAND
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive
from lemma.tasks.suite import SUITE, TASKS, load_instance


def begin(task: str, index: int = 0) -> Episode:
    return Episode(load_instance(task, "free", index))


def play(episode: Episode) -> Iterator[GroundedSubTask]:
    scene = episode.simulation.scene
    for step in solve(episode, Expert(scene, episode.instance.goal)):
        yield step.grounded


@pytest.mark.parametrize("task", slow_but(SUITE, "poke"))
def test_the_expert_climbs_stage_by_stage(task: str) -> None:
    episode = begin(task)
    reached: list[tuple[float, int | None, str]] = []

    def look() -> None:
        most = episode.stages.furthest
        if most.progress and (not reached or most.progress > reached[-1][0]):
            reached.append((most.progress, most.subtask, most.stage))

    episode.simulation.observers.append(look)
    done = list(play(episode))
    assert episode.is_success
    assert len(episode.stages.plan) == len(done)
    assert episode.progress == 1.0
    shares = [progress for progress, _, _ in reached]
    assert shares == sorted(shares)
    assert len(reached) > 2 * len(done)
    assert reached[-1] == (1.0, len(done) - 1, Stage.PLACED)
    record = episode.stages.record()
    verdicts = [record[name] for name in ("understood", "allocated", "executed")]
    assert verdicts == [True, True, True]
    assert record["by"] == done[0].robot


def stages_seen(
    instance: Instance, monkeypatch: pytest.MonkeyPatch, *, always: bool
) -> tuple[list[object], int]:
    """Return the stages after every tick, and how often they were told."""
    told = 0

    def look(self: StageEvents) -> bool:
        nonlocal told
        must = original(self) or always
        told += must
        return must

    original = StageEvents.look
    seen: list[object] = []
    with monkeypatch.context() as patch:
        patch.setattr(StageEvents, "look", look)
        episode = Episode(instance)
        episode.simulation.observers.append(
            lambda: seen.append(
                (episode.progress, episode.stages.furthest, episode.stages.first)
            )
        )
        solver = solve if instance.goal.in_turns else solve_together
        list(solver(episode))
    return seen, told


@pytest.mark.parametrize("task", slow_but(TASKS, "lift", "relay"))
def test_skipped_looks_would_have_seen_the_same(
    task: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    instance = load_instance(task, "free", 0)
    seen, told = stages_seen(instance, monkeypatch, always=False)
    wanted, most = stages_seen(instance, monkeypatch, always=True)
    assert seen == wanted
    # Goals of hands are looked at all the time that a hand is near.
    hands = any(HAND in pair for pair in instance.goal.pairs)
    assert told == most if hands else told < most / 2


@pytest.mark.parametrize("task", ["pass", "hook"])
def test_a_cube_that_is_carried_halfway_counts(task: str) -> None:
    episode = begin(task)
    share = 1.0 / sum(len(stages_of(s.primitive)) for s in episode.stages.plan)
    simulation, seen = episode.simulation, {round(episode.progress / share)}
    simulation.observers.append(lambda: seen.add(round(episode.progress / share)))
    _, grounded = Expert(simulation.scene, episode.instance.goal).act()
    assert grounded is not None
    simulation.execute(grounded)
    assert {0, 1, 3, 4} <= seen
    assert episode.goal_progress == 0.0


def test_motor_commands_reach_the_same_stages() -> None:
    env = ControlEnv(EnvConfig(task="pass", control="joint_position", split="test"))
    env.set_table(options={"index": 0})
    for row in expert_commands("pass", "test", 0):
        _, terminated, truncated = env.advance(row.reshape(2, 7))
        if terminated or truncated:
            break
    twin = Episode(load_instance("pass", "test", 0))
    list(play(twin))
    by_motors, by_skills = (one.stages.record() for one in (env.episode, twin))
    # Only the moments differ: an episode at control level has no sub-tasks.
    assert by_motors.pop("time_s") == pytest.approx(by_skills.pop("time_s"), abs=0.5)
    assert by_motors == by_skills
    assert env.episode.progress == twin.progress == 1.0


def test_what_is_undone_counts_no_more() -> None:
    episode = begin("pass")
    scene, steps = episode.simulation.scene, play(episode)
    top = episode.instance.goal.pairs[0][0]
    before = scene.pose(top)
    next(steps)
    assert episode.progress == 0.5
    scene.set_pose(top, before)
    episode.simulation.rest(0.5)
    assert episode.progress == 0.0
    assert episode.stages.furthest.progress == 0.5


def test_another_object_is_not_understood() -> None:
    for index in range(20):
        episode = begin("pass", index)
        spec = episode.simulation.scene.spec
        for name in episode.instance.distractors:
            pose = spec.placement(name).pose
            if not name.endswith("cube"):
                continue
            for robot in spec.robot_names:
                place = Pose2(pose.x, pose.y + 0.08)
                move = GroundedSubTask(robot, Primitive.MOVE, pose, place)
                if episode.execute(move).outcome is Outcome.SUCCESS:
                    record = episode.stages.record()
                    assert record["moved"] == name
                    assert record["understood"] is False
                    assert record["allocated"] is False
                    assert record["executed"] is False
                    assert episode.progress == 0.0
                    return
    pytest.fail("No instance has a cube that can be moved aside.")


def test_stages_go_on_from_a_snapshot() -> None:
    episode = begin("pass")
    steps = play(episode)
    next(steps)
    kept, record = episode.snapshot(), episode.stages.record()
    twin = Episode(episode.instance)
    twin.restore(kept)
    assert twin.progress == episode.progress
    assert twin.stages.record() == record
    list(steps)
    list(play(twin))
    assert twin.stages.record() == episode.stages.record()
    assert twin.simulation.scene.state_hash() == episode.simulation.scene.state_hash()


def test_a_goal_that_holds_at_first_is_reached() -> None:
    episode = begin("pass")
    list(play(episode))
    scene = episode.simulation.scene
    top, bottom = episode.instance.goal.pairs[0]
    x, y, z = scene.pose(top).position
    assert scene.pose(bottom).position[0] == pytest.approx(x, abs=0.05)
    again = begin("pass")
    again.simulation.scene.set_pose(top, Pose((x, y, z), (1.0, 0.0, 0.0, 0.0)))
    again.simulation.rest(0.5)
    assert again.progress == again.goal_progress == 1.0


def test_an_episode_is_in_no_circle() -> None:
    """Its megabytes would wait for the garbage collector."""
    gc.disable()
    try:
        simulation = ref(Episode(load_instance("pass", "test", 0)).simulation)
        assert simulation() is None
    finally:
        gc.enable()
