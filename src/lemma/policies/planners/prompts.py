"""Prompts of language models, word by word."""

import base64
import json
import unicodedata
from io import BytesIO
from typing import Any

from PIL import Image

from lemma.core.robot_names import robot_number
from lemma.policies.interfaces import PastStep, PolicyInput
from lemma.policies.planners.answers import NONE, WAIT, AnswerFormat
from lemma.policies.planners.perception import ObjectText, SceneText
from lemma.scene.objects.entity import SHARED
from lemma.tasks.language.relational import speaks_of_places
from lemma.tasks.subtask import Primitive

PROMPTS = 2
"""Version of these words: part of every result."""

_TASK = """\
Robot arms stand around a table. One sentence says what shall lie on what at the end, \
or what a hand shall hold or be over. You decide on the next sub-task; you will be \
asked again after it, until you say stop.

Rules
- x and y are in metres. Each robot has its place and never leaves it. It grasps \
things only where it reaches them, and lays them only where it reaches.
- A robot that is told to do what it cannot do stops for its protection, and the task \
has failed. So look at who reaches what.
- "{shared}" is a free place that every robot reaches. What one robot cannot bring to \
its end, it moves to "{shared}", and another takes it from there.
- One thing can be put on one other: a cube on a pad, or on a cube. Nothing else may \
lie on either.
- Say stop when the task is done. Stopping too early is a failure.
"""
_LOADS = """\
- A robot lifts nothing that weighs more than it carries. Weights are told where they \
are unusual; what has dark rims is heavy.
"""
_TOOLS = """\
- The stick brings what no robot reaches. Who reaches the stick uses it, and may move \
it to "{shared}" first for another. "prehook" lays the stick (pick) behind a cube \
(place), "hook" then drags the cube towards the robot. "prepoke" lays it before a \
cube, "poke" then pushes the cube away from the robot, to another. hook needs prehook \
right before, poke needs prepoke.
"""
_PLACES = """\
- The sentence names things by their places at the beginning, before anything was \
moved. Left is at smaller x and right at larger x, as on a map; near and far are \
distances along the table, for robots from where they stand. A thing is between two \
others if it is within 0.1 m of the line between them.
"""
_ANSWER = """\

Answer with one JSON object and nothing else:
{{"reason": one short sentence{message}, "robot": {robot}, "primitive": {primitive}, \
"pick": {pick}, "place": {place}}}
"move" picks a cube or the stick up (pick) and puts it down (place). "lift" picks a \
cube up and holds it, "reach" holds the open hand over it: pick and place are both \
that cube. For stop{wait}, \
robot, pick and place are "{none}".
"""
_EACH = """
You speak for {name} alone ("{phrase}"), and are told what it reaches. Other robots \
know what they reach; they are asked after you if you wait, and read your message.
"""


def system_prompt(policy_input: PolicyInput, answers: AnswerFormat) -> str:
    """Return the rules, and the form of an answer."""
    text = _TASK + (_LOADS if policy_input.hands else "")
    text += _TOOLS if answers.has_stick else ""
    names = {
        field: " or ".join(json.dumps(name) for name in valid)
        for field, valid in answers.names.items()
    }
    text += _PLACES if speaks_of_places(policy_input.instruction) else ""
    text = text.format(shared=SHARED)
    text += _ANSWER.format(
        message=', "message": to the other robots' if answers.talks else "",
        wait=f" and {WAIT}" if answers.may_wait else "",
        none=NONE,
        **names,
    )
    if answers.talks:
        name = answers.robots[0]
        text += _EACH.format(name=name, phrase=policy_input.robots[robot_number(name)])
    return text


def question(
    policy_input: PolicyInput,
    scene: SceneText,
    speaker: str = "",
    messages: tuple[tuple[str, str], ...] = (),
) -> str:
    """Return the sentence, the table and the past as text.

    Args:
        policy_input: Sentence and past.
        scene: The table.
        speaker: The robot that is asked; all robots if empty.
        messages: Messages of other robots about this decision: name and text.
    """
    lines = [f"Sentence: {quoted(policy_input.instruction)}", "", "Robots"]
    for robot in scene.robots:
        line = f"- {robot.name}, the {quoted(robot.phrase)}, at {_at(robot.x, robot.y)}"
        if speaker in ("", robot.name):
            near, far = robot.reach_m
            line += f", reaches from {near:.2f} to {far:.2f} m around it"
            if robot.carries_kg is not None:
                line += f", carries up to {robot.carries_kg:.1f} kg"
        lines.append(line)
    lines += ["", "Objects"]
    lines += [_line_of(thing, speaker) for thing in scene.objects]
    lines += [f"- {name} has fallen off the table: it is lost" for name in scene.lost]
    lines += ["", "So far"]
    lines += [_past(step) for step in policy_input.past] or ["- nothing was done yet"]
    if messages:
        lines += ["", "Messages"]
        lines += [f"- {name}: {quoted(text)}" for name, text in messages]
    lines += ["", "What is the next sub-task?"]
    return "\n".join(lines)


def _line_of(thing: ObjectText, speaker: str) -> str:
    if speaker:
        reach = "within your reach" if speaker in thing.within else "not in your reach"
    else:
        reach = f"reached by {' and '.join(thing.within) or 'no robot'}"
    state = f", {thing.state}" if thing.state else ""
    if thing.mass_kg is not None:
        state += f", weighs {thing.mass_kg:.1f} kg"
    return f"- {thing.name} at {_at(thing.x, thing.y)}{state}, {reach}"


def _at(x: float, y: float) -> str:
    # Adding 0.0 avoids "-0.00".
    return f"({round(x, 2) + 0.0:.2f}, {round(y, 2) + 0.0:.2f})"


def _past(step: PastStep) -> str:
    subtask = step.subtask
    if subtask.primitive is Primitive.STOP:
        return "- stop"
    why = f": {quoted(step.explanation)}" if step.explanation else ""
    return f"- {subtask}: {step.outcome}{why}"


def correction(kind: str, explanation: str) -> str:
    """Return the reply to an answer that is no sub-task."""
    return f"That is no valid answer ({kind}). {explanation} Answer again."


def quoted(text: str) -> str:
    """Return text of users as a JSON string that cannot be mistaken for a prompt.

    Line breaks, control and invisible characters and the brackets of markup and of
    chat templates are escaped: nothing in it begins a turn, a line or a picture.
    """
    return "".join(
        f"\\u{ord(c):04x}" if c in "<>[]`" or _is_hidden(c) else c
        for c in json.dumps(text, ensure_ascii=False)
    )


def _is_hidden(character: str) -> bool:
    return unicodedata.category(character) in ("Cc", "Cf", "Co", "Cs", "Zl", "Zp")


def messages_of(system: str, text: str, images: list[str]) -> list[dict[str, Any]]:
    """Return the beginning of a conversation.

    Args:
        system: The rules.
        text: The question.
        images: Pictures as data URLs.
    """
    content: Any = text
    if images:
        parts = [{"type": "image_url", "image_url": {"url": url}} for url in images]
        content = [{"type": "text", "text": text}, *parts]
    return [
        {"role": "system", "content": system},
        {"role": "user", "content": content},
    ]


def pictures(policy_input: PolicyInput) -> list[str]:
    """Return the images of the robots' cameras, as PNG data URLs in order of robots."""
    found = []
    for _, image in sorted(policy_input.view.cameras.items()):
        with BytesIO() as file:
            Image.fromarray(image.rgb).save(file, "png")
            data = base64.b64encode(file.getvalue()).decode()
        found.append(f"data:image/png;base64,{data}")
    return found
