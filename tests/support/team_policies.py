"""Robots that decide alone, for tests."""

from collections.abc import Sequence

from lemma.policies.together.interfaces import Choice, RobotInput
from lemma.tasks.subtask import STOP


class Waits:
    """Says how many robots it sees, and waits; the third time it stops."""

    def act_alone(self, inputs: Sequence[RobotInput]) -> list[Choice]:
        return [self.choose(given) for given in inputs]

    def choose(self, given: RobotInput) -> Choice:
        if given.time_s >= 2.0:
            return Choice(STOP)
        if given.time_s > 0.0:
            assert len(given.inbox) == len(given.robots) - 1
            return Choice()
        return Choice(message=f"{given.robot} {len(given.view.joints)}")
