"""Kinds of a user's own, grasped along their faces and dragged with the stick."""

from collections.abc import Iterator

import pytest
from own_plugins import loaded

import lemma
from lemma.scene.objects.kind import OBJECT_KINDS, box, cylinder
from lemma.tasks.goal import Goal, On
from lemma.tasks.placement import ObjectPlacer
from lemma.tasks.subtask import Primitive


@pytest.fixture(autouse=True)
def _kinds() -> Iterator[None]:
    with loaded():
        OBJECT_KINDS.add("brick", box("brick", (0.05, 0.09, 0.06), 0.2))
        OBJECT_KINDS.add("tin", cylinder("tin", 0.03, 0.06, 0.12, drag_m=0.03))
        yield


def stacked_bricks(placer: ObjectPlacer) -> Goal:
    giver, taker = placer.order
    lower = placer.put("brick", placer.only(giver))
    pad = placer.pad(placer.only(taker))
    upper = placer.put("brick", placer.only(taker))
    return Goal((On(lower, pad), On(upper, lower)))


def tin_out_of_reach(placer: ObjectPlacer) -> Goal:
    robot, other = placer.order
    placer.stick(robot)
    tin = placer.put("tin", placer.tool_only(Primitive.HOOK, robot, other, "tin"))
    return Goal((On(tin, placer.pad(placer.only(robot))),))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arrange", "words"),
    [
        (stacked_bricks, "{top1} on {bottom1} and {top2} on {bottom2}"),
        (tin_out_of_reach, "{top} on {bottom}"),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_expert_solves_it(arrange, words: str, seed: int) -> None:
    language = lemma.LanguageBank.from_strings(
        *([f"{verb} {words}"] for verb in ("put", "place", "set"))
    )
    task = lemma.Task(
        name="own",
        summary="",
        subtasks=3,
        distractors=(0, 1),
        arrange=arrange,
        language=language,
    )
    lemma.TASKS.add("own", task)
    instance = lemma.load_instance("own", "free", seed)
    episode = lemma.Episode(instance)
    expert = lemma.Expert(episode.simulation.scene, instance.goal)
    steps = list(lemma.solve(episode, expert))
    assert [step.result.explanation for step in steps if not step.result.ok] == []
    assert len(steps) == 3
    assert episode.failure is None
