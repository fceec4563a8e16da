"""The expert as a policy at control level: its motion, as joint positions.

It shows that the level can be solved by actions of that kind.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from lemma.core.errors import InvalidConfigError
from lemma.env.control_env import ControlEnv
from lemma.expert.policy import MODE, JointMotion
from lemma.policies.control.interfaces import Actions, ControlInput
from lemma.policies.interfaces import Oracle


@dataclass(frozen=True, eq=False, kw_only=True)
class OracleControlInput(ControlInput):
    """Input of an oracle, with the truth."""

    env: ControlEnv = field(repr=False)
    """The environment itself, with its simulation."""


class ExpertControl(Oracle):
    """Answers the motion of the expert's next sub-task as one chunk."""

    control_options: ClassVar[Mapping[str, object]] = {
        "control": MODE,
        "control_hz": 20.0,
        "observation": "state",
    }

    def act(self, inputs: Sequence[ControlInput]) -> list[Actions]:
        """Return a chunk of actions for each episode.

        Raises:
            InvalidConfigError: The inputs come without the truth.
        """
        return [self._act(given) for given in inputs]

    def _act(self, given: ControlInput) -> Actions:
        if not isinstance(given, OracleControlInput):
            raise InvalidConfigError("The expert is given no truth, but needs it.")
        motion = given.memory or JointMotion(given.env)
        return Actions(motion.next_chunk(), motion)
