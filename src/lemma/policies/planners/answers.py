"""Answers of language models: a JSON schema of the table, and its check."""

import json
import re
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

from lemma.planning.primitives import PRIMITIVES
from lemma.scene.objects.entity import SHARED, STICK, is_carried, kind_of
from lemma.tasks.subtask import STOP, Primitive, SubTask

NONE = "none"
"""Value for no robot and no object."""
WAIT = "wait"
"""Primitive with which a robot leaves the decision to another robot."""
_FIELDS = ("reason", "robot", "primitive", "pick", "place")
_SHOWN = 80
_MOST_THOUGHTS = 50
_BLANKS = "\ufeff \t\r\n"
_LANGUAGE = re.compile(r"^\w*")


class InvalidAnswer(StrEnum):
    """Kinds of invalid answers."""

    NO_JSON = "no_json"
    """The answer is not JSON."""
    NOT_IN_SCHEMA = "not_in_schema"
    """The answer is JSON that does not match the schema."""
    UNKNOWN_NAME = "unknown_name"
    """The answer names an unknown robot, primitive or object."""
    IMPOSSIBLE = "impossible"
    """The sub-task is never possible: it hooks with a cube, or moves a pad."""


@dataclass(frozen=True, slots=True)
class Answer:
    """A valid answer."""

    subtask: SubTask | None
    """The sub-task; None to wait."""
    message: str = ""
    """Message to the other robots."""
    reason: str = ""
    """Its words for it."""


class InvalidAnswerError(Exception):
    """An invalid answer."""

    def __init__(self, kind: InvalidAnswer, explanation: str) -> None:
        """Store kind and explanation.

        Args:
            kind: Kind of the invalid answer.
            explanation: One sentence for the model.
        """
        super().__init__(explanation)
        self.kind = kind


@dataclass(frozen=True)
class AnswerFormat:
    """The format of valid answers in a scene."""

    robots: tuple[str, ...]
    """Robots that the answer may name."""
    objects: tuple[str, ...]
    """Names of the entities on the table."""
    talks: bool = False
    """Whether answers have a message to the other robots."""
    may_wait: bool = False
    """Whether the robot may leave the decision to another one."""

    @property
    def cargo(self) -> tuple[str, ...]:
        """Objects that can be moved, without the stick."""
        return tuple(name for name in self.objects if kind_of(name).cargo)

    @property
    def has_stick(self) -> bool:
        """Whether there is a stick."""
        return STICK in self.objects

    @cached_property
    def primitives(self) -> tuple[str, ...]:
        """Valid primitives. Some need a stick, some an object that two robots hold."""
        joint = {
            Primitive.CARRY: any(map(is_carried, self.objects)),
            Primitive.GIVE: any(kind_of(name).ends for name in self.objects),
        }
        usable = (
            name
            for name in PRIMITIVES
            if (self.has_stick or not PRIMITIVES[name].tool)
            and joint.get(Primitive(name), True)
        )
        return (*usable, *([WAIT] if self.may_wait else []))

    @property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Valid values of each field."""
        movable = (name for name in self.objects if not kind_of(name).fixed)
        return {
            "robot": (*self.robots, NONE),
            "primitive": self.primitives,
            "pick": (*movable, NONE),
            "place": (*self.objects, SHARED, NONE),
        }

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema of an answer."""
        text = {"type": "string"}
        fields: dict[str, Any] = {
            "reason": text,
            **{n: {"type": "string", "enum": list(e)} for n, e in self.names.items()},
        }
        if self.talks:
            fields["message"] = text
        return {
            "type": "object",
            "properties": fields,
            "required": list(fields),
            "additionalProperties": False,
        }

    def every_subtask(self) -> list[SubTask]:
        """Return ``stop`` and every possible sub-task."""
        names = self.names
        primitives = [n for n in self.primitives if n not in (Primitive.STOP, WAIT)]
        every = (
            SubTask(robot, Primitive(name), pick, place)
            for robot in self.robots
            for name in primitives
            for pick in names["pick"]
            for place in names["place"]
            if NONE not in (pick, place)
        )
        return [STOP, *(one for one in every if not self.why_not(one))]

    def read(self, text: str) -> Answer:
        """Return the answer in a text.

        Raises:
            InvalidAnswerError: The text is no valid answer in this scene.
        """
        answer = _parsed(text)
        wanted = {*_FIELDS, *(["message"] if self.talks else [])}
        if not isinstance(answer, dict):
            raise _not_in_schema("It is no JSON object.")
        # Models without a schema write null for "none" and for empty texts.
        for field in ("robot", "pick", "place"):
            if field in answer and answer[field] in (None, ""):
                answer[field] = NONE
        for field in ("reason", "message"):
            if answer.get(field, "") is None:
                answer[field] = ""
        # Servers without support of schemas may omit these optional fields.
        missing = sorted(wanted - {"reason", "message"} - set(answer))
        if missing:
            raise _not_in_schema(f"It lacks {', '.join(missing)}.")
        more = sorted(map(str, set(answer) - wanted))
        if more:
            raise _not_in_schema(f"It has {', '.join(more)[:_SHOWN]} too many.")
        for field in sorted(answer):
            if not isinstance(answer[field], str):
                raise _not_in_schema(f"{field} is no string.")
        for field, names in self.names.items():
            if answer[field] not in names:
                raise InvalidAnswerError(
                    InvalidAnswer.UNKNOWN_NAME,
                    f"{field} is {json.dumps(answer[field][:_SHOWN])}. "
                    f"Valid: {', '.join(names)}.",
                )
        said = (answer.get(field, "") for field in ("message", "reason"))
        return Answer(self._subtask(answer), *said)

    def _subtask(self, answer: dict[str, str]) -> SubTask | None:
        if answer["primitive"] == WAIT:
            return None
        primitive = Primitive(answer["primitive"])
        if primitive is Primitive.STOP:
            return STOP
        for field in ("robot", "pick", "place"):
            if answer[field] == NONE:
                raise InvalidAnswerError(
                    InvalidAnswer.IMPOSSIBLE,
                    f"{primitive} needs a {field}, not {NONE}.",
                )
        subtask = SubTask(answer["robot"], primitive, answer["pick"], answer["place"])
        why = self.why_not(subtask)
        if why:
            raise InvalidAnswerError(InvalidAnswer.IMPOSSIBLE, why)
        return subtask

    def why_not(self, subtask: SubTask) -> str:
        """Return why a sub-task is never possible, one sentence; empty if it may be."""
        primitive, pick, place = subtask.primitive, subtask.pick, subtask.place
        if PRIMITIVES[primitive].tool:
            if pick != STICK:
                return f"{primitive} is done with the stick: pick must be {STICK}."
            if place not in self.cargo:
                return f"{primitive} acts on one of {', '.join(self.cargo)}: place."
            return ""
        if primitive in (Primitive.REACH, Primitive.LIFT):
            same = pick == place and kind_of(pick).cargo
            return "" if same else f"{primitive} acts on one cube: pick and place."
        if primitive is not Primitive.MOVE:
            return ""
        if pick == STICK:
            return (
                "" if place == SHARED else f"The stick can be moved to {SHARED} only."
            )
        if place == pick:
            return f"The {pick} cannot be put on itself."
        if place != SHARED and kind_of(place).support_m is None:
            return f"Nothing can be put on the {place}."
        return ""


