"""An episode: when it is over, when it is a success, and why it failed."""

import pickle
from dataclasses import replace

import pytest
from recorded_episodes import EPISODES, first_instance, recorded, run_expert
from small_tables import cube, facing, pad

from lemma.core.errors import InvalidConfigError, ResetNeededError, UnknownNameError
from lemma.core.poses import Pose, Pose2
from lemma.env.episode import STILL_S, Episode
from lemma.env.simulation import HORIZON_S
from lemma.expert.expert import Expert, solve
from lemma.motion.outcome import Outcome
from lemma.motion.skills import SkillRunner
from lemma.scene.build import TICK_S
from lemma.scene.objects.pad import PAD_THICKNESS_M
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import GroundedSubTask, Primitive

PAD, PAD_2 = Pose2(-0.05, -0.2), Pose2(-0.05, -0.4)
START, START_2 = Pose2(-0.1, 0.15, 0.3), Pose2(-0.1, 0.35)
INSTANCE = Instance(
    task="pass",
    split="free",
    index=0,
    scene=facing(
        "ur5",
        cube("red", *START.xy, START.yaw),
        cube("blue", *START_2.xy),
        pad("white", *PAD.xy),
        pad("green", *PAD_2.xy),
    ),
    goal=Goal.from_pairs((("red_cube", "white_pad"), ("blue_cube", "green_pad"))),
    instructions={"high_level": "Put them away."},
    distractors=(),
)


def move(pick: Pose2, place: Pose2, robot: str = "robot_0") -> GroundedSubTask:
    return GroundedSubTask(robot, Primitive.MOVE, pick, place)


FIRST, SECOND = move(START, PAD), move(START_2, PAD_2)


@pytest.fixture
def episode() -> Episode:
    return Episode(INSTANCE)


def test_a_fresh_episode_is_not_over(episode: Episode) -> None:
    assert episode.elapsed_s == 0.0
    assert not episode.is_over
    assert not episode.is_success
    assert episode.goal_progress == 0.0
    assert episode.failure is None
    assert episode.executed == []
    assert episode.horizon_s == HORIZON_S == 100.0


def test_progress_grows_to_success(episode: Episode) -> None:
    assert episode.execute(FIRST).ok
    assert episode.goal_progress == 0.5
    assert not episode.is_success
    assert episode.execute(SECOND).ok
    info = episode.info()
    assert info["progress"] == episode.goal_progress == 1.0
    assert info["is_success"] is info["success"] is episode.is_success is True
    assert (info["elapsed_s"], info["failure"]) == (episode.elapsed_s, None)
    assert info["idle_s"]["robot_0"] == pytest.approx(0.0)
    assert info["idle_s"]["robot_1"] == pytest.approx(episode.elapsed_s)
    assert info["instruction"] == "Put them away."
    assert info["instance"] == "v3/pass/free/0"
    assert not episode.is_over
    assert episode.stop().outcome is Outcome.STOPPED
    assert episode.is_over
    assert episode.failure is None
    assert [done.grounded for done in episode.executed] == [FIRST, SECOND]
    assert episode.executed[0].start_s == 0.0
    assert episode.executed[1].start_s == pytest.approx(
        episode.executed[0].result.duration_s
    )


def test_what_is_held_is_no_success() -> None:
    """The cube is where it should be, at rest, but not let go: not yet."""
    goal = Goal.from_pairs((("red_cube", "white_pad"),))
    episode = Episode(replace(INSTANCE, goal=goal))
    simulation = episode.simulation
    scene, on_pad = simulation.scene, PAD_THICKNESS_M + 0.025
    skill = SkillRunner(simulation.arms).run(FIRST)
    lifted = False
    while not lifted or scene.pose("red_cube").position[2] > on_pad + 0.004:
        next(skill)
        simulation.tick(("robot_0",))
        lifted = lifted or scene.pose("red_cube").position[2] > 0.2
        assert not episode.is_success
    simulation.rest(0.2)
    assert simulation.held() == {"robot_0": "red_cube"}
    assert episode.goal_progress == 0.0
    assert not episode.is_success
    assert not episode.info()["is_success"]
    for _ in skill:
        simulation.tick(("robot_0",))
    assert episode.is_success


