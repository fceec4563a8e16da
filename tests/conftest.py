"""Settings that every test shares: hypothesis profiles and off-screen rendering."""

import os

import pytest
from hypothesis import settings

IN_CI = os.environ.get("CI", "").lower() == "true"

# Fixed examples in CI: a failure there is always the change's own. No deadline: the
# first call of a Numba function compiles it.
settings.register_profile("local", deadline=None, max_examples=50)
settings.register_profile("ci", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("ci" if IN_CI else "local")


def choose_opengl() -> str:
    """Make MuJoCo render with what works here; return why nothing does, or ``""``.

    MuJoCo reads ``MUJOCO_GL`` once, when it is imported, and the worker processes of
    pytest-xdist inherit it: so this runs before any test module is imported.
    """
    if "MUJOCO_GL" in os.environ:
        return ""
    from lemma.core.errors import RenderingError

    try:
        from lemma.scene.opengl import choose_backend
    except ModuleNotFoundError:
        return ""
    try:
        os.environ["MUJOCO_GL"] = choose_backend()
    except RenderingError as error:
        return str(error)
    return ""


WHY_NO_OPENGL = choose_opengl()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what renders where nothing can, except in CI, where that is a failure."""
    if WHY_NO_OPENGL and item.get_closest_marker("render"):
        if IN_CI:
            pytest.fail(WHY_NO_OPENGL, pytrace=False)
        pytest.skip(WHY_NO_OPENGL)