_END_OF_THOUGHTS = re.compile(
    r"</(?:\w+:)?(?:think|thinking|thoughts?|reasoning|analysis)\s*>"
    r"|\[/THINK(?:ING)?\]|◁/think▷|<channel\|>"
    r"|<\|(?:/think|end_of_thought|END_THINKING|inner_suffix)\|>"
    r"|<\|channel\|>\s*final[^{]{0,80}?<\|message\|>|assistantfinal(?:\s*json)?"
    r"|Here is my response:",
    re.IGNORECASE,
)
"""Marks of many language models at the end of their reasoning."""
_MARK = r"(?:<\|\w+\|>|</?(?:s|answer|response|final|output)>|<(?:end_of_turn|eos)>)"
_MARKS_BEFORE = re.compile(rf"(?:{_MARK}\s*)+", re.IGNORECASE)
_MARKS_AFTER = re.compile(rf"(?:{_MARK}\s*)+$", re.IGNORECASE)
_MARKS_LENGTH = 100


def _parsed(text: str) -> Any:
    """Return the JSON of an answer, without reasoning before it and markup around."""
    ends = [0, *(match.end() for match in _END_OF_THOUGHTS.finditer(text))]
    for end in ends[:_MOST_THOUGHTS]:
        bare = _bare(text[end:])
        try:
            # Line breaks within strings are invalid JSON, but unambiguous.
            return json.loads(bare, strict=False)
        except (ValueError, RecursionError):
            continue
    raise InvalidAnswerError(
        InvalidAnswer.NO_JSON,
        "It is empty." if not bare else "It is no JSON, or something is around it.",
    )


def _bare(text: str) -> str:
    """Return a text without the marks of chat templates and a code fence around it."""
    text = text.strip(_BLANKS)
    if before := _MARKS_BEFORE.match(text):
        text = text[before.end() :]
    if after := _MARKS_AFTER.search(text[-_MARKS_LENGTH:]):
        text = text[: len(text) - len(after[0])]
    text = text.strip(_BLANKS)
    if text.startswith(("```", "~~~")):
        text = _LANGUAGE.sub("", text.strip("`~"), count=1)
    return text.strip(_BLANKS)


def _not_in_schema(why: str) -> InvalidAnswerError:
    return InvalidAnswerError(InvalidAnswer.NOT_IN_SCHEMA, why)
