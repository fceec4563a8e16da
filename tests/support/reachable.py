"""Objects that any code can reach from an object by its attributes.

Attributes, items, closures, bound objects, what wrappers wrap, what an object would be
pickled as, and the modules of the package behind the globals of its functions. Not
followed: frames of the stack, the garbage collector's list of all objects, what modules
are imported by, and Numba's own objects: a compiled function holds the compiler, with
all types of the process.
"""

import gc
import sys
import types
import weakref
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import PurePath
from typing import Any

import mujoco
import numpy as np
from numba.core.dispatcher import Dispatcher

from lemma.env.camera_rig import CameraRig
from lemma.env.episode import Episode
from lemma.env.simulation import Simulation
from lemma.policies.interfaces import Decision, Oracle, PolicyInput
from lemma.scene.scene import Scene
from lemma.scene.spec import SceneSpec
from lemma.tasks.goal import Goal
from lemma.tasks.instance import Instance
from lemma.tasks.subtask import STOP, Primitive, SubTask

SECRET = (
    *(Scene, Simulation, Episode, CameraRig),
    *(mujoco.MjModel, mujoco.MjData, mujoco.MjSpec),
    *(Instance, Goal, SceneSpec),
)
"""Types of what knows the truth, or leads to who does."""
HOPELESS = SubTask("robot_0", Primitive.HOOK, "stick", "shared")
"""A decision that is refused, so that there is a past."""
_PLAIN = (
    *(int, float, complex, str, bytes, bytearray, memoryview, type(None)),
    *(PurePath, Enum, np.generic, np.dtype, types.CodeType, range),
    # OpenGL's own: fonts and frame buffers of the process, no scene.
    mujoco.MjrContext,
)
_CONTAINERS = (list, tuple, dict, set, frozenset, types.MappingProxyType, deque)
_HOMES = {"lemma", __name__, "builtins", "functools", "itertools", "mujoco"}
"""Packages whose objects are asked for all that they have."""
_MOST = 1_000_000
"""Objects that are looked at before the search is called endless."""
_LOADED_BY = ("__loader__", "__spec__")
"""Loaders of modules; the loader of the tests knows all tests."""
_HIDDEN = (
    *("__wrapped__", "__func__", "__self__", "__closure__", "__defaults__"),
    *("__kwdefaults__", "__dict__"),
)
"""Attributes that ``dir`` may leave out."""


def secrets_within(*roots: object) -> list[str]:
    """Return the ways from some objects to what knows the truth; none is good."""
    # A policy that keeps all its inputs leaves nothing to collect.
    gc.disable()
    try:
        return list(find_secrets(*roots))
    finally:
        gc.enable()


def find_secrets(*roots: object) -> Iterator[str]:
    """Yield the ways from some objects to what knows the truth, short ones first."""
    seen: dict[int, object] = {}
    waiting: deque[tuple[_Way, object]] = deque()
    waiting.extend(((None, "given"), root) for root in roots)
    while waiting:
        way, one = waiting.popleft()
        if id(one) in seen:
            continue
        # Kept, so that no other object gets its number.
        seen[id(one)] = one
        assert len(seen) < _MOST, f"no end at {_in_words(way)}"
        # A capsule under an array: its numbers are the engine's own, and move.
        live = way[1] == ".base" and type(one).__name__ == "PyCapsule"
        if isinstance(one, SECRET) or live:
            yield f"{_in_words(way)}: {type(one).__name__}"
        else:
            waiting.extend(
                ((way, step), other)
                for step, other in _behind(one)
                if not isinstance(other, _PLAIN)
            )


_Way = tuple[Any, object]
"""The way before, and one more step: an attribute, or a key in a tuple."""


def _in_words(way: _Way | None) -> str:
    steps = []
    while way is not None:
        way, step = way
        steps.append(step if isinstance(step, str) else f"[{step[0]!r:.40}]")  # type: ignore[index]
    return "".join(reversed(steps))


