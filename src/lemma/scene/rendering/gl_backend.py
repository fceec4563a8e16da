"""Choice of the OpenGL library.

A headless machine may have EGL (a GPU driver, or Mesa in software), OSMesa (Mesa in
software, without a window system) or a display for GLFW. Only rendering an image shows
whether one works. :func:`choose_backend` tries them in that order in a child process,
because a failed attempt may crash, and because PyOpenGL binds its platform when it is
first imported. The result is cached on disk until the machine restarts or its libraries
change. ``MUJOCO_GL=egl|osmesa|glfw|cgl`` overrides the order.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from lemma.core.errors import RenderingError

_CANDIDATES = {"Linux": ("egl", "osmesa", "glfw"), "Darwin": ("cgl",)}
_AUTOMATIC = ("", "enable", "enabled", "on", "true", "1")
_SWITCHED_OFF = ("disable", "disabled", "off", "false", "0")
_REMEDY = {
    "egl": "apt-get install libegl1 libgl1 libgl1-mesa-dri",
    "osmesa": "apt-get install libosmesa6",
    "glfw": "needs a display, such as the one of xvfb-run",
    "cgl": "needs macOS",
}
_DEVICE_VARIABLE = "MUJOCO_EGL_DEVICE_ID"
_PROBE_TIMEOUT_S = 60.0
# Prefixes of environment variables that may change which library works.
_ENVIRONMENT = (
    *("DISPLAY", "EGL_", "GALLIUM_", "LD_LIBRARY_PATH", "LIBGL_", "MESA_", "MUJOCO_"),
    *("NVIDIA_", "PYOPENGL_", "WAYLAND_", "__EGL", "__GLX", "__NV"),
)

_MODEL_XML = """
<mujoco><visual><global offwidth="32" offheight="32"/><quality shadowsize="0"/></visual>
<worldbody><camera pos="0 0 1"/><geom size=".5" rgba="1 0 0 1"/></worldbody></mujoco>
"""

# Runs in a child process, without other modules of this package.
_PROBE = """
import json, sys
import mujoco, numpy
module = __import__("mujoco." + sys.argv[1], fromlist=["GLContext"])
context = module.GLContext(32, 32)
context.make_current()
model = mujoco.MjModel.from_xml_string(sys.argv[2])
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
drawing = mujoco.MjrContext(model, 100)
mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawing)
camera = mujoco.MjvCamera()
camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
scene = mujoco.MjvScene(model, 10)
everything = mujoco.mjtCatBit.mjCAT_ALL
mujoco.mjv_updateScene(
    model, data, mujoco.MjvOption(), None, camera, everything, scene
)
rect, rgb = mujoco.MjrRect(0, 0, 32, 32), numpy.zeros((32, 32, 3), numpy.uint8)
mujoco.mjr_render(rect, scene, drawing)
mujoco.mjr_readPixels(rgb, None, rect, drawing)
red, green, _ = (int(value) for value in rgb[16, 16])
if red < 50 or green > red // 2:
    sys.exit("it rendered a wrong picture")
try:
    from OpenGL import GL
    renderer = GL.glGetString(GL.GL_RENDERER).decode()
except Exception:
    renderer = "unknown renderer"
drawing.free()
context.free()
print(json.dumps({"renderer": renderer}))
"""


@dataclass(frozen=True, slots=True)
class Backend:
    """An OpenGL library that has rendered an image on this machine."""

    name: str
    """MuJoCo's name for it: ``egl``, ``osmesa``, ``glfw`` or ``cgl``."""
    renderer: str
    """``GL_RENDERER`` of the library, such as ``llvmpipe (LLVM 15.0.6, 256 bits)``."""
    detail: str
    """The reason for the choice, as text."""

    @property
    def is_software(self) -> bool:
        """Whether it renders on the CPU."""
        words = ("llvmpipe", "softpipe", "swrast", "software")
        return any(word in self.renderer.lower() for word in words)


def choose_backend() -> Backend:
    """Return the OpenGL library that this process renders with.

    The first call on a machine takes one or two seconds, the first call in a later
    process 1 ms. Further calls return the same object at once.

    Raises:
        RenderingError: None works; the message has the reason of each failure.
    """
    return _choose(os.environ.get("MUJOCO_GL", "").strip().lower())


