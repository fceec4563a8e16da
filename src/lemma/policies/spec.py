"""Policies by name, as ``--policy`` takes them."""

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError, UnknownNameError
from lemma.core.registry import takes
from lemma.policies.class_path import (
    check_no_secret,
    checkpoint_of,
    class_of,
    instance_of,
    privileged,
)
from lemma.policies.compose import (
    MultiStep,
    PlannerWithGrounder,
    RetryingPlanner,
    RetryingPolicy,
)
from lemma.policies.control.interfaces import IS_CONTROL, has_options, is_model_server
from lemma.policies.control.oracle import ExpertControl
from lemma.policies.interfaces import (
    TIMEOUT_S,
    Grounder,
    Oracle,
    Planner,
    Policy,
    is_oracle,
)
from lemma.policies.oracle import (
    GroundTruthAllocation,
    OracleGrounder,
    OraclePlanner,
)
from lemma.policies.planners.chat import ChatOptions
from lemma.policies.planners.registry import asks_model, is_planner, make_planner
from lemma.policies.weights import load_model, published_weights

ORACLE = "oracle"
FOREVER_S = 1e6
"""Stands for no limit [s]."""
PLANNINGS = ("single-step", "multi-step")
ACTINGS = ("turns", "together")
"""Robots act one after the other; or several at the same time."""
TOGETHER = ACTINGS[1]
ADAPTERS = ("greedy", "turns")
"""How sequential policies give orders to a team, the default first."""
LEVELS = ("plan", "skill", "control")
"""A policy decides on sub-tasks in symbols, on sub-tasks with poses, or on motor
commands."""
CONTROL = LEVELS[2]
_OMITTED = {"level": "", "arguments": {}, "acting": ACTINGS[0], "adapter": ""}
"""Fields that are left out where they have these values."""
_CLASS = re.compile(r"[\w.]+:[^\W\d][\w.<>]*")
"""``package.module:Class``, also of a class within a function."""
Load = Callable[[str], Any]
"""Returns the planner, grounder or policy of a name."""


def parts_of(name: str) -> tuple[str, ...]:
    """Return a policy's name, or the names of its planner and its grounder.

    They are joined by a plus sign. A path, or the name of a language model, may have
    one of its own, so the name is parted where both sides are known; else where one
    side is; else where a single plus sign stands. An existing path, a checkpoint of
    LeRobot, and the name of a language model before anything unknown stay whole.

    Args:
        name: As ``--policy`` takes it.
    """
    if "+" not in name or checkpoint_of(name) is not None or Path(name).exists():
        return (name,)
    parted: list[tuple[str, ...]]
    places = [place for place, letter in enumerate(name) if letter == "+"]
    parted = [(name[:place], name[place + 1 :]) for place in reversed(places)]
    known = [(_is_known(first), _is_known(second)) for first, second in parted]
    if (True, True) in known:
        return parted[known.index((True, True))]
    if is_planner(name) and ":" in name:
        return (name,)
    for one in ((False, True), (True, False)):
        if one in known:
            return parted[known.index(one)]
    # Names from other machines: two plus signs in a row belong to one name.
    plain = [both for both in parted if both[0][-1:] != "+" and both[1][:1] != "+"]
    return (plain or [(name,)])[0]


def _is_known(part: str) -> bool:
    """Whether a part of a name means something, as far as that is seen by its form."""
    return (
        part == ORACLE
        or is_planner(part)
        or part in published_weights()
        or _CLASS.fullmatch(part) is not None
        or ("://" in part and "+" not in part)
        or (part != "" and Path(part).exists())
    )


