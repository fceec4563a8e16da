"""Action spaces: layouts, bounds, and checks with precise error messages.

Boxes are two-dimensional, with one row per robot or pose. Their values are in SI units,
not normalized.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from lemma.core.errors import InvalidActionError, UnknownNameError, shown
from lemma.core.kernels import kernel
from lemma.core.poses import FloatArray, Pose2, wrap
from lemma.core.robot_names import robot_name, robot_names, robot_number
from lemma.scene.objects.entity import ENTITIES, SHARED, extra_entities, pair_regions
from lemma.scene.table import TABLE_HALF_X_M, TABLE_HALF_Y_M
from lemma.tasks.subtask import (
    STOP,
    GroundedSubTask,
    Primitive,
    SubTask,
    primitive_names,
)

PICKS = ("", *ENTITIES)
"""Entities that a sub-task may pick; the first, ``""``, means no entity."""
PLACES = (*PICKS, SHARED)
"""Entities and regions that a sub-task may place the picked entity on."""
POSE_FIELDS = ("x", "y", "yaw")

Action = Mapping[str, Any]

# More than half a unit in the last place of a float32: values that were clipped in
# single precision count as inside the bounds.
_TOLERANCE = 1e-6
_HINT = " Try the environment's encode()."


@dataclass(frozen=True)
class ActionLayout:
    """The meaning of a two-dimensional array of numbers."""

    rows: tuple[str, ...]
    """Robot of each row."""
    columns: tuple[str, ...]
    """Meaning of each number of a row."""
    low: tuple[float, ...]
    """Smallest value in each column."""
    high: tuple[float, ...]
    """Largest value in each column."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return (len(self.rows), len(self.columns))

    def box(self, dtype: type[np.floating[Any]] = np.float32) -> spaces.Box:
        """Return the space of these arrays."""
        low, high = np.array(self.low, dtype), np.array(self.high, dtype)
        count = len(self.rows)
        return spaces.Box(
            np.tile(low, (count, 1)), np.tile(high, (count, 1)), dtype=dtype
        )

    def row_box(self) -> spaces.Box:
        """Return the space of one row."""
        low, high = np.array(self.low, np.float32), np.array(self.high, np.float32)
        return spaces.Box(low, high, dtype=np.float32)

    def check(self, action: Any, *, clip: bool = False) -> FloatArray:
        """Return a valid action as an array of the layout's shape.

        Args:
            action: Numbers of that shape.
            clip: Clip finite numbers that are out of bounds instead of refusing them.

        Raises:
            InvalidActionError: Not numbers, of another shape, not finite, or out of
                bounds.
        """
        values = self._numbers(action)
        if values.shape != self.shape:
            same = values.size == self.shape[0] * self.shape[1]
            hint = f" Try action.reshape({self.shape})." if same else ""
            raise InvalidActionError(
                f"The action has shape {values.shape}. {self._valid()}{hint}"
            )
        low, high, slack = self._bounds
        if clip and np.isfinite(values).all():
            values = np.clip(values, low, high)
        if not _clip(values, low, high, slack):
            # `~(a <= b)` also refuses NaN.
            outside = ~((low - slack <= values) & (values <= high + slack))
            self._refuse(values, np.argwhere(outside))
        return values

    @cached_property
    def _bounds(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return smallest values, largest values, and the tolerance of each."""
        low, high = np.array(self.low, np.float64), np.array(self.high, np.float64)
        return low, high, _TOLERANCE * (1.0 + np.maximum(abs(low), abs(high)))

    def _numbers(self, action: Any) -> FloatArray:
        """Return an action as a float array; refuse types that are not real numbers."""
        # Fast path for nearly every action: copy the float array.
        if type(action) is np.ndarray and action.dtype.kind == "f":
            return action.astype(np.float64)
        rows = action if isinstance(action, list | tuple) else (action,)
        try:
            values = np.asarray(action)
            masked = any(np.ma.is_masked(row) for row in rows)
        except (TypeError, ValueError, RuntimeError, OverflowError) as error:
            raise InvalidActionError(
                f"The action {shown(action)} is no array of numbers. {self._valid()}"
            ) from error
        if values.dtype.kind not in "fiu" or masked:
            kind = "masked" if masked else values.dtype
            raise InvalidActionError(
                f"The action {shown(action)} is no array of numbers but {kind}. "
                f"{self._valid()}"
            )
        return values.astype(np.float64)

    def _refuse(self, values: FloatArray, places: NDArray[np.int64]) -> None:
        """Raise an error about the first of the values out of bounds."""
        i, j = places[0].tolist()
        more = f" (and {len(places) - 1} more numbers)" if len(places) > 1 else ""
        raise InvalidActionError(
            f"In the action, {self.columns[j]} of {self.rows[i]} is {values[i, j]:g}, "
            f"not in [{self.low[j]:g}, {self.high[j]:g}]{more}. Make the environment "
            "with clip_actions=True, which clips what is finite, wrap it in "
            "gymnasium.wrappers.ClipAction, or let gymnasium.wrappers.RescaleAction "
            "map [-1, 1] to the bounds."
        )

    def _valid(self) -> str:
        return (
            f"Valid: shape {self.shape}, one row for each of {', '.join(self.rows)}, "
            f"with {', '.join(self.columns)}."
        )


@kernel
def _clip(
    values: FloatArray, low: FloatArray, high: FloatArray, slack: FloatArray
) -> bool:
    """Clip rows to bounds in place; return False if a value exceeds the slack."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            value = values[i, j]
            if not low[j] - slack[j] <= value <= high[j] + slack[j]:
                return False
            values[i, j] = min(max(value, low[j]), high[j])
    return True


SKILL_POSES = ActionLayout(
    rows=("pick", "place"),
    columns=POSE_FIELDS,
    low=(-TABLE_HALF_X_M, -TABLE_HALF_Y_M, -math.pi),
    high=(TABLE_HALF_X_M, TABLE_HALF_Y_M, math.pi),
)
"""Poses of the gripper on the table [m, m, rad], see
:class:`~lemma.tasks.subtask.GroundedSubTask`."""


def picks(kinds: Collection[str] = ()) -> tuple[str, ...]:
    """Return the entities that a sub-task may pick.

    These are :data:`PICKS`, then entities of kinds and colors that users registered.
    The index in the tuple is the number in an action.

    Args:
        kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.
    """
    return (*PICKS, *extra_entities(kinds))


def places(team_size: int = 2, kinds: Collection[str] = ()) -> tuple[str, ...]:
    """Return the entities and regions that a sub-task may place something on.

    :data:`PLACES`, then the regions that two robots of a larger team may share, then
    registered entities. The index in the tuple is the number in an action.

    Args:
        team_size: Number of robots.
        kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.
    """
    return (*PLACES, *pair_regions(team_size), *extra_entities(kinds))


def skill_space(team_size: int) -> spaces.Dict:
    """Return the space of grounded sub-tasks."""
    return spaces.Dict(
        {
            "robot": spaces.Discrete(team_size),
            "primitive": spaces.Discrete(len(primitive_names())),
            "poses": SKILL_POSES.box(np.float64),
        }
    )


def plan_space(team_size: int, kinds: Collection[str] = ()) -> spaces.Dict:
    """Return the space of symbolic sub-tasks.

    Args:
        team_size: Number of robots.
        kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.
    """
    return spaces.Dict(
        {
            "robot": spaces.Discrete(team_size),
            "primitive": spaces.Discrete(len(primitive_names())),
            "pick": spaces.Discrete(len(picks(kinds))),
            "place": spaces.Discrete(len(places(team_size, kinds))),
        }
    )


def encode_skill(subtask: GroundedSubTask | None) -> dict[str, Any]:
    """Return the skill-level action for a grounded sub-task, or ``stop`` for None.

    Raises:
        InvalidActionError: The argument is neither.
    """
    _check_type(subtask, GroundedSubTask)
    if subtask is None:
        stop = primitive_names().index(Primitive.STOP)
        return {"robot": 0, "primitive": stop, "poses": np.zeros((2, 3))}
    # Wrapping changes the last bits, so only angles out of range are wrapped.
    poses = [
        [p.x, p.y, p.yaw if abs(p.yaw) <= math.pi else wrap(p.yaw)]
        for p in (subtask.pick, subtask.place)
    ]
    return {
        "robot": _robot_number(subtask.robot),
        "primitive": primitive_names().index(subtask.primitive),
        "poses": np.array(poses),
    }


def decode_skill(action: Action, team_size: int) -> GroundedSubTask | None:
    """Return the grounded sub-task that an action means, None for ``stop``.

    Raises:
        InvalidActionError: The action is not in the space.
    """
    keys = ("robot", "primitive", "poses")
    check_keys(action, keys, _HINT)
    robot = _number(action["robot"], "robot", _robot_names(team_size))
    primitive = _primitive(action["primitive"])
    pick, place = (Pose2(*row) for row in SKILL_POSES.check(action["poses"]).tolist())
    if primitive is Primitive.STOP:
        return None
    return GroundedSubTask(robot_name(robot), primitive, pick, place)


def encode_plan(
    subtask: SubTask | None, team_size: int = 2, kinds: Collection[str] = ()
) -> dict[str, Any]:
    """Return the plan-level action for a symbolic sub-task, or ``stop`` for None.

    Args:
        subtask: The sub-task.
        team_size: Number of robots.
        kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.

    Raises:
        InvalidActionError: There is no such entity, or the argument is neither.
    """
    _check_type(subtask, SubTask)
    subtask = subtask or STOP
    able, there = picks(kinds), places(team_size, kinds)
    for entity, valid in ((subtask.pick, able), (subtask.place, there)):
        if entity not in valid:
            raise InvalidActionError(
                f"No table ever has a {shown(entity)}. Valid: {', '.join(valid[1:])}."
            )
    return {
        "robot": _robot_number(subtask.robot) if subtask.robot else 0,
        "primitive": primitive_names().index(subtask.primitive),
        "pick": able.index(subtask.pick),
        "place": there.index(subtask.place),
    }


def decode_plan(action: Action, team_size: int, kinds: Collection[str] = ()) -> SubTask:
    """Return the symbolic sub-task that an action means.

    Args:
        action: An element of :func:`plan_space`.
        team_size: Number of robots.
        kinds: Kinds that only some tasks have; see :attr:`.Task.kinds`.

    Raises:
        InvalidActionError: The action is not in the space.
    """
    check_keys(action, ("robot", "primitive", "pick", "place"), _HINT)
    robot = _number(action["robot"], "robot", _robot_names(team_size))
    primitive = _primitive(action["primitive"])
    entity = picks(kinds)
    pick = entity[_number(action["pick"], "pick", entity)]
    entity = places(team_size, kinds)
    place = entity[_number(action["place"], "place", entity)]
    if primitive is Primitive.STOP:
        return STOP
    return SubTask(robot_name(robot), primitive, pick, place)


def _primitive(value: Any) -> Primitive:
    names = primitive_names()
    return Primitive(names[_number(value, "primitive", names)])


def _check_type(subtask: object, wanted: type) -> None:
    if not isinstance(subtask, wanted | None):
        raise InvalidActionError(
            f"{shown(subtask)} cannot be encoded. Valid: a {wanted.__name__}, or None "
            "to stop."
        )


def _robot_names(team_size: int) -> list[str]:
    return list(robot_names(team_size))


def _robot_number(name: str) -> int:
    try:
        return robot_number(name)
    except UnknownNameError as error:
        raise InvalidActionError(str(error)) from None


def check_keys(action: Any, keys: Sequence[str], hint: str = "") -> None:
    """Check that an action is a dictionary with the given keys.

    Args:
        action: The action.
        keys: Required keys.
        hint: Advice that is appended to the error message.

    Raises:
        InvalidActionError: The action is no dictionary with these keys.
    """
    if not isinstance(action, Mapping):
        found = f"{shown(action)}"
    elif set(action) != set(keys):
        found = f"a dictionary with {', '.join(f'{shown(key)}' for key in action)}"
    else:
        return
    raise InvalidActionError(
        f"The action is {found:.300}. Valid: a dictionary with {', '.join(keys)}.{hint}"
    )


def _number(value: Any, name: str, meanings: Sequence[str]) -> int:
    """Return a discrete part of an action as an int in range."""
    try:
        found: NDArray[Any] = np.asarray(value)
        valid = found.size == 1 and found.dtype.kind in "iu"
        number = int(found.reshape(())) if valid and not np.ma.is_masked(value) else -1
    except (TypeError, ValueError, RuntimeError, OverflowError):
        number = -1
    if not 0 <= number < len(meanings):
        options = ", ".join(f"{i} {m or '(none)'}" for i, m in enumerate(meanings))
        raise InvalidActionError(
            f"{name!r} of the action is {shown(value)}. Valid: whole numbers, "
            f"{options}."
        )
    return number