def test_holding_something_else_is_no_success_either() -> None:
    goal = Goal.from_pairs((("red_cube", "white_pad"),))
    episode = Episode(replace(INSTANCE, goal=goal))
    episode.execute(FIRST)
    assert episode.is_success
    skill = SkillRunner(episode.simulation.arms).run(SECOND)
    while not episode.simulation.held():
        next(skill)
        episode.simulation.tick(("robot_0",))
    assert episode.goal_progress == 1.0
    assert not episode.is_success


def test_failure_names_the_last_outcome_that_was_not_well(episode: Episode) -> None:
    episode.execute(FIRST)
    result = episode.execute(move(Pose2(0.0, 0.0), PAD_2))
    assert result.outcome is Outcome.NOTHING_TO_PICK
    assert episode.failure is None
    episode.stop()
    assert episode.failure == "nothing_to_pick"


def test_the_horizon_ends_it() -> None:
    episode = Episode(INSTANCE, horizon_s=9.0)
    assert episode.execute(FIRST).ok
    result = episode.execute(SECOND)
    assert result.outcome is Outcome.OUT_OF_TIME
    assert episode.elapsed_s == pytest.approx(9.0)
    assert episode.out_of_time
    assert episode.is_over
    assert not episode.stopped
    assert episode.failure == "out_of_time"


def test_success_at_the_horizon_is_success() -> None:
    episode = Episode(INSTANCE, horizon_s=25.0)
    episode.execute(FIRST)
    episode.execute(SECOND)
    episode.simulation.rest(25.0 - episode.elapsed_s)
    assert episode.is_over
    assert episode.is_success
    assert episode.failure is None


@pytest.mark.parametrize("how", ["stop", "horizon"])
def test_nothing_can_be_done_after_the_end(how: str) -> None:
    episode = Episode(INSTANCE, horizon_s=1.0)
    if how == "stop":
        episode.stop()
    else:
        episode.simulation.rest(1.0)
    with pytest.raises(ResetNeededError, match="v3/pass/free/0 is over"):
        episode.execute(FIRST)
    assert episode.executed == []


def test_a_robot_that_does_not_exist_leaves_no_trace(episode: Episode) -> None:
    before = episode.simulation.scene.state_hash()
    with pytest.raises(UnknownNameError, match="robot_7"):
        episode.execute(move(START, PAD, "robot_7"))
    assert episode.executed == []
    assert episode.simulation.scene.state_hash() == before


def test_a_goal_that_comes_undone_is_undone(episode: Episode) -> None:
    episode.execute(FIRST)
    episode.execute(SECOND)
    assert episode.is_success
    episode.simulation.scene.set_pose("red_cube", Pose((0.0, 0.0, 0.025)))
    assert not episode.is_success
    assert episode.goal_progress == 0.5


# --- The judge's second ------------------------------------------------------------


def test_the_end_is_judged_after_a_second_that_nobody_is_charged(
    episode: Episode,
) -> None:
    episode.execute(FIRST)
    episode.execute(SECOND)
    before = episode.elapsed_s
    episode.stop()
    assert episode.simulation.time_s == pytest.approx(before + STILL_S)
    assert episode.elapsed_s == before
    assert not episode.out_of_time
    assert episode.info()["idle_s"]["robot_1"] == pytest.approx(before)


def test_what_slides_off_in_that_second_was_no_success(episode: Episode) -> None:
    episode.execute(FIRST)
    episode.execute(SECOND)
    scene = episode.simulation.scene
    height = scene.pose("red_cube").position[2]
    for name in ("red_cube", "white_pad"):
        scene.model.geom(name).friction[:] = 0.0
    # Too slow to be seen moving, and half a millimetre from where it is too far.
    scene.set_pose("red_cube", Pose((PAD.x + 0.0495, PAD.y, height)))
    scene.data.qvel[int(scene.model.joint("red_cube").dofadr[0])] = 0.009
    assert episode.is_success
    episode.stop()
    assert not episode.is_success
    assert episode.failure == "goal_not_reached"


