"""Texts of the panel as HTML; sentences of users and policies are escaped."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.subtask import Primitive
from lemma.viewer.episode.reading import Explanation
from lemma.viewer.episode.status import ENDS, Phase, Status, say_goal
from lemma.viz.pages.templates import macro
from lemma.viz.recording import describe_subtask, judged, reached_words

part = partial(macro, "panel.html")
"""Returns a part of the panel, from the macro of that name."""
_LEAST_SHARE = 0.01


def status_html(status: Status) -> str:
    """Return the sentence, its reading, and the status."""
    goal = say_goal(status.reading.pairs or ()) if status.reading else ""
    goes_on = status.phase not in (*ENDS, Phase.READY)
    return part("status", status, goes_on, goal)


def reached_html(stages: Mapping[str, Any], *, over: bool) -> str:
    """Return how far an episode came, and at its end the verdicts.

    Args:
        stages: As in lines of results; empty for nothing.
        over: Whether it is over.
    """
    if not stages:
        return ""
    verdicts = judged(stages) if over else {}
    return part("reached", stages["progress"], reached_words(stages), verdicts)


def why_html(explanation: Explanation, instance: Instance) -> str:
    """Return why a policy decided as it did: its options, and who reaches what.

    Args:
        explanation: Of one decision; the result is empty where the policy said nothing.
        instance: Of the robots and objects.
    """
    insight = explanation.insight
    if insight is None:
        return ""
    options = []
    for subtask, share in insight.options:
        if share >= _LEAST_SHARE or subtask is insight.options[0][0]:
            words = "stop: the goal is reached"
            if subtask.primitive is not Primitive.STOP:
                words = describe_subtask(subtask, instance)
            options.append((share, words))
    named = {name for pair in insight.goal for name in pair}
    reaches = [
        (
            entity_named(thing.name).phrase,
            [robot.margin_m(thing.at) for robot in insight.robots],
        )
        for thing in insight.objects
        if thing.name in named
    ]
    not_seen = sorted(named - {thing.name for thing in insight.objects})
    phrases = {name: entity_named(name).phrase for name in not_seen}
    covers = dict(explanation.covers)
    hidden = [
        (entity_named(covers[name]).phrase, phrases.pop(name))
        for name in not_seen
        if name in covers
    ]
    robots, unseen = robot_phrases(instance.scene.robots), [*phrases.values()]
    return part("why", options, robots, reaches, hidden, unseen)
