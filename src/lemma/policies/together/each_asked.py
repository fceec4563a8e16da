"""A decentralised team: each robot decides alone when it is free."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lemma.core.robot_names import robot_names
from lemma.policies.interfaces import Composite, Decision
from lemma.policies.together.interfaces import (
    LONGEST_MESSAGE,
    Choice,
    Message,
    Orders,
    RobotInput,
    RobotPolicy,
    TeamInput,
    decision_of,
)


@dataclass(frozen=True)
class EachAsked(Composite):
    """A team whose free robots decide one after another, each from its own view."""

    policy: RobotPolicy

    asks_robots = True

    def act_together(self, inputs: Sequence[TeamInput]) -> list[Orders]:
        """Return the free robots' own orders and their messages.

        Raises:
            ValueError: A robot gives an order to another one, or a message is invalid.
        """
        decisions: list[list[Decision]] = [[] for _ in inputs]
        messages: list[list[Message]] = [[] for _ in inputs]
        for name in robot_names(max(len(team_input.robots) for team_input in inputs)):
            asked = [
                i
                for i, team_input in enumerate(inputs)
                if name in team_input.free and not any(d.stops for d in decisions[i])
            ]
            if not asked:
                continue
            answers = self.policy.act_alone(
                [_own(inputs[i], name, messages[i]) for i in asked]
            )
            for i, answer in zip(asked, answers, strict=True):
                choice = answer if isinstance(answer, Choice) else Choice(answer)
                if choice.order is not None:
                    decisions[i].append(_checked(choice.order, name))
                if choice.message:
                    text = _text(choice.message)
                    messages[i].append(Message(name, text, inputs[i].time_s))
        return [
            Orders(tuple(orders), tuple(said))
            for orders, said in zip(decisions, messages, strict=True)
        ]


def asks_robots(policy: object) -> bool:
    """Return whether a policy needs each robot's own view."""
    parts = policy.parts if isinstance(policy, Composite) else ()
    return getattr(policy, "asks_robots", False) is True or any(map(asks_robots, parts))


def _own(team_input: TeamInput, robot: str, new: Sequence[Message]) -> RobotInput:
    """Return the input of a robot."""
    return RobotInput(
        team_input.instruction,
        team_input.robots,
        team_input.own_views[robot],
        tuple(step for step in team_input.past if step.subtask.robot == robot),
        robot=robot,
        time_s=team_input.time_s,
        inbox=tuple(
            message
            for message in (*team_input.messages, *new)
            if message.robot != robot
        ),
    )


def _checked(order: Any, robot: str) -> Decision:
    decision = decision_of(order)
    name = getattr(getattr(decision, "subtask", None), "robot", robot)
    if name not in (robot, ""):
        raise ValueError(f"{robot} gave an order to {name}; each orders itself alone")
    return decision


def _text(message: object) -> str:
    if not isinstance(message, str) or len(message) > LONGEST_MESSAGE:
        raise ValueError(
            f"a message is text of up to {LONGEST_MESSAGE} characters, not "
            f"{message!r:.40}"
        )
    return message
