"""What can be reached from an object by its attributes, by anybody's code.

Attributes, items, closures, bound objects, what wrappers wrap, what an object would be
pickled as, and the modules of the package behind the globals of its functions. What is
outside: frames of the stack, the garbage collector's list of all objects, what modules
are imported by, and Numba's own objects: a compiled function holds the compiler, with
all types of the process.
"""

import sys
import types
import weakref
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import PurePath

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
_MOST = 200_000
"""Objects that are looked at before the search is called endless."""
_LOADED_BY = ("__loader__", "__spec__")
"""What imported a module; the tests' own importer knows of all tests."""
_HIDDEN = (
    *("__wrapped__", "__func__", "__self__", "__closure__", "__defaults__"),
    *("__kwdefaults__", "__dict__"),
)
"""Attributes that ``dir`` may leave out."""


def secrets_within(*roots: object) -> list[str]:
    """Return the ways from some objects to what knows the truth; none is good."""
    seen: dict[int, object] = {}
    found: list[str] = []
    waiting = deque([("given", root) for root in roots])
    while waiting:
        path, one = waiting.popleft()
        if isinstance(one, _PLAIN) or id(one) in seen:
            continue
        # Kept, so that no other object gets its number.
        seen[id(one)] = one
        assert len(seen) < _MOST, f"no end at {path}"
        # A capsule under an array: its numbers are the engine's own, and move.
        live = path.endswith(".base") and type(one).__name__ == "PyCapsule"
        if isinstance(one, SECRET) or live:
            found.append(f"{path}: {type(one).__name__}")
        else:
            waiting += [(f"{path}{step}", other) for step, other in _behind(one)]
    return found


def _behind(one: object) -> Iterator[tuple[str, object]]:
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
    if isinstance(one, Mapping):
        yield from ((f"[{key!r:.40}]", one[key]) for key in list(one))
        yield from (("<key>", key) for key in one)
    elif isinstance(one, Sequence | set | frozenset):
        yield from ((f"[{i}]", item) for i, item in enumerate(one))
    if type(one) in _CONTAINERS:
        return
    if isinstance(one, weakref.ref):
        yield "()", one()
    if isinstance(one, np.ndarray):
        yield ".base", one.base
        return
    names = set(_HIDDEN)
    if isinstance(one, types.FunctionType):
        # Code that was generated is of no module.
        if (one.__module__ or "").partition(".")[0] in _HOMES:
            yield ".__globals__", _own(one.__globals__)
    elif type(one).__module__.partition(".")[0] in _HOMES:
        # Of others' objects no property is asked: who knows what it does.
        names |= {name for name in dir(one) if not name.startswith("__")}
        names.add("<pickled>")
    for name in sorted(names):
        with suppress(Exception):
            # Of how it would be pickled: from what, and its state.
            pickled = name[0] == "<"
            yield (
                f".{name}",
                one.__reduce_ex__(4)[1:3] if pickled else getattr(one, name),
            )


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
        self.found += secrets_within(self, inputs, methods, sys.modules["lemma"])
        return [STOP if given.past else HOPELESS for given in inputs]


class Confidant(Spy, Oracle):
    """The same, and says by its type that it needs the truth."""


def disguised() -> Spy:
    """Make an oracle by what does not say so."""
    return Confidant()
