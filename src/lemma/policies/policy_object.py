"""A policy that is an object of this process."""

from copy import deepcopy
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.policies.control.interfaces import has_options
from lemma.policies.interfaces import (
    Grounder,
    Planner,
    Policy,
    Proposer,
    is_oracle,
    keeps_state,
)
from lemma.policies.spec import (
    ACTINGS,
    CONTROL,
    LEVELS,
    ORACLE,
    PLANNINGS,
    Load,
    PolicySpec,
    can,
)


class PolicyObjectSpec(PolicySpec):
    """A policy that is an object of this process, not a name: no other one has it."""

    _held: object
    _as_it_was: object = None

    @classmethod
    def of(
        cls,
        held: object,
        level: str = "",
        planning: str = PLANNINGS[0],
        *,
        gta: bool = False,
        acting: str = ACTINGS[0],
        adapter: str = "",
    ) -> "PolicyObjectSpec":
        """Return the spec of an object.

        Args:
            held: A policy, or a planner.
            level: One of :data:`LEVELS`; a planner's sub-tasks get the expert's poses.
                By default what it can do; what has ``control_options`` controls.
            planning: How it plans.
            gta: Whether the right robot replaces the one that the planner chose.
            acting: One of :data:`~lemma.policies.spec.ACTINGS`.
            adapter: How a sequential policy acts together.

        Raises:
            InvalidConfigError: It is neither, or cannot plan in that way.
        """
        if isinstance(held, type):
            raise InvalidConfigError(
                f"{held.__name__} is a class, not a policy. Make an object of it: "
                f"{held.__name__}(...)."
            )
        kind = type(held)
        name = f"{kind.__module__}:{kind.__qualname__}"
        whole = can(held, Policy) or can(held, Grounder)
        controls = level == CONTROL or (not level and has_options(held))
        plans = level == LEVELS[0] or (not level and can(held, Planner) and not whole)
        if plans and not controls:
            name += f"+{ORACLE}"
        level = CONTROL if controls else ""
        found = cls(name, planning, gta, level=level, acting=acting, adapter=adapter)
        object.__setattr__(found, "_held", held)
        found.load()
        return found

    @property
    def oracle(self) -> bool:
        """Whether some part of it is given the truth: results say so."""
        return is_oracle(self.load())

    def part(self, name: str, load: Load | None) -> Any:
        """Return the object: names are not looked up."""
        return self._held

    def renew(self) -> None:
        """Hold a policy that remembers nothing: the first time itself, then copies.

        The copies are of what it was the first time. A policy that says that it keeps
        its state is left as it is.

        Raises:
            InvalidConfigError: It cannot be copied.
        """
        if keeps_state(self._held):
            return
        try:
            if self._as_it_was is None:
                object.__setattr__(self, "_as_it_was", deepcopy(self._held))
            else:
                object.__setattr__(self, "_held", deepcopy(self._as_it_was))
        except Exception as error:
            raise InvalidConfigError(
                f"A policy is made anew for each kind of instruction, and {self.name} "
                f"cannot be copied: {type(error).__name__}: {error}. Evaluate one kind "
                "at a time, name its class instead (package.module:Class), or, if it "
                "shall remember the episodes before, give it keeps_state = True."
            ) from error

    def is_planner(self, part: str) -> bool:
        """No: a module may have the name of a planner."""
        return False

    def planners(self) -> list[Any]:
        """Return the object, if it has more to say than others."""
        return [self._held] if isinstance(self._held, Proposer) else []

    def _object(self, part: str) -> object:
        return self._held

    # Two objects of one class are two policies.
    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        """Whether it is the same spec."""
        return self is other