@dataclass(frozen=True)
class PolicySpec:
    """Which policy, and how it plans; plain data, so that other processes can load it.

    ``name`` is one of

    - ``"oracle"``: the expert;
    - a model that plans and grounds: ``"reachnet"``, ``"m-cliport"``;
    - a planner and a grounder: ``"episodic-transformer+cliport"``;
    - a planner of :data:`lemma.policies.planners.registry.PLANNERS`, such as
      ``"greedy-reach"`` or ``"llm:MODEL"``, with a grounder or, alone, with the
      expert's poses;
    - anybody's own class: ``"package.module:Class"``, called with ``arguments``;
    - a policy that LeRobot trained: ``"lerobot:CHECKPOINT"``; one that is told the
      truth, ``"lerobot-privileged:CHECKPOINT"``;
    - a policy behind a socket: ``"http://127.0.0.1:8000"``;
    - a model server of vla-eval: ``"vla-eval://127.0.0.1:8001"``, whose ``arguments``
      choose the environment.

    Models are names of weights that ship, or paths of weights.
    """

    name: str = ORACLE
    planning: str = PLANNINGS[0]
    """``"single-step"``: looks before every sub-task; ``"multi-step"``: plans from the
    first image alone."""
    gta: bool = False
    """Whether the right robot replaces the one that the planner chose."""
    timeout_s: float = TIMEOUT_S
    """Time that a decision of somebody else's policy may take [s]; 0 for any time, in
    the same process."""
    chat: ChatOptions | None = None
    """How a language model is asked, if one is."""
    level: str = ""
    """``"control"`` if it answers motor commands; else its name tells the level."""
    arguments: tuple[tuple[str, Any], ...] = ()
    """Names and values that its class is called with."""
    acting: str = ACTINGS[0]
    """``"turns"``: one robot works at a time; ``"together"``: the policy gives orders
    to free robots, several of which work at once."""
    adapter: str = ""
    """How a sequential policy acts together, see :mod:`.together.adapters`: one of
    :data:`ADAPTERS`; empty for what can do so itself, and ``"greedy"`` otherwise."""

    def __post_init__(self) -> None:
        """Check the names and the time, and that its planners can be made."""
        check_no_secret(name for name, _ in self.arguments)
        self._check_level()
        self._check_acting()
        if self.planning not in PLANNINGS:
            raise UnknownNameError("way of planning", self.planning, PLANNINGS)
        if not 0.0 <= self.timeout_s < float("inf"):
            raise InvalidConfigError(
                f"A decision may take {self.timeout_s} s? Valid: a positive number, or "
                "0 for no limit."
            )
        if self.chat is not None and not any(map(asks_model, self.parts)):
            raise InvalidConfigError(
                f"{self.name} asks no language model, so there is no server and no "
                "cassette for it. Leave these options out, or name llm:MODEL."
            )
        for part in filter(self.is_planner, self.parts):
            self._planner(part)

    def _check_level(self) -> None:
        if self.level not in ("", CONTROL):
            raise UnknownNameError("level of a policy", self.level, (CONTROL,))
        if self.controls and (self.gta or self.planning != PLANNINGS[0]):
            raise InvalidConfigError(
                "Motor commands are no sub-tasks, so neither multi-step planning nor "
                "ground-truth allocation applies to them."
            )
        own = is_model_server(self.name) or (
            ":" in self.name and "://" not in self.name
        )
        if is_model_server(self.name) and len(self.parts) > 1:
            raise InvalidConfigError(
                f"{self.name} answers motor commands, so there is nothing to combine "
                "it with, nor another level. Name the address alone."
            )
        if self.arguments and (not own or any(map(self.is_planner, self.parts))):
            raise InvalidConfigError(
                f"{self.name} takes no arguments. Classes do, package.module:Class, "
                "and model servers, vla-eval://HOST:PORT."
            )

    def _check_acting(self) -> None:
        known("way of acting", self.acting, ACTINGS)
        if self.adapter:
            known("adapter", self.adapter, ADAPTERS)
        if self.together and self.controls:
            raise InvalidConfigError(
                "Motor commands are those of all robots already. Leave out acting."
            )
        if self.adapter and not self.together:
            raise InvalidConfigError(
                f"The adapter {self.adapter!r} is for policies that act together."
            )

    @property
    def together(self) -> bool:
        """Whether several robots may work at the same time."""
        return self.acting == TOGETHER

    @property
    def controls(self) -> bool:
        """Whether it answers motor commands."""
        known = is_model_server(self.name) or checkpoint_of(self.name) is not None
        return known or self.level == CONTROL

    def about(self) -> dict[str, Any]:
        """Return the fields that decide what it does; :meth:`planners` say more."""
        fields = {name: value for name, value in asdict(self).items() if name != "chat"}
        # As JSON has it: what is read back must be equal.
        fields["arguments"] = dict(self.arguments)
        return {
            name: value for name, value in fields.items() if value != _OMITTED.get(name)
        }

    def planners(self) -> list[Any]:
        """Return the planners of :data:`~lemma.policies.planners.registry.PLANNERS`.

        Raises:
            LemmaError: One cannot be made so.
        """
        return [self._planner(part) for part in self.parts if self.is_planner(part)]

    def is_planner(self, part: str) -> bool:
        """Whether a part is a name of a planner that is registered."""
        return is_planner(part)

    def _planner(self, part: str) -> Any:
        return make_planner(part, self.chat, self.timeout_s or FOREVER_S)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the policy, or of the planner and the grounder."""
        return parts_of(self.name)

    @property
    def blind(self) -> bool:
        """Whether it needs no images."""
        return all(
            part == ORACLE or getattr(self._object(part), "blind", False) is True
            for part in self.parts
        )

    def _object(self, part: str) -> object:
        """Return what a part means, where that is known without loading it."""
        return self._planner(part) if self.is_planner(part) else None

    @property
    def oracle(self) -> bool:
        """Whether some part of it is given the truth: results say so."""
        # A planner alone is given the expert's poses.
        alone = len(self.parts) == 1 and self.is_planner(self.name)
        return self.gta or alone or any(map(self._is_oracle, self.parts))

    def _is_oracle(self, part: str) -> bool:
        if part == ORACLE or privileged(part):
            return True
        if self.is_planner(part):
            return is_oracle(self._planner(part))
        # Other processes get no privileged state.
        if ":" not in part or "://" in part or self.timeout_s > 0.0:
            return False
        found = class_of(part)
        return isinstance(found, type) and issubclass(found, Oracle)

    def load(self, load: Load | None = None) -> Any:
        """Return the policy, ready to act.

        It is a :class:`Policy`; at control level, a
        :class:`~lemma.policies.control.interfaces.ControlPolicy`; where robots act
        together, a :class:`~lemma.policies.together.interfaces.TeamPolicy`.

        Args:
            load: Returns the planner, grounder or policy of a name; :func:`load_part`
                if None.

        Raises:
            InvalidConfigError: The name means no policy, or one that cannot plan in
                the way that is asked for.
            LemmaError: Its weights are missing or damaged.
        """
        if not self.together:
            return self.load_sequential(load)
        # A team policy may be made of a sequential one.
        from lemma.policies.together.loading import team_of  # noqa: PLC0415

        return team_of(self, load)

    def load_sequential(self, load: Load | None = None) -> Any:
        """Return the policy that acts in turns; see :meth:`load`."""
        first, *more = self.parts
        if self.controls:
            known = self.name == ORACLE
            found = ExpertControl() if known else self.part(self.name, load)
            problem = "is no policy at control level: it has no act(inputs)."
            return _able(found, Policy, f"{self.name} {problem}")
        if not (more or first == ORACLE or self.is_planner(first)):
            return self._whole(load)
        planner = OraclePlanner() if first == ORACLE else self.part(first, load)
        _able(planner, Planner, f"{first} cannot plan; it has no plan(inputs).")
        registered = self.is_planner(first)
        if registered and self.planning != PLANNINGS[0] and is_oracle(planner):
            raise InvalidConfigError(
                f"{first} is told how the table is before each sub-task, so it cannot "
                "plan from the first image alone. Leave out --planning."
            )
        last = more[0] if more else ORACLE
        grounder = OracleGrounder() if last == ORACLE else self.part(last, load)
        problem = "cannot ground; it has no ground(inputs, subtasks)."
        return self._compose(planner, _able(grounder, Grounder, f"{last} {problem}"))

    def part(self, name: str, load: Load | None) -> Any:
        """Return the planner, grounder or policy of a name."""
        if self.is_planner(name):
            return self._planner(name)
        return load(name) if load else load_part(name, dict(self.arguments))

    def _whole(self, load: Load | None) -> Policy:
        """Return a policy that is one part: an object that can act.

        Raises:
            InvalidConfigError: It cannot act, or not in the way that is asked for.
        """
        whole = self.part(self.name, load)
        if has_options(whole):
            raise InvalidConfigError(f"{self.name} {IS_CONTROL}")
        if self.gta or self.planning != PLANNINGS[0]:
            if can(whole, Planner) and can(whole, Grounder):
                return self._compose(whole, whole)
            raise InvalidConfigError(
                f"{self.name} does not plan in symbols, so neither multi-step "
                "planning nor ground-truth allocation applies to it."
            )
        problem = "is no whole policy: it has no act(inputs). Combine a planner with a "
        problem += "grounder, as in episodic-transformer+cliport."
        found: Policy = _able(whole, Policy, f"{self.name} {problem}")
        return found if _reads_outcomes(whole) else RetryingPolicy(found)

    def _compose(self, planner: Planner, grounder: Grounder) -> Policy:
        reads = _reads_outcomes(planner)
        if self.planning != PLANNINGS[0]:
            planner, reads = MultiStep(planner), False
        if not reads:
            planner = RetryingPlanner(planner)
        if self.gta:
            planner = GroundTruthAllocation(planner)
        return PlannerWithGrounder(planner, grounder)


def _reads_outcomes(part: object) -> bool:
    """Whether a planner or policy looks at how its sub-tasks ended; by default, yes."""
    return bool(getattr(part, "reads_outcomes", True))


_VERBS = {Planner: ("plan", 1), Grounder: ("ground", 2), Policy: ("act", 1)}
"""The method of each interface, and how many arguments it takes."""


def can(part: Any, interface: type[Any]) -> bool:
    """Return whether an object has the method of an interface.

    ``isinstance`` looks at names alone: agents of other libraries have an ``act`` too.
    """
    verb, arguments = _VERBS[interface]
    return takes(getattr(part, verb, None), arguments)


def _able(part: Any, interface: type[Any], otherwise: str) -> Any:
    """Return an object that has the method of an interface.

    Raises:
        InvalidConfigError: It has not, with a sentence that says so.
    """
    if not can(part, interface):
        raise InvalidConfigError(otherwise)
    return part


def load_part(name: str, arguments: Mapping[str, Any] | None = None) -> Any:
    """Return the planner, grounder or policy of a name.

    Args:
        name: Name of the policy or part.
        arguments: Arguments of its class.

    Raises:
        LemmaError: There is none, or its weights are missing or damaged.
    """
    return instance_of(name, arguments) if ":" in name else load_model(name)
