"""Texts of the panel as HTML; sentences of users and policies are escaped."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from markupsafe import Markup

from lemma.scene.objects.entity import entity_named
from lemma.tasks.instance import Instance
from lemma.tasks.language.bank import robot_phrases
from lemma.tasks.subtask import Primitive, SubTask
from lemma.viewer.episode.play import Play
from lemma.viewer.episode.reading import Explanation
from lemma.viewer.episode.status import ENDS, Phase, Status, say_goal
from lemma.viewer.episode.team_play import TeamPlay
from lemma.viz.annotate import ROBOT_INK
from lemma.viz.gantt import gantt_svg
from lemma.viz.pages.templates import macro
from lemma.viz.recording import describe_subtask, judged, reached_words

part = partial(macro, "panel.html")
"""Returns a part of the panel as HTML, from the macro of a name."""
_LEAST_SHARE = 0.01
_AXIS_S, _AXIS_STEP_S = 20.0, 10.0
"""Least length of a chart's axis and step of its growth, in simulated time [s]."""


def status_html(status: Status) -> str:
    """Return the sentence, its reading, and the status."""
    goal = say_goal(status.reading.pairs or ()) if status.reading else ""
    goes_on = status.phase not in (*ENDS, Phase.READY)
    return part("status", status, goes_on, goal)


def reached_html(stages: Mapping[str, Any], *, over: bool) -> str:
    """Return the progress of an episode, and at its end the verdicts.

    Args:
        stages: Stages as in lines of results; empty if unknown.
        over: Whether the episode is over.
    """
    if not stages:
        return ""
    verdicts = judged(stages) if over else {}
    return part("reached", stages["progress"], reached_words(stages), verdicts)


def chart_html(play: Play, now_s: float) -> str:
    """Return the Gantt chart of an episode up to now.

    Args:
        play: The episode.
        now_s: Simulated time of the cursor [s].
    """
    lines, watch, latest = play.status.lines, play.watch, play.transport.latest
    instance = play.instance
    if instance is None or watch is None or latest is None:
        return ""
    end_s, over = latest[0], play.transport.over
    lines = tuple(
        line if line.end_s is not None else line.watched(watch, end_s) for line in lines
    )
    if over:
        # Leave out the rest at the end, in which the episode is judged.
        end_s = max((line.end_s or 0.0 for line in lines), default=end_s)
    # Grow the axis in steps, so that bars do not shrink all the time.
    axis_s = 0.0 if over else max(_AXIS_S, _AXIS_STEP_S * -(-end_s // _AXIS_STEP_S))
    # Policies that take turns have no known plan.
    todo = play.todo if isinstance(play, TeamPlay) else None
    chart = gantt_svg(
        instance,
        lines,
        end_s,
        now_s=now_s,
        axis_s=axis_s,
        todo=() if over else todo,
    )
    return part("chart", Markup(chart)) if chart else ""


def order_words(subtask: SubTask, instance: Instance) -> str:
    """Return an order as text, without its robot: ``"move the red cube ..."``."""
    return describe_subtask(subtask, instance).partition(": ")[2]


def team_html(play: TeamPlay) -> str:
    """Return the present activity of each robot of a team.

    Args:
        play: An episode in which all robots act at once.
    """
    instance = play.instance
    if instance is None:
        return ""
    running = {
        line.subtask.robot: line.subtask
        for line in play.status.lines
        if line.subtask is not None and line.end_s is None
    }
    scene, rows = instance.scene, []
    for placed, name, said in zip(
        scene.robots, scene.robot_names, robot_phrases(scene.robots), strict=True
    ):
        doing = running.get(name)
        words = "free" if doing is None else order_words(doing, instance)
        ink = "rgb({}, {}, {})".format(*ROBOT_INK[placed.color])
        rows.append((ink, said, words, name in play.visitor_led))
    return part("team", rows)


def why_html(explanation: Explanation, instance: Instance) -> str:
    """Return the reasons of a decision: the options, and the robots' reach.

    Args:
        explanation: The explanation; without insight the result is empty.
        instance: The instance with the robots and objects.
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
