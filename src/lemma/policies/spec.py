"""Policies by name, as ``--policy`` takes them."""

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lemma.core.arguments import known
from lemma.core.errors import InvalidConfigError, UnknownNameError
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
    can,
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
"""Timeout that stands for no limit [s]."""
PLANNINGS = ("single-step", "multi-step")
ACTINGS = ("turns", "together")
"""Robots act one after the other; or several at the same time."""
TOGETHER = ACTINGS[1]
DEVICES = ("cpu", "cuda")
"""Devices of models, the default first."""
ADAPTERS = ("greedy", "turns")
"""Adapters of sequential policies to robots that act together, the default first."""
LEVELS = ("plan", "skill", "control")
"""A policy decides on symbolic sub-tasks, on sub-tasks with poses, or on motor
commands."""
CONTROL = LEVELS[2]
_OMITTED = {"level": "", "arguments": {}, "acting": ACTINGS[0], "adapter": ""}
"""Defaults; results leave out fields with these values."""
_CLASS = re.compile(r"[\w.]+:[^\W\d][\w.<>]*")
"""``package.module:Class``, also of a class within a function."""
Load = Callable[[str], Any]
"""Returns the planner, grounder or policy of a name."""


def parts_of(name: str) -> tuple[str, ...]:
    """Split a policy's name into the names of its planner and its grounder.

    The names are joined by a plus sign, which paths and names of language models may
    contain, too. So the name is split at a plus sign with known names on both sides;
    otherwise with a known name on one side; otherwise at the only plus sign. An
    existing path, a LeRobot checkpoint, and the name of a language model before an
    unknown part are not split.

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
    # Two plus signs in a row belong to one name, as in names from other machines.
    plain = [both for both in parted if both[0][-1:] != "+" and both[1][:1] != "+"]
    return (plain or [(name,)])[0]


def _is_known(part: str) -> bool:
    """Return whether a part of a name is known or has the form of a known name."""
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
    """A policy's name and options: plain data, so that other processes can load it.

    ``name`` is one of

    - ``"oracle"``: the expert;
    - a model that plans and grounds: ``"reachnet"``, ``"m-cliport"``;
    - a planner and a grounder: ``"episodic-transformer+cliport"``;
    - a planner of :data:`lemma.policies.planners.registry.PLANNERS`, such as
      ``"greedy-reach"`` or ``"llm:MODEL"``, with a grounder or, alone, with the
      expert's poses;
    - a class of your own: ``"package.module:Class"``, called with ``arguments``;
    - a policy that LeRobot trained: ``"lerobot:CHECKPOINT"``; one with privileged
      state, ``"lerobot-privileged:CHECKPOINT"``;
    - a policy server: ``"http://127.0.0.1:8000"``;
    - a model server of vla-eval: ``"vla-eval://127.0.0.1:8001"``, whose ``arguments``
      choose the environment.

    Models are names of published weights, or paths of weights.
    """

    name: str = ORACLE
    planning: str = PLANNINGS[0]
    """``"single-step"``: an image before every sub-task; ``"multi-step"``: a plan from
    the first image alone."""
    gta: bool = False
    """Whether ground-truth allocation replaces the robots that the planner chose."""
    timeout_s: float = TIMEOUT_S
    """Time limit for a decision of an external policy [s]; 0 for no limit, and then the
    policy runs in this process."""
    chat: ChatOptions | None = None
    """Options of requests to a language model, if it is one."""
    level: str = ""
    """``"control"`` for motor commands; otherwise the name determines the level."""
    arguments: tuple[tuple[str, Any], ...] = ()
    """Names and values of the arguments of its class."""
    acting: str = ACTINGS[0]
    """``"turns"``: one robot works at a time; ``"together"``: the policy decides for
    each free robot, and several robots work at once."""
    adapter: str = ""
    """Adapter of a sequential policy that acts together, one of :data:`ADAPTERS`; see
    :mod:`.together.adapters`. If empty, ``"greedy"`` for policies that need one."""
    device: str = DEVICES[0]
    """Device of the models, one of :data:`DEVICES`. Other policies choose their own."""

    def __post_init__(self) -> None:
        """Check the names and the time limit, and create its planners."""
        check_no_secret(name for name, _ in self.arguments)
        self._check_level()
        self._check_acting()
        known("way of planning", self.planning, PLANNINGS)
        known("device", self.device, DEVICES)
        if not 0.0 <= self.timeout_s < float("inf"):
            raise InvalidConfigError(
                f"The time limit of a decision is {self.timeout_s} s. Valid: a "
                "positive number, or 0 for no limit."
            )
        if self.chat is not None and not any(map(asks_model, self.parts)):
            raise InvalidConfigError(
                f"{self.name} uses no language model, so it needs no server and no "
                "cassette. Leave these options out, or name llm:MODEL."
            )
        for part in filter(self.is_planner, self.parts):
            self._planner(part)

    def _check_level(self) -> None:
        if self.level not in ("", CONTROL):
            raise UnknownNameError("level of a policy", self.level, (CONTROL,))
        if self.controls and (self.gta or self.planning != PLANNINGS[0]):
            raise InvalidConfigError(
                "Motor commands allow neither multi-step planning nor ground-truth "
                "allocation, which apply to sub-tasks. Leave out these options."
            )
        own = is_model_server(self.name) or (
            ":" in self.name and "://" not in self.name
        )
        if is_model_server(self.name) and len(self.parts) > 1:
            raise InvalidConfigError(
                f"{self.name} returns motor commands. It cannot be combined with a "
                "grounder, and has no other level. Name the address alone."
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
                "Motor commands are for all robots anyway. Leave out acting."
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
        """Whether it returns motor commands."""
        known = is_model_server(self.name) or checkpoint_of(self.name) is not None
        return known or self.level == CONTROL

    def about(self) -> dict[str, Any]:
        """Return the fields that determine its behavior, as plain data for results.

        The device is none of them: it changes the last bits of a network's output.
        """
        fields = asdict(self)
        del fields["chat"], fields["device"]
        # A dictionary, so that the data equal what is read back from JSON.
        fields["arguments"] = dict(self.arguments)
        return {
            name: value for name, value in fields.items() if value != _OMITTED.get(name)
        }

    def planners(self) -> list[Any]:
        """Return the planners of :data:`~lemma.policies.planners.registry.PLANNERS`.

        Raises:
            LemmaError: A planner cannot be created with these options.
        """
        return [self._planner(part) for part in self.parts if self.is_planner(part)]

    def is_planner(self, part: str) -> bool:
        """Return whether a part is the name of a registered planner."""
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
        """Return the object or class of a part, if it is known without loading."""
        return self._planner(part) if self.is_planner(part) else None

    @property
    def oracle(self) -> bool:
        """Whether a part of the policy gets privileged state."""
        # A planner without a grounder gets the expert's poses.
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
        # A late import: team policies are built from sequential ones.
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
                f"{first} reads the state of the table before each sub-task, so it "
                "cannot plan from the first image alone. Leave out --planning."
            )
        last = more[0] if more else ORACLE
        grounder = OracleGrounder() if last == ORACLE else self.part(last, load)
        problem = "cannot ground; it has no ground(inputs, subtasks)."
        return self._compose(planner, _able(grounder, Grounder, f"{last} {problem}"))

    def part(self, name: str, load: Load | None) -> Any:
        """Return the planner, grounder or policy of a name."""
        if self.is_planner(name):
            return self._planner(name)
        if load:
            return load(name)
        return load_part(name, dict(self.arguments), self.device)

    def _whole(self, load: Load | None) -> Policy:
        """Return a policy with one part, an object with ``act``.

        Raises:
            InvalidConfigError: It has no ``act``, or does not support the options.
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
    """Return whether a planner or policy reads outcomes; yes by default."""
    return bool(getattr(part, "reads_outcomes", True))


def _able(part: Any, interface: type[Any], otherwise: str) -> Any:
    """Return an object that has the method of an interface.

    Raises:
        InvalidConfigError: It lacks the method; the message is ``otherwise``.
    """
    if not can(part, interface):
        raise InvalidConfigError(otherwise)
    return part


def load_part(
    name: str, arguments: Mapping[str, Any] | None = None, device: str = DEVICES[0]
) -> Any:
    """Return the planner, grounder or policy of a name.

    Args:
        name: Name of the policy or part.
        arguments: Arguments of its class.
        device: Device of a model.

    Raises:
        LemmaError: There is none, or its weights are missing or damaged.
    """
    return instance_of(name, arguments) if ":" in name else load_model(name, device)