def _behind(one: object) -> Iterator[tuple[object, object]]:
    if isinstance(one, types.ModuleType | type):
        home = one.__name__ if isinstance(one, types.ModuleType) else one.__module__
        if home.partition(".")[0] in _HOMES:
            yield from ((f".{name}", value) for name, value in _own(vars(one)).items())
        return
    if type(one).__module__.partition(".")[0] == "numba":
        # Machine code holds no object; what it was made of may, and who sets a field.
        if isinstance(one, Dispatcher):
            yield from ((f".{name}", value) for name, value in vars(one).items())
        return
    if isinstance(one, dict):
        # As it is stored: a class of others may look its values up elsewhere.
        for key, value in list(dict.items(one)):
            yield (key,), value
            yield "<key>", key
    elif isinstance(one, Mapping):
        with suppress(Exception):
            yield from (((key,), one[key]) for key in list(one))
            yield from (("<key>", key) for key in one)
    elif isinstance(one, Sequence | set | frozenset):
        with suppress(Exception):
            yield from (((i,), item) for i, item in enumerate(one))
    if type(one) in _CONTAINERS:
        return
    if isinstance(one, weakref.ref):
        yield "()", one()
    if isinstance(one, np.ndarray):
        yield ".base", one.base
        return
    names: Collection[str] = _HIDDEN
    if isinstance(one, types.FunctionType):
        # Code that was generated is of no module.
        if (one.__module__ or "").partition(".")[0] in _HOMES:
            yield ".__globals__", _own(one.__globals__)
    elif type(one).__module__.partition(".")[0] in _HOMES:
        # Of others' objects no property is asked: who knows what it does.
        names = _names(one)
        if not isinstance(one, types.BuiltinFunctionType | types.MethodType):
            # From what, and in which state, it would be made again; of those it is
            # their ``__self__``.
            with suppress(Exception):
                yield ".<pickled>", one.__reduce_ex__(4)[1:3]
    for name in names:
        with suppress(Exception):
            yield f".{name}", getattr(one, name)


def _names(one: object) -> Collection[str]:
    """Return the names of all that an object has."""
    if hasattr(one, "__dict__") or "__dir__" in vars(type(one)):
        return _open_names(dir(one))
    kind = type(one)
    if kind not in _NAMES:
        _NAMES[kind] = _open_names(dir(one))
    return _NAMES[kind]


def _open_names(names: list[str]) -> Collection[str]:
    return sorted({*_HIDDEN, *(name for name in names if not name.startswith("__"))})


_NAMES: dict[type, Collection[str]] = {}
"""Of types whose objects have what their type has."""


def _own(module: Mapping[str, object]) -> dict[str, object]:
    return {name: value for name, value in module.items() if name not in _LOADED_BY}


class Slotted:
    """Hides something where no dictionary is."""

    __slots__ = ("_hidden",)

    def __init__(self, hidden: object) -> None:
        self._hidden = hidden


class Spy:
    """Looks for the truth in all that it is given, and says what it finds."""

    cameras = True

    def __init__(self) -> None:
        self.kept: list[PolicyInput] = []
        self.found: list[str] = []

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        subtasks = self.plan(inputs)
        told = "; ".join(self.found) or "nothing"
        return [Decision(subtask, None, told) for subtask in subtasks]

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        self.kept += inputs
        methods = [given.with_past for given in inputs]
        self.found += secrets_within(self, inputs, methods)
        if any(given.past for given in inputs) and not self.found:
            # The whole package, once something has happened, because it takes long.
            self.found += secrets_within(sys.modules["lemma"])
        return [STOP if given.past else HOPELESS for given in inputs]


class Confidant(Spy, Oracle):
    """The same, and says by its type that it needs the truth."""


def disguised() -> Spy:
    """Make an oracle by what does not say so."""
    return Confidant()
