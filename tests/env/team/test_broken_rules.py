"""Attacks on rules: whatever happens, contacts and poses judge, at every level."""

from itertools import product

import pytest
from tiers import slow_but

import lemma
from lemma.core.poses import Pose
from lemma.env.control_env import ControlEnv
from lemma.env.episode import Episode
from lemma.env.team.team_env import TeamPlanEnv
from lemma.expert.expert import Expert, solve
from lemma.expert.together import solve_together
from lemma.motion.outcome import Outcome
from lemma.scene.objects.cube import CUBE_EDGE_M
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.suite import load_instance
from lemma.tasks.teams.rule import AT_ONCE_S, After, But, Without

LYING_M = CUBE_EDGE_M / 2


def index_of(kind: str) -> int:
    listed = (load_instance("exchange", "val", k).goal.rule for k in range(40))
    return next(k for k, rule in enumerate(listed) if rule and rule.kind == kind)


def begun(kind: str) -> Episode:
    return Episode(load_instance("exchange", "val", index_of(kind)))


def put(episode: Episode, name: str, x: float, y: float, z: float = LYING_M) -> None:
    scene = episode.simulation.scene
    scene.set_pose(name, Pose((x, y, z), (1.0, 0.0, 0.0, 0.0)))
    scene.coasting.put(name)


def put_on(episode: Episode, top: str, bottom: str) -> None:
    x, y, _ = episode.simulation.scene.position(bottom)
    put(episode, top, x, y, LYING_M + 0.006)


def fails(episode: Episode) -> bool:
    """Whether the rule has ended it, whatever else is true."""
    episode.conclude()
    info = episode.info()
    ended = episode.is_over and not info["is_success"] and info["failure"] == "rule"
    return ended and bool(info["rule"]["broken"])


# --- Without -----------------------------------------------------------------------


def excluded_from(instance: Instance) -> str:
    assert isinstance(instance.goal.rule, Without)
    return instance.goal.rule.excluded


def test_the_excluded_robot_ends_the_episode_as_it_grasps() -> None:
    episode = begun("without")
    goal, scene = episode.instance.goal, episode.simulation.scene
    ruleless = Expert(scene, Goal(goal.conjuncts))
    steps = list(solve(episode, ruleless))
    assert steps[-1].subtask.robot == excluded_from(episode.instance)
    assert steps[-1].result.outcome is Outcome.RULE
    assert fails(episode)


@pytest.mark.parametrize("part", ["forearm", "wrist_3"])
def test_an_elbow_is_a_touch(part: str) -> None:
    """A cube that comes to any part of the arm, be it for a moment."""
    episode = begun("without")
    scene, name = episode.simulation.scene, excluded_from(episode.instance)
    body = next(
        b
        for b in range(scene.model.nbody)
        if scene.model.body(b).name.startswith(f"{name}/")
        and part in scene.model.body(b).name
    )
    geoms = [
        g
        for g in range(scene.model.ngeom)
        if scene.model.geom_bodyid[g] == body and scene.model.geom_contype[g]
    ]
    x, y, z = scene.data.geom_xpos[geoms[0]].tolist()
    put(episode, episode.instance.goal.pairs[0][0], x, y, z)
    episode.simulation.tick()
    assert fails(episode)


def test_the_others_may_do_anything() -> None:
    episode = begun("without")
    for step in solve_together(episode):
        assert step.subtask.robot != excluded_from(episode.instance)
    assert episode.is_success
    assert episode.info()["rule"]["broken"] is None


# --- Only after --------------------------------------------------------------------


def order_of(instance: Instance) -> tuple[tuple[str, str], tuple[str, str]]:
    assert isinstance(instance.goal.rule, After)
    later, first = instance.goal.rule.pairs
    return later, first


@pytest.mark.parametrize("leaning", [False, True])
def test_what_lies_there_too_soon_has_failed(leaning: bool) -> None:
    """Also where it leans against something, so that ``On`` does not hold yet."""
    episode = begun("after")
    later, first = order_of(episode.instance)
    put_on(episode, *later)
    if leaning:
        x, y, _ = episode.simulation.scene.position(later[1])
        put(episode, first[0], x + CUBE_EDGE_M, y)
    episode.simulation.rest(0.3)
    assert fails(episode)
    put_on(episode, *first)
    episode.simulation.rest(0.5)
    assert fails(episode)


def test_the_right_order_holds_and_a_moment_is_enough() -> None:
    episode = begun("after")
    later, first = order_of(episode.instance)
    x, y, z = episode.simulation.scene.position(first[0])
    put_on(episode, *first)
    episode.simulation.rest(0.3)
    assert episode.info()["rule"]["has_been"]
    put(episode, first[0], x, y, z)
    put_on(episode, *later)
    episode.simulation.rest(0.3)
    assert episode.broken is None
    put_on(episode, *first)
    episode.simulation.rest(0.5)
    assert episode.goal_progress == 1.0
    assert episode.broken is None


def test_the_judge_s_second_counts() -> None:
    episode = begun("after")
    put_on(episode, *order_of(episode.instance)[0])
    episode.stop()
    assert fails(episode)


# --- All but one -------------------------------------------------------------------


def test_a_nudge_by_another_cube_is_a_touch() -> None:
    episode = begun("but")
    rule, scene = episode.instance.goal.rule, episode.simulation.scene
    assert isinstance(rule, But)
    x, y, _ = scene.position(rule.thing)
    other = episode.instance.goal.pairs[0][0]
    put(episode, other, x + 1.5 * CUBE_EDGE_M, y)
    episode.simulation.rest(0.2)
    assert episode.broken is None
    scene.data.qvel[int(scene.model.joint(other).dofadr[0])] = -0.6
    episode.simulation.rest(0.3)
    assert fails(episode)