def test_a_verdict_is_final(episode: Episode) -> None:
    episode.execute(FIRST)
    episode.execute(SECOND)
    episode.stop()
    assert episode.is_success
    episode.simulation.scene.set_pose("red_cube", Pose((0.0, 0.0, 0.025)))
    assert episode.is_success
    after = episode.simulation.time_s
    episode.conclude()
    assert episode.simulation.time_s == after


def test_the_horizon_is_judged_alike() -> None:
    goal = Goal.from_pairs((("red_cube", "white_pad"),))
    episode = Episode(replace(INSTANCE, goal=goal), horizon_s=9.5)
    assert episode.execute(FIRST).ok
    episode.linger(8.9)
    assert episode.is_over
    assert not episode.stopped
    assert episode.elapsed_s == pytest.approx(9.5, abs=2 * TICK_S)
    assert episode.simulation.time_s == pytest.approx(episode.elapsed_s + STILL_S)
    assert episode.is_success


def test_robots_stand_still_while_it_is_judged() -> None:
    """Cut off in the middle of a motion, whatever drives the arms."""
    for actuation in ("position", "velocity", "torque"):
        simulation = Episode(INSTANCE, actuation=actuation).simulation
        data, arm = simulation.scene.data, simulation.arms["robot_0"].robot
        data.qvel[arm.dof] = 0.5
        if actuation == "velocity":
            data.ctrl[arm.ctrl] = 0.5
        simulation.stand_still(STILL_S)
        assert abs(data.qvel[arm.dof]).max() < 0.02


# --- Snapshots ---------------------------------------------------------------------


def test_an_episode_goes_back_and_on_again(episode: Episode) -> None:
    episode.execute(FIRST)
    kept = pickle.loads(pickle.dumps(episode.snapshot()))
    result = episode.execute(SECOND)
    after = episode.simulation.scene.state_hash()
    episode.stop()
    episode.restore(kept)
    assert not episode.is_over
    assert len(episode.executed) == 1
    assert episode.goal_progress == 0.5
    assert episode.execute(SECOND) == result
    assert episode.simulation.scene.state_hash() == after
    assert episode.info()["is_success"]


def test_a_fresh_episode_takes_a_snapshot_over(episode: Episode) -> None:
    episode.execute(FIRST)
    kept = episode.snapshot()
    other = Episode(INSTANCE)
    other.restore(kept)
    assert other.info() == episode.info()
    assert other.execute(SECOND) == episode.execute(SECOND)


def test_a_snapshot_of_another_instance_is_refused(episode: Episode) -> None:
    kept = Episode(replace(INSTANCE, index=1)).snapshot()
    with pytest.raises(InvalidConfigError, match=r"of v3/pass/free/1.*v3/pass/free/0"):
        episode.restore(kept)


# --- The expert's episodes ---------------------------------------------------------


@pytest.mark.parametrize(("task", "team"), EPISODES[1::3])
def test_busy_times_and_durations_add_up(task: str, team: str) -> None:
    episode = recorded(task, team)
    assert episode.success
    assert episode.elapsed_s < HORIZON_S
    durations = [step.result.duration_s for step in episode.steps]
    assert sum(durations) == pytest.approx(episode.elapsed_s)
    starts = [step.start_s for step in episode.steps]
    assert starts == pytest.approx([sum(durations[:k]) for k in range(len(starts))])


@pytest.mark.slow
def test_an_expert_out_of_time_is_cut_off() -> None:
    instance = first_instance("hook_stack", "ur5+ur10")
    episode = Episode(instance, horizon_s=20.0)
    expert = Expert(episode.simulation.scene, instance.goal)
    steps = list(solve(episode, expert))
    assert steps[-1].result.outcome is Outcome.OUT_OF_TIME
    assert episode.failure == "out_of_time"
    assert len(steps) < len(run_expert(instance)[2])
