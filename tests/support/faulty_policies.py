"""Policies for tests: a sound one, and some of the many ways of not being one."""

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from multiprocessing import get_context
from typing import Any

import numpy as np

from lemma.core.poses import Pose2
from lemma.env.view import View
from lemma.policies.interfaces import Decision, PastStep, PolicyInput
from lemma.serve import PolicyServer, serve
from lemma.serve.conversation import ProtocolMode
from lemma.serve.websocket import connect
from lemma.tasks.subtask import STOP, GroundedSubTask, Primitive, SubTask

ROBOTS = ("red robot", "white robot")
MOVE = SubTask("robot_0", Primitive.MOVE, "red_cube", "blue_pad")
BAD = "bad"
"""The instruction at which faulty policies show their fault."""


def view(shade: int = 0, rows: int = 4, columns: int = 6) -> View:
    return View(
        np.full((rows, columns, 3), shade, np.uint8),
        np.full((rows, columns), 0.001 * shade, np.float32),
        np.ones((rows, columns), np.bool_),
        np.full((2, 6), 0.1 * shade),
        np.full(2, 0.01 * shade),
    )


def given(
    instruction: str = "go", *past: PastStep, now: View | None = None
) -> PolicyInput:
    return PolicyInput(instruction, ROBOTS, now or view(9), past)


@contextmanager
def asking(policy: object, mode: ProtocolMode) -> Iterator[Any]:
    """Connect to a server, by its address, or to a policy that is served meanwhile."""
    with ExitStack() as stack:
        url = policy
        if not isinstance(url, str):
            url = stack.enter_context(PolicyServer(policy, port=0)).url
        yield stack.enter_context(closing(connect(url, mode)))


def moved(x: float = 0.1, y: float = 0.2, yaw: float = 0.3) -> Decision:
    pose = Pose2(x, y, yaw)
    return Decision(MOVE, GroundedSubTask("robot_0", Primitive.MOVE, pose, pose))


class Scripted:
    """Moves the highest thing that it sees, twice; needs no truth and no weights."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return [self._decide(one) for one in inputs]

    def _decide(self, one: PolicyInput) -> Decision:
        if len(one.past) == 2:
            return Decision(STOP, None)
        seen = [*(step.view for step in one.past), one.view]
        total = sum(float(v.height_m.astype(np.float64).sum()) for v in seen)
        height = np.where(one.view.height_m < 0.07, one.view.height_m, 0.0)
        row, column = np.unravel_index(int(height.argmax()), height.shape)
        rows, columns = height.shape
        first = max(0, int(column) - 8)
        around = np.nonzero(height[row : row + 9, first : column + 9] > 0.04)
        if len(around[0]):
            row, column = row + around[0].mean(), first + around[1].mean()
        x, y = (column + 0.5 - columns / 2) * 0.008, (rows / 2 - row - 0.5) * 0.008
        # The nearer robot: one that is asked for too much has to stop.
        number = int(x > 0)
        robot = f"robot_{number}"
        pick = Pose2(float(x), float(y), float(one.view.joints[number, 0]))
        words = len(one.instruction) + len(one.past)
        place = Pose2(0.05 * math.sin(total), 0.1 - 0.01 * (words % 2), 0.0)
        subtask = SubTask(robot, Primitive.MOVE, "red_cube", "shared")
        return Decision(subtask, GroundedSubTask(robot, Primitive.MOVE, pick, place))


class _Faulty(Scripted):
    """Sound until it comes to the bad instruction."""

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        for one in inputs:
            if one.instruction == BAD:
                self.fail()
        return [moved() for _ in inputs]

    def fail(self) -> None:
        raise NotImplementedError


class Raises(_Faulty):
    def fail(self) -> None:
        raise KeyError("no such thing")


class Hangs(_Faulty):
    def fail(self) -> None:
        time.sleep(1000.0)


class HangsForGood(_Faulty):
    """In one call into C that lets no other thread run."""

    def fail(self) -> None:
        re.match(r"(a+)+$", "a" * 60 + "b")


class Crashes(_Faulty):
    def fail(self) -> None:
        os.kill(os.getpid(), signal.SIGSEGV)
        # The signal may hit another thread; this one must not go on until then.
        time.sleep(1000.0)


class Leaves(_Faulty):
    def fail(self) -> None:
        sys.exit(3)


class IsKilled(_Faulty):
    def fail(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(1000.0)


class AnswersNothing(_Faulty):
    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        return None  # type: ignore[return-value]


class CannotBeMade:
    def __init__(self) -> None:
        raise OSError("no weights")


class Plans:
    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        return [STOP if len(one.past) else MOVE for one in inputs]


class Grounds:
    def ground(
        self, inputs: Sequence[PolicyInput], subtasks: Sequence[SubTask]
    ) -> list[GroundedSubTask | None]:
        return [
            None
            if one.instruction == "lost"
            else GroundedSubTask(s.robot, s.primitive, Pose2(0, 0, 0), Pose2(1, 0, 0))
            for one, s in zip(inputs, subtasks, strict=True)
        ]


def start(name: str, port: int = 0) -> tuple[subprocess.Popen[str], str]:
    """Serve a policy in a process of its own, to be killed; return its address, too."""
    process = subprocess.Popen(
        [sys.executable, __file__, name, str(port)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


def end(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


class StartsProcesses(Scripted):
    """Has a child, which would run for a long time; says its number."""

    def __init__(self) -> None:
        self.child = get_context("fork").Process(target=time.sleep, args=(600.0,))
        self.child.start()

    def act(self, inputs: Sequence[PolicyInput]) -> list[Decision]:
        if inputs[0].instruction == BAD:
            os._exit(3)
        return [Decision(STOP, None, str(self.child.pid)) for _ in inputs]


class Remembering:
    """Stops at once; raises if it has planned for another sentence before."""

    reads_outcomes = True

    def __init__(self) -> None:
        self.heard: list[str] = []

    def plan(self, inputs: Sequence[PolicyInput]) -> list[SubTask]:
        self.heard += [given.instruction for given in inputs]
        if len(set(self.heard)) > 1:
            raise RuntimeError("it remembers")
        return [STOP] * len(inputs)


class Keeping(Remembering):
    """The same, and says so."""

    keeps_state = True


if __name__ == "__main__":
    # A server in a process of its own: CLASS PORT.
    serve(
        globals()[sys.argv[1]](),
        port=int(sys.argv[2]),
        on_ready=lambda url: os.write(1, f"{url}\n".encode()),
    )