def test_who_takes_every_cube_touches_that_one() -> None:
    episode = begun("but")
    rule = episode.instance.goal.rule
    assert isinstance(rule, But)
    pad = f"{rule.thing.removesuffix('_cube')}_pad"
    asked = Goal.from_pairs((*episode.instance.goal.pairs, (rule.thing, pad)))
    list(solve(episode, Expert(episode.simulation.scene, asked)))
    assert fails(episode)


# --- At the same time --------------------------------------------------------------


EARLY_S, LATE_S = AT_ONCE_S - 0.1, AT_ONCE_S + 0.2


@pytest.mark.parametrize(
    ("apart_s", "first"),
    slow_but(product((EARLY_S, LATE_S), (0, 1)), (EARLY_S, 0), (LATE_S, 1)),
)
def test_who_lies_there_first_waits_for_two_seconds(apart_s: float, first: int) -> None:
    """Whichever of the two it is; the whole goal is no help afterwards."""
    episode = Episode(load_instance("unison", "val", 0))
    pairs = episode.instance.goal.pairs
    put_on(episode, *pairs[first])
    episode.simulation.rest(apart_s)
    put_on(episode, *pairs[1 - first])
    episode.simulation.rest(0.5)
    assert episode.goal_progress == 1.0
    assert (episode.broken is None) == (apart_s < AT_ONCE_S)
    laid_s = [t for t in episode.info()["rule"]["laid_s"] if t is not None]
    assert len(laid_s) == (2 if apart_s < AT_ONCE_S else 1)
    assert fails(episode) == (apart_s > AT_ONCE_S)


@pytest.mark.slow
def test_a_cube_in_a_hand_has_not_been_laid_down() -> None:
    """A cube that is pressed on its pad counts when the hand lets go of it."""
    episode = Episode(load_instance("unison", "val", 0))
    scene, opened_s = episode.simulation.scene, dict[str, float]()

    def look() -> None:
        for top, _ in episode.instance.goal.pairs:
            if top in episode.simulation.held().values():
                opened_s[top] = scene.time_s

    episode.simulation.observers.append(look)
    for _ in solve_together(episode):
        pass
    assert episode.is_success
    laid_s = episode.info()["rule"]["laid_s"]
    for (top, _), time_s in zip(episode.instance.goal.pairs, laid_s, strict=True):
        assert 0.0 < time_s - opened_s[top] < 0.5


@pytest.mark.slow
def test_a_pair_once_together_may_be_moved() -> None:
    episode = Episode(load_instance("unison", "val", 0))
    one, other = episode.instance.goal.pairs
    x, y, z = episode.simulation.scene.position(one[0])
    put_on(episode, *one)
    put_on(episode, *other)
    episode.simulation.rest(0.3)
    kept = episode.snapshot()
    put(episode, one[0], x, y, z)
    episode.simulation.rest(2 * AT_ONCE_S)
    assert episode.info()["rule"]["has_been"]
    assert episode.broken is None
    episode.restore(kept)
    assert episode.info()["rule"]["has_been"]


# --- At every level, and in its midst ----------------------------------------------


def test_control_steps_end_with_a_broken_rule() -> None:
    env = lemma.make("exchange", level="control", split="val", index=index_of("after"))
    env.reset()
    inner = env.unwrapped
    assert isinstance(inner, ControlEnv)
    put_on(inner.episode, *order_of(inner.instance)[0])
    env.action_space.seed(0)
    action = env.action_space.sample()
    ended = next(end for _ in range(20) if any(end := inner.advance(action)[1:]))
    info = inner.info()
    assert ended == (True, False)
    assert info["failure"] == "rule"
    assert "before" in info["rule"]["broken"]


def test_orders_of_a_team_end_with_a_broken_rule() -> None:
    index = index_of("without")
    env = lemma.make(
        "exchange", level="plan", acting="together", split="val", index=index
    )
    _, info = env.reset()
    assert info["rule"]["rule"][0] == "without"
    team = env.unwrapped
    assert isinstance(team, TeamPlanEnv)
    name = excluded_from(team.instance)
    action, over = team.encode(team.valid_orders(name)[0]), False
    while not over:
        _, reward, over, _, info = env.step(action)
        action = {}
    assert (reward, info["failure"]) == (0.0, "rule")


def test_a_snapshot_in_the_midst_keeps_what_has_been_true() -> None:
    """The rule's state too is equal to the bit, while robots are at work."""
    episode = begun("after")
    for _ in solve_together(episode):
        if episode.simulation.busy and episode.rule and episode.rule.state().has_been:
            break
    again, kept = Episode(episode.instance), episode.snapshot()
    again.restore(kept)
    for one in (episode, again):
        assert one.rule is not None
        assert one.rule.state().has_been
        while one.simulation.busy:
            one.advance()
        one.stop()
    ends = [one.simulation.scene.state_hash() for one in (episode, again)]
    assert ends[0] == ends[1]
    assert again.rule is not None
    assert episode.rule is not None
    assert again.rule.state() == episode.rule.state()


def test_a_broken_rule_is_forgotten_by_going_back() -> None:
    episode = begun("but")
    kept, rule = episode.snapshot(), episode.instance.goal.rule
    assert isinstance(rule, But)
    x, y, _ = episode.simulation.scene.position(rule.thing)
    put(episode, episode.instance.goal.pairs[0][0], x, y, 3 * LYING_M)
    episode.simulation.rest(0.1)
    assert fails(episode)
    ended = episode.snapshot()
    episode.restore(kept)
    assert not episode.is_over
    assert episode.info()["rule"]["broken"] is None
    episode.restore(ended)
    assert fails(episode)
