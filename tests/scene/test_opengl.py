"""The choice of an OpenGL library, and what one context per process implies."""

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from interpreter import python

from lemma.core.errors import RenderingError
from lemma.scene.rendering import gl_backend as opengl
from lemma.scene.rendering import gl_context
from lemma.scene.rendering.gl_backend import Backend, choose_backend

PICTURE = """
import sys
import mujoco
from lemma.core.errors import RenderingError
from lemma.scene.cameras import FreeCamera
from lemma.scene.rendering.renderer import Renderer

def picture():
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(size=[0.1, 0, 0], rgba=[1, 0, 0, 1])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return Renderer(32, 24).rgb(model, data, FreeCamera((0, 0, 0), 0.5))[12, 16, 0] > 99
"""


@pytest.fixture(autouse=True)
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Remember nothing from before, and keep nothing for later."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    opengl._choose.cache_clear()
    yield
    opengl._choose.cache_clear()


@pytest.fixture
def probes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Pretend that OSMesa is the only library; return the names of those tried."""
    tried: list[str] = []

    def probe(name: str) -> tuple[str, str | None]:
        tried.append(name)
        works = name == "osmesa"
        return ("llvmpipe", None) if works else ("", f"no {name} here")

    monkeypatch.setattr(opengl, "_probe", probe)
    monkeypatch.setattr("platform.system", lambda: "Linux")
    return tried


def run(code: str) -> subprocess.CompletedProcess[str]:
    return python("-W", "error", "-c", PICTURE + code)


def test_first_library_that_works_is_chosen(probes: list[str]) -> None:
    backend = choose_backend()
    assert (backend.name, backend.renderer) == ("osmesa", "llvmpipe")
    assert "egl failed: no egl here" in backend.detail
    assert backend.is_software
    assert probes == ["egl", "osmesa"]


def test_choice_is_remembered_until_the_machine_changes(
    probes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = choose_backend()
    opengl._choose.cache_clear()
    assert choose_backend() == chosen
    assert len(probes) == 2
    monkeypatch.setenv("LD_LIBRARY_PATH", "/elsewhere")
    opengl._choose.cache_clear()
    choose_backend()
    assert len(probes) == 4


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"machine": 1}', "\x00"])
def test_a_damaged_memory_is_ignored(probes: list[str], text: str) -> None:
    opengl._cache_path().parent.mkdir()
    opengl._cache_path().write_text(text)
    assert choose_backend().name == "osmesa"
    assert json.loads(opengl._cache_path().read_text())["name"] == "osmesa"


def test_nothing_need_be_writable(
    probes: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert choose_backend().name == "osmesa"


def test_environment_overrides_the_order(
    probes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(RenderingError) as caught:
        choose_backend()
    message = str(caught.value)
    assert probes == ["egl"]
    assert "egl: no egl here" in message
    assert "egl: apt-get install libegl1" in message
    assert "MUJOCO_GL=egl is set; unset it" in message


def test_error_says_why_each_failed_and_what_to_install(
    probes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opengl, "_probe", lambda name: ("", f"no {name} here"))
    with pytest.raises(RenderingError) as caught:
        choose_backend()
    for name in ("egl", "osmesa", "glfw"):
        assert f"{name}: no {name} here" in str(caught.value)
    assert "libosmesa6" in str(caught.value)


@pytest.mark.parametrize(
    ("value", "message"), [("off", "switched off"), ("vulkan", "Valid: egl, osmesa")]
)
def test_impossible_settings_are_explained(
    probes: list[str], monkeypatch: pytest.MonkeyPatch, value: str, message: str
) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(RenderingError, match=message):
        choose_backend()
    assert probes == []


def test_probe_reports_a_failure_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "_PROBE", "raise OSError('libX.so not found')")
    assert opengl._probe("egl") == ("", "OSError: libX.so not found")
    monkeypatch.setattr(opengl, "_PROBE", "import os; os.abort()")
    assert opengl._probe("egl") == ("", "it crashed with signal 6")


@pytest.mark.render
def test_this_machine_has_one_that_works() -> None:
    backend = choose_backend()
    assert isinstance(backend, Backend)
    assert backend.renderer


@pytest.mark.slow
@pytest.mark.render
def test_rendering_prints_nothing_and_leaves_the_environment_alone() -> None:
    code = "import os; before = dict(os.environ)\nassert picture()\n"
    done = run(code + "assert dict(os.environ) == before, set(os.environ.items())")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_child_is_told_to_spawn() -> None:
    code = """
import os, warnings
warnings.simplefilter("ignore", DeprecationWarning)
assert picture()
if (child := os.fork()) == 0:
    try:
        picture()
    except RenderingError as error:
        sys.exit(7 if "'spawn'" in str(error) else 8)
    sys.exit(9)
_, status = os.waitpid(child, 0)
assert picture()
sys.exit(os.waitstatus_to_exitcode(status))
"""
    done = run(code)
    assert (done.returncode, done.stderr) == (7, "")


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_child_forked_before_the_first_picture_renders() -> None:
    code = """
import os
if (child := os.fork()) == 0:
    sys.exit(7 if picture() else 8)
_, status = os.waitpid(child, 0)
assert picture()
sys.exit(os.waitstatus_to_exitcode(status))
"""
    done = run(code)
    assert (done.returncode, done.stderr) == (7, "")


def test_a_device_that_does_not_exist_is_the_cause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failure = "MUJOCO_EGL_DEVICE_ID must be between 0 and 0, got 1."
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "1")
    monkeypatch.setattr(opengl, "_probe", lambda name: ("", failure))
    with pytest.raises(RenderingError) as raised:
        choose_backend()
    assert "unset MUJOCO_EGL_DEVICE_ID, which is '1'" in str(raised.value)
    assert "apt-get" not in str(raised.value)


def test_no_folder_for_temporary_files_is_no_reason_to_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nowhere() -> None:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile.TemporaryFile", nowhere)
    messages: list[str] = []
    with gl_context._silence(messages):
        os.write(2, b"not collected\n")
    assert messages == []
