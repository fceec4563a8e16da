"""Specification of a policy that is an object of this process."""

from copy import deepcopy
from typing import Any

from lemma.core.errors import InvalidConfigError
from lemma.policies.control.interfaces import has_options
from lemma.policies.interfaces import (
    Grounder,
    Planner,
    Policy,
    Proposer,
    can,
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
)


class PolicyObjectSpec(PolicySpec):
    """A policy that is an object of this process, so others cannot load it by name."""

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
                By default it follows from the object's methods; an object with
                ``control_options`` is of level ``control``.
            planning: One of :data:`PLANNINGS`.
            gta: Whether ground-truth allocation replaces the planner's robots.
            acting: One of :data:`~lemma.policies.spec.ACTINGS`.
            adapter: Adapter of a sequential policy whose robots act together.

        Raises:
            InvalidConfigError: The object is neither a policy nor a planner, or cannot
                plan in that way.
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
        """Whether a part of the policy gets privileged state."""
        return is_oracle(self.load())

    def part(self, name: str, load: Load | None) -> Any:
        """Return the object; the name is not looked up."""
        return self._held

    def renew(self) -> None:
        """Replace the policy by a copy of its initial state.

        The first call keeps the object and stores the copy. A policy with
        ``keeps_state = True`` is not replaced.

        Raises:
            InvalidConfigError: The object cannot be copied.
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
        """Return False: the name is that of an object, even if a planner has it too."""
        return False

    def planners(self) -> list[Any]:
        """Return the object if it is a :class:`~.interfaces.Proposer`."""
        return [self._held] if isinstance(self._held, Proposer) else []

    def _object(self, part: str) -> object:
        return self._held

    # Identity: two objects of one class are different policies.
    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        """Return whether the other is the same spec object."""
        return self is other
