"""The ladder: rungs below the paper's tasks, and goals that hold for a hand."""

import pytest
from recorded_episodes import played
from tiers import slow_but

from lemma.audit.run import attackers
from lemma.core.errors import InvalidConfigError
from lemma.core.poses import Pose
from lemma.env.episode import Episode
from lemma.env.stages import stages_of
from lemma.evaluation.protocol.expert_times import expert_s, perturbed_start
from lemma.evaluation.protocol.language_controls import control_of
from lemma.evaluation.run.rollout import Player, Rollout, roll_out
from lemma.expert.expert import Expert, solve
from lemma.policies.spec import PolicySpec
from lemma.scene.objects.entity import HAND, kind_of
from lemma.scene.scene import Scene
from lemma.tasks.goal import Goal, Lifted, On, Reached
from lemma.tasks.instance import SPLITS, Instance
from lemma.tasks.language.bank import parse
from lemma.tasks.language.template import KINDS
from lemma.tasks.suite import LADDER, LISTED, SUITE, TASKS, load_instance

OWN = tuple(task for task in LADDER if task not in SUITE)
ALONE = {"reach": Reached, "lift": Lifted, "place": On}


def rung_of(task: str) -> str:
    return task.removesuffix("_fixed").removesuffix("_varied")


def test_it_has_eight_rungs_of_three_degrees_and_ends_with_the_papers_tasks() -> None:
    assert len(LADDER) == len(set(LADDER)) == 24
    assert [t for t in LADDER if t in SUITE] == ["pass", "stack", "poke", "hook"]
    assert {*SUITE, *LADDER} < set(LISTED)
    assert all(TASKS[task].name == task for task in LADDER)


@pytest.mark.parametrize("task", OWN)
def test_the_expert_solves_it_in_as_many_sub_tasks_as_it_promises(task: str) -> None:
    done = played(task)
    assert done.success
    assert done.progress == 1.0
    plan = Episode(done.instance).stages.plan
    assert len(done.steps) == TASKS[task].subtasks == len(plan)


@pytest.mark.parametrize("task", OWN)
def test_each_degree_lets_one_thing_more_vary(task: str) -> None:
    tables = [load_instance(task, "val", index) for index in range(40)]
    teams = {tuple(r.arm for r in one.scene.robots) for one in tables}
    bases = {tuple(r.base for r in one.scene.robots) for one in tables}
    counts = {len(one.distractors) for one in tables}
    fixed, full = task.endswith("_fixed"), rung_of(task) == task
    one_team = fixed or rung_of(task) == "hand_over"
    assert (teams == {("ur5", "ur5")}) == one_team
    assert (len(bases) == 1) == fixed
    assert counts == ({1, 2, 3, 4} if full else {0})


@pytest.mark.parametrize("rung", ALONE)
def test_one_robot_can_and_from_place_on_it_is_open_which(rung: str) -> None:
    tables = [load_instance(rung, "test", index) for index in range(12)]
    plans = [Expert(Scene(one.scene), one.goal).plan() for one in tables]
    able = {step.subtask.robot for plan in plans if plan for step in plan.steps}
    assert able == ({"robot_0"} if rung != "place" else {"robot_0", "robot_1"})
    for one, plan in zip(tables, plans, strict=True):
        assert plan is not None
        assert isinstance(one.goal.conjuncts[0], ALONE[rung])
        others = {*one.scene.robot_names} - {plan.steps[0].subtask.robot}
        assert set(attackers(one)) == (others if rung == "place" else set())


@pytest.mark.parametrize(
    "task", slow_but([task for task in OWN if task == rung_of(task)], "hand_over")
)
def test_every_sentence_asks_for_the_goal(task: str) -> None:
    for index in range(SPLITS["test"]):
        instance = load_instance(task, "test", index)
        assert set(instance.instructions) == set(KINDS)
        for kind in KINDS:
            asked = parse(instance.instructions[kind])
            assert asked == frozenset(instance.goal.pairs)


@pytest.mark.parametrize("task", [t for t in OWN if rung_of(t) == "hand_over"])
def test_hand_over_has_one_sentence_of_each_kind(task: str) -> None:
    assert [len(TASKS[task].language.templates(kind)) for kind in KINDS] == [1] * 3


