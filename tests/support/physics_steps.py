"""A hook in every physics step, whoever makes it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mujoco

from lemma.scene.scene import Scene


@contextmanager
def each_step(scene: Scene, look: Callable[[], None]) -> Iterator[None]:
    """Call a function in every physics step of a scene.

    The motors are commanded and the contacts found then; what the physics computes
    later in the step, such as forces, is of the step before. The function must not
    raise anything, because MuJoCo would end the process.
    """
    ours = scene.data._address

    def control(_: mujoco.MjModel, data: mujoco.MjData) -> None:
        if data._address == ours:
            look()

    mujoco.set_mjcb_control(control)
    try:
        yield
    finally:
        mujoco.set_mjcb_control(None)
