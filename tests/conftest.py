"""Settings that every test shares: hypothesis profiles and off-screen rendering."""

import gc
import os
from collections.abc import Generator
from functools import cache

import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings
from kept import HOME

from lemma.core.errors import RenderingError

# With a thread per core in each of several workers, and in what they start, torch's
# threads wait for each other, spinning: up to four times the work itself.
os.environ.setdefault("OMP_NUM_THREADS", "1")

IN_CI = os.environ.get("CI", "").lower() == "true"

# Fixed examples in CI: a failure there is always the change's own. No deadline: the
# first call of a Numba function compiles it.
# Examples may be made slowly beside other work, too.
SLOW = [HealthCheck.too_slow]
settings.register_profile(
    "local", deadline=None, max_examples=50, suppress_health_check=SLOW
)
settings.register_profile(
    "ci",
    deadline=None,
    max_examples=50,
    suppress_health_check=SLOW,
    derandomize=True,
)
settings.load_profile("ci" if IN_CI else "local")


# Modules of all tests are millions of objects that stay. The garbage collector would
# look at them again and again, which took a fifth of the time of the tests.
gc.disable()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Compile the tests in one worker while others wait, where nobody has yet.

    Otherwise each compiles every module for itself, which takes twice as long as to
    import them. The processors are free for other checks meanwhile.
    """
    HOME.mkdir(exist_ok=True)
    done, lock = HOME / "compiled", FileLock(HOME / "collection.lock")
    if "PYTEST_XDIST_WORKER" in os.environ and not done.exists():
        lock.acquire()
        if done.exists():
            lock.release()
    found = yield
    done.touch()
    lock.release()
    return found


def pytest_collection_finish() -> None:
    """Collect garbage from now on, but not among what was imported."""
    gc.freeze()
    gc.enable()


@cache
def why_no_opengl() -> str:
    """Return why nothing renders here, or ``""`` if something does.

    ``MUJOCO_GL`` stays as it is: the package does not need it, and setting it would
    hide the automatic choice from the tests.
    """
    from lemma.scene.rendering.gl_backend import choose_backend

    try:
        choose_backend()
    except RenderingError as error:
        return str(error)
    return ""


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what renders where nothing can, except in CI, where that is a failure."""
    if item.get_closest_marker("render") and (reason := why_no_opengl()):
        if IN_CI:
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