def halfway(instance: Instance, seconds: float) -> Episode:
    episode = Episode(instance)
    _, grounded = Expert(episode.simulation.scene, instance.goal).act()
    assert grounded is not None
    episode.simulation.execute(grounded, until_s=seconds)
    return episode


@pytest.mark.parametrize(
    "task", slow_but(["reach", "lift", "place", "hand_over"], "lift")
)
def test_the_expert_broken_off_later_has_never_less_progress(task: str) -> None:
    instance = load_instance(task, "test", 3)
    begun = [halfway(instance, 0.4 * n) for n in range(1, 12)]
    assert Episode(instance).progress == 0.0
    found = [episode.stages.furthest.progress for episode in begun]
    assert found == sorted(found)
    # Fingers may part from a cube for a moment while the arm speeds up.
    same = [e.progress == e.stages.furthest.progress for e in begun]
    assert same.count(False) <= 1
    each = [episode.stages.furthest.stage for episode in begun]
    stages = stages_of(Expert(Scene(instance.scene), instance.goal).act()[0].primitive)
    assert set(each) - {""} <= set(map(str, stages))
    assert len(set(each)) >= min(3, len(stages))


@pytest.mark.parametrize("task", slow_but(["reach", "lift", "place"], "place"))
def test_going_by_reach_solves_it_and_stops(task: str) -> None:
    play = Rollout(load_instance(task, "test", 0))
    for _ in roll_out([play], Player(PolicySpec("greedy-reach").load())):
        pass
    assert play.verdict().success
    wanted = "move" if task == "place" else task
    assert [str(step.subtask.primitive) for step in play.steps] == [wanted]


def moment(task: str, index: int = 0) -> Episode:
    """Return an episode that the expert has solved."""
    episode = Episode(load_instance(task, "test", index))
    list(solve(episode, Expert(episode.simulation.scene, episode.instance.goal)))
    assert episode.is_success
    return episode


def test_a_cube_that_is_pushed_or_put_down_is_neither_lifted_nor_reached() -> None:
    for task in ("lift", "reach"):
        episode = moment(task)
        scene, [cube] = episode.simulation.scene, episode.instance.goal.entities
        at = scene.pose(cube)
        # Elsewhere: no hand is near. In the air: none holds it.
        for z in (kind_of(cube).origin_m, 0.3):
            scene.set_pose(cube, Pose((at.position[0] + 0.12, at.position[1], z)))
            assert episode.instance.goal.progress(scene) == 0.0


def test_a_hand_that_touches_is_not_over() -> None:
    held = moment("lift")
    [cube] = held.instance.goal.entities
    scene = held.simulation.scene
    assert Lifted(cube).holds(scene)
    assert not Reached(cube).holds(scene)


def test_goals_are_told_as_pairs_with_a_hand() -> None:
    for goal in (Goal((Lifted("red_cube"),)), Goal((Reached("red_cube"),))):
        assert Goal.from_pairs(goal.pairs) == goal
        assert HAND in goal.pairs[0]
        assert goal.entities == ("red_cube",)
    with pytest.raises(InvalidConfigError, match="No gripper can hold the red_pad"):
        Lifted("red_pad")


@pytest.mark.parametrize("task", ["reach", "lift"])
def test_language_controls_speak_of_another_cube(task: str) -> None:
    instance = load_instance(task, "test", 1)
    swapped = control_of("swapped", instance, "high_level")
    assert swapped.sentence
    assert swapped.sentence != instance.instructions["high_level"]
    asked = parse(swapped.sentence)
    assert asked is not None
    assert asked != frozenset(instance.goal.pairs)
    assert {HAND in pair for pair in asked} == {True}


def test_it_has_neither_expert_times_nor_perturbed_starts() -> None:
    assert expert_s("lift", "test", 0) is None
    with pytest.raises(InvalidConfigError, match="'lift' has no perturbed starts"):
        perturbed_start(load_instance("lift", "test", 0))


def test_a_held_cube_is_put_down_before_the_next_sub_task() -> None:
    episode = Episode(load_instance("lift", "test", 0))
    scene, [cube] = episode.simulation.scene, episode.instance.goal.entities
    at = scene.pose2(cube)
    for goal in (Lifted(cube), Reached(cube)):
        _, grounded = Expert(scene, Goal((goal,))).act()
        assert grounded is not None
        assert episode.execute(grounded).ok
        assert goal.holds(scene)
    assert scene.pose2(cube).distance(at) < 0.05