@functools.cache
def _choose(asked: str) -> Backend:
    if asked in _SWITCHED_OFF:
        raise RenderingError(
            f"Rendering is switched off by MUJOCO_GL={asked}. Unset MUJOCO_GL to "
            "choose an OpenGL library automatically."
        )
    candidates = _CANDIDATES.get(platform.system(), ("glfw",))
    names = candidates if asked in _AUTOMATIC else (asked.replace("glx", "glfw"),)
    valid = dict.fromkeys((*candidates, "glfw"))
    if not set(names) <= set(valid):
        raise RenderingError(
            f"MUJOCO_GL={asked} names no OpenGL library of this system. Valid: "
            f"{', '.join(valid)}. Unset it to choose automatically."
        )
    known = _remembered()
    if known is not None and known.name in names:
        return known
    failures: dict[str, str] = {}
    for name in names:
        renderer, failure = _probe(name)
        if failure is None:
            why = "asked for by MUJOCO_GL" if names != candidates else "works"
            tried = "".join(f"; {n} failed: {f}" for n, f in failures.items())
            backend = Backend(name, renderer, why + tried)
            _remember(backend)
            return backend
        failures[name] = failure
    raise RenderingError(_explain(failures, asked))


def _probe(name: str) -> tuple[str, str | None]:
    """Render an image in a child process; return the renderer, and any failure."""
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    on_linux = platform.system() == "Linux"
    if name == "glfw" and on_linux and not any(map(os.environ.get, displays)):
        return "", "there is no display (DISPLAY is not set)"
    try:
        child = subprocess.run(
            [sys.executable, "-c", _PROBE, name, _MODEL_XML],
            env={**os.environ, "MUJOCO_GL": name},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"no picture after {_PROBE_TIMEOUT_S:.0f} s"
    except OSError as error:
        return "", f"could not start {sys.executable!r} to try it: {error}"
    if child.returncode == 0:
        return json.loads(child.stdout.splitlines()[-1])["renderer"], None
    lines = [line for line in child.stderr.splitlines() if line.strip()]
    if child.returncode < 0:
        lines.append(f"it crashed with signal {-child.returncode}")
    reason = lines[-1].strip() if lines else f"exit code {child.returncode}"
    if reason.startswith("AttributeError: 'NoneType'"):
        # PyOpenGL reports a missing library like this.
        reason = "its library is not installed, or incomplete"
    return "", reason


def _explain(failures: dict[str, str], asked: str) -> str:
    lines = ["No OpenGL library could render off screen. Tried:"]
    lines += [f"  {name}: {failure}" for name, failure in failures.items()]
    lines.append("To repair one of them:")
    lines += [f"  {name}: {_remedy(name, text)}" for name, text in failures.items()]
    if asked:
        lines.append(f"MUJOCO_GL={asked} is set; unset it to try every library.")
    return "\n".join(lines)


def _remedy(name: str, failure: str) -> str:
    """Return a remedy for the failure of a library."""
    device = os.environ.get(_DEVICE_VARIABLE)
    if device is not None and _DEVICE_VARIABLE in failure:
        return f"unset {_DEVICE_VARIABLE}, which is {device!r}, or set it to 0"
    return _REMEDY[name]


def forget_backend() -> None:
    """Make the next call of :func:`choose_backend` try again."""
    _choose.cache_clear()
    with contextlib.suppress(OSError, RuntimeError):
        _cache_path().unlink()


def _cache_path() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "lemma" / "opengl.json"


def _machine_state() -> str:
    """Return a digest of all facts on which the choice depends."""
    facts: list[object] = [sys.prefix, tuple(os.uname())]
    facts.append(importlib.metadata.version("mujoco"))
    variables = sorted(os.environ.items())
    facts += [item for item in variables if item[0].startswith(_ENVIRONMENT)]
    with contextlib.suppress(OSError):
        facts.append(Path("/proc/sys/kernel/random/boot_id").read_text("utf-8"))
    with contextlib.suppress(OSError):
        # Installing a package with a library rewrites the loader's cache.
        loader = os.stat("/etc/ld.so.cache")
        facts += [loader.st_dev, loader.st_ino, loader.st_size, loader.st_mtime_ns]
    with contextlib.suppress(OSError):
        facts += sorted(os.listdir("/dev/dri"))
    facts += sorted(path.name for path in Path("/dev").glob("nvidia*"))
    return hashlib.sha256(repr(facts).encode()).hexdigest()


def _remembered() -> Backend | None:
    try:
        record = json.loads(_cache_path().read_text("utf-8"))
        if record.pop("machine") != _machine_state():
            return None
        return Backend(**record)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError):
        return None


def _remember(backend: Backend) -> None:
    # Without the cache, the next process repeats the probe, which takes a second.
    with contextlib.suppress(OSError, RuntimeError):
        path = _cache_path()
        path.parent.mkdir(parents=True, exist_ok=True)
        record = {"machine": _machine_state(), **asdict(backend)}
        partial = path.with_suffix(f".{os.getpid()}")
        partial.write_text(json.dumps(record))
        partial.replace(path)
