"""A language model as planner: one question per decision, with a sub-task as answer."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.core.robot_names import robot_names
from lemma.policies.interfaces import (
    TIMEOUT_S,
    Composite,
    Decision,
    Effort,
    PolicyInput,
)
from lemma.policies.planners.answers import Answer, AnswerFormat, InvalidAnswerError
from lemma.policies.planners.cassette import Cassette
from lemma.policies.planners.chat import ChatOptions, Reply
from lemma.policies.planners.chat_client import ChatServer
from lemma.policies.planners.perception import (
    Perception,
    SceneText,
    SeenPerception,
    TruthPerception,
)
from lemma.policies.planners.prompts import (
    PROMPTS,
    correction,
    messages_of,
    pictures,
    question,
    system_prompt,
)
from lemma.tasks.subtask import STOP, SubTask

MALFORMED = "malformed"
"""Kind of failure of a model whose answers are all invalid."""
_LONGEST_MESSAGE = 500


class Asker:
    """A source of replies: a cassette, a server, or both."""

    def __init__(self, options: ChatOptions, timeout_s: float) -> None:
        """Prepare the sources, without reading or sending anything.

        Args:
            options: Server and cassette.
            timeout_s: Time limit of one attempt at a request [s].

        Raises:
            InvalidConfigError: There is neither a server nor a cassette.
        """
        self.mode = options.cassette_mode
        self.cassette = Cassette(options.cassette) if options.cassette else None
        self.server = None
        if options.base_url:
            self.server = ChatServer(
                options.base_url, timeout_s, concurrency=options.concurrency
            )
        if self.cassette is None and (self.server is None or self.mode != "record"):
            raise InvalidConfigError(
                "The language model has no source of answers. Name a server with "
                "--base-url http://HOST:PORT/v1, or a --cassette that has the answers."
            )

    def ask(self, request: Mapping[str, Any]) -> Reply:
        """Return the reply to a request.

        Raises:
            PlannerUnavailableError: The reply is not on the cassette, and there is no
                server, it must not be used, or it does not answer.
            DatasetError: The cassette is damaged, or cannot be written.
        """
        cassette, strict = self.cassette, self.mode == "strict"
        known = cassette.find(request) if cassette else None
        if known is not None:
            return known
        if cassette is not None and (strict or self.server is None):
            why = "No --base-url is named."
            raise cassette.missing(
                request, "In strict mode nobody is asked." if strict else why
            )
        assert self.server is not None
        reply = self.server.ask(request)
        if cassette is None or self.mode != "record":
            return reply
        return cassette.keep(request, reply)


@dataclass
class _Tally:
    """Replies and invalid answers of a decision so far."""

    replies: list[Reply] = field(default_factory=list)
    invalid: list[str] = field(default_factory=list)

    def effort(self) -> Effort:
        asked = sum(reply.prompt_tokens for reply in self.replies)
        said = sum(reply.completion_tokens for reply in self.replies)
        return Effort(len(self.replies), asked, said, tuple(self.invalid))


class _GaveUpError(Exception):
    """The model gave no decision: kind of failure and explanation."""

    def __init__(self, kind: str, explanation: str) -> None:
        super().__init__(explanation)
        self.kind = kind


class LanguageModelPlanner(Composite):
    """A planner that queries a language model.

    Each decision is a separate conversation, which depends only on the input: the
    rules, and the instruction, the scene and the past as text. After an invalid answer
    the model gets the reason and tries again.
    """

    reads_outcomes = True

    def __init__(
        self,
        model: str,
        options: ChatOptions,
        timeout_s: float = TIMEOUT_S,
        perception: Perception | None = None,
    ) -> None:
        """Prepare the planner, without sending anything.

        Args:
            model: Name of the model at the server.
            options: Options of the requests.
            timeout_s: Time limit of one attempt at a request [s].
            perception: Describes the scene; chosen by the options if None.

        Raises:
            InvalidConfigError: The name is empty, or there is no source of replies.
        """
        if not model:
            raise InvalidConfigError(
                "The name of the language model is empty. Write llm:MODEL, with the "
                "model's name at its server."
            )
        source = SeenPerception if options.perception == "seen" else TruthPerception
        self.perception: Perception = perception or source()
        self.cameras = options.pictures
        self.about = {"model": model, "prompts": PROMPTS, **options.settings()}
        self._model = model
        self._options = options
        self._asker = Asker(options, timeout_s)

    @property
    def parts(self) -> tuple[object, ...]:
        """Its perception."""
        return (self.perception,)

    @property
    def blind(self) -> bool:
        """Whether it needs no images."""
        return not self.cameras and isinstance(self.perception, TruthPerception)

    @property
    def weights(self) -> tuple[str, ...]:
        """Published weights that it uses."""
        return getattr(self.perception, "weights", ())

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        """Return the next sub-task of each episode.

        Raises:
            PlannerUnavailableError: The server does not answer.
            InvalidConfigError: The model gave no valid answer.
        """
        decided = self.propose(inputs)
        for decision in decided:
            if decision.failed:
                raise InvalidConfigError(decision.explanation)
        return [decision.subtask for decision in decided]

    def propose(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        """Return the next decision of each episode, without poses, with its effort.

        Raises:
            PlannerUnavailableError: The server does not answer.
        """
        scenes = self.perception.look(inputs)
        with ThreadPoolExecutor(min(self._options.concurrency, len(inputs))) as pool:
            return list(pool.map(self._decide, inputs, scenes))

    def _decide(self, policy_input: PolicyInput, scene: SceneText) -> Decision:
        tally = _Tally()
        try:
            subtask, reason = self._ask_team(policy_input, scene, tally)
            # Words of a stop say what a policy refuses; others are of failures.
            why = reason if subtask == STOP else ""
            return Decision(subtask, None, why, effort=tally.effort())
        except _GaveUpError as error:
            return Decision(
                STOP, None, str(error), failed=error.kind, effort=tally.effort()
            )

    def _ask_team(
        self, policy_input: PolicyInput, scene: SceneText, tally: _Tally
    ) -> tuple[SubTask, str]:
        """Query the planner of the team, or one robot after another until one acts.

        The first robot rotates from decision to decision.
        """
        team = robot_names(len(policy_input.robots))
        names = tuple(thing.name for thing in scene.objects)
        first = len(policy_input.past) % len(team)
        speakers: tuple[str, ...] = ("",)
        if self._options.team == "each":
            speakers = (*team[first:], *team[:first])
        messages: tuple[tuple[str, str], ...] = ()
        for robot in speakers:
            waits = robot != speakers[-1]
            own = (robot,) if robot else team
            answers = AnswerFormat(own, names, talks=bool(robot), may_wait=waits)
            text = question(policy_input, scene, robot, messages)
            said = self._converse(policy_input, answers, text, tally)
            if said.subtask is not None:
                return said.subtask, said.reason
            messages += ((robot, said.message[:_LONGEST_MESSAGE]),)
        raise AssertionError("the last one cannot wait")

    def _converse(
        self, policy_input: PolicyInput, answers: AnswerFormat, text: str, tally: _Tally
    ) -> Answer:
        """Query until an answer is valid.

        Raises:
            _GaveUpError: No answer was valid, or the server did not reply.
        """
        shown = pictures(policy_input) if self.cameras else []
        messages = messages_of(system_prompt(policy_input, answers), text, shown)
        reason = ""
        for _ in range(self._options.tries):
            reply = self._asker.ask(self._request(messages, answers))
            tally.replies.append(reply)
            if reply.failure:
                raise _GaveUpError(reply.failure, reply.explanation)
            try:
                return answers.read(reply.content)
            except InvalidAnswerError as error:
                tally.invalid.append(str(error.kind))
                why = f"{error} {reply.remark}".strip()
                reason = f"{error.kind}: {why}"
                messages = [
                    *messages,
                    # Some servers reject an empty turn.
                    {"role": "assistant", "content": reply.content or "(nothing)"},
                    {"role": "user", "content": correction(error.kind, why)},
                ]
        raise _GaveUpError(
            MALFORMED,
            f"The model gave {self._options.tries} answers that are no sub-task. The "
            f"last one: {reason}",
        )

    def _request(
        self, messages: list[dict[str, Any]], answers: AnswerFormat
    ) -> dict[str, Any]:
        request = {
            "model": self._model,
            "messages": messages,
            "temperature": 0,
            "seed": 0,
            "max_tokens": self._options.max_tokens,
            "response_format": {
                "type": "json_schema",
                "json_schema": {
                    "name": "sub_task",
                    "strict": True,
                    "schema": answers.schema(),
                },
            },
        } | self._options.fields
        return {name: value for name, value in request.items() if value is not None}
