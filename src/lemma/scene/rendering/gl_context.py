"""The OpenGL context of this process, and the models uploaded to it.

A process has one context, which the first image creates and which one thread at a time
uses. Every reset compiles a new model, but the assets in OpenGL (meshes, textures,
shapes of primitives) are usually the same. So uploads are cached, and looked up by
comparing these assets instead of the identity of the model.

Software Mesa uses one thread per core that the process may use; workers of the pool
draw in their own thread alone. If you run many processes on one machine, set
``LP_NUM_THREADS=0`` before the first image; the pixels are the same.
"""

import atexit
import contextlib
import ctypes
import importlib
import logging
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lemma.core.engine import mujoco
from lemma.core.errors import RenderingError
from lemma.core.workers.pool import is_worker
from lemma.core.workers.resources import usable_cores
from lemma.scene.rendering.gl_backend import Backend, choose_backend, forget_backend

logger = logging.getLogger(__name__)

POOL_SIZE = 8
"""Number of cached uploads. A benchmark needs one per pair of arms and quality."""


@dataclass(frozen=True, slots=True)
class Tessellation:
    """Resolution of MuJoCo's primitives and of its shadow map."""

    slices: int
    """Segments around cylinders, capsules and spheres."""
    stacks: int
    """Segments along them."""
    quads: int
    """Squares along each edge of a box; lighting is computed at their corners."""
    shadow_map_px: int = 0
    """Width and height of the shadow map; 0 draws no shadows."""


@dataclass(eq=False, slots=True)
class Upload:
    """A model's assets in OpenGL, with an off-screen buffer."""

    drawing: Any
    """The ``MjrContext``, or None after it was freed."""
    tessellation: Tessellation
    assets: dict[str, NDArray[Any]]


@dataclass(slots=True)
class _Process:
    """The state of OpenGL in this process."""

    pid: int
    backend: Backend
    context: Any
    depth: int = 0
    """Number of open blocks of :func:`current_context`."""
    pool: list[Upload] = field(default_factory=list)
    """The uploads, most recently used last."""


_lock = threading.RLock()
_process: _Process | None = None


@contextlib.contextmanager
def current_context() -> Iterator[Backend]:
    """Make the process's OpenGL context current in this thread, inside the block.

    Other threads wait for the end of the block, so any thread may use renderers. Blocks
    may be nested.

    Raises:
        RenderingError: No library works, or this process was forked from one that
            had rendered already.
    """
    with _lock:
        process = _this_process()
        process.context.make_current()
        process.depth += 1
        try:
            yield process.backend
        finally:
            process.depth -= 1
            if process.depth == 0:
                _release(process.backend.name, process.context)


def upload(
    model: mujoco.MjModel, tessellation: Tessellation, width: int, height: int
) -> Upload:
    """Return the model's assets in OpenGL. Call this inside :func:`current_context`.

    Args:
        model: The model; later changes of its assets have no effect.
        tessellation: Resolution of primitives and of the shadow map.
        width: Width of the off-screen buffer [px].
        height: Height of the off-screen buffer [px].
    """
    assert _process is not None
    pool = _process.pool
    assets = _assets(model)
    for found in pool:
        if found.tessellation == tessellation and _equal(found.assets, assets):
            pool.remove(found)
            break
    else:
        if len(pool) >= POOL_SIZE:
            evicted = pool.pop(0)
            evicted.drawing.free()
            evicted.drawing = None
        copies = {name: array.copy() for name, array in assets.items()}
        drawing = _draw_context(model, tessellation, width, height)
        found = Upload(drawing, tessellation, copies)
    pool.append(found)
    return found


def _draw_context(
    model: mujoco.MjModel, tessellation: Tessellation, width: int, height: int
) -> Any:
    """Create an ``MjrContext``; ignore the model's own visual quality."""
    settings, buffer = model.vis.quality, model.vis.global_
    ours = {
        "numslices": tessellation.slices,
        "numstacks": tessellation.stacks,
        "numquads": tessellation.quads,
        "shadowsize": tessellation.shadow_map_px,
        # One sample per pixel, because averaged depths are meaningless; in software, an
        # image of twice the size also costs less than four samples.
        "offsamples": 0,
    }
    theirs = {name: getattr(settings, name) for name in ours}
    size = buffer.offwidth, buffer.offheight
    try:
        for name, value in ours.items():
            setattr(settings, name, value)
        buffer.offwidth, buffer.offheight = width, height
        drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    finally:
        for name, value in theirs.items():
            setattr(settings, name, value)
        buffer.offwidth, buffer.offheight = size
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, drawing)
    # Floats are densest near zero: with far at zero, depth is accurate everywhere.
    drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
    return drawing


_ARRAYS = (
    *("mesh_vertadr", "mesh_faceadr", "mesh_facenum", "mesh_normaladr"),
    *("mesh_texcoordadr", "mesh_graphadr", "mesh_vert", "mesh_normal", "mesh_face"),
    *("mesh_facenormal", "mesh_facetexcoord", "mesh_texcoord", "mesh_graph"),
    *("hfield_size", "hfield_nrow", "hfield_ncol", "hfield_adr", "hfield_data"),
    *("tex_type", "tex_width", "tex_height", "tex_nchannel", "tex_colorspace"),
    *("tex_adr", "tex_data", "skin_vertnum", "skin_facenum", "skin_face"),
    *("skin_texcoordadr", "skin_texcoord"),
)


def _assets(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    """Return the arrays that ``mjr_makeContext`` reads from a model, except quality.

    MuJoCo sends colors and sizes of primitives with every image, so they are not part
    of it. Planes are, because each has a grid of its own.
    """
    assets = {name: getattr(model, name) for name in _ARRAYS}
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value
    assets["planes"] = model.geom_size[planes]
    material = model.geom_matid[planes]
    assets["plane_repeat"] = model.mat_texrepeat[material[material >= 0]]
    assets["plane_has_material"] = material >= 0
    textured = np.flatnonzero((model.mat_texid >= 0).any(axis=1))
    assets["materials"] = textured
    for name in ("mat_texid", "mat_texuniform", "mat_texrepeat"):
        assets[name] = getattr(model, name)[textured]
    view, extent = model.vis.map, model.stat.extent
    assets["view"] = np.array(
        [
            *(extent, view.zfar, view.fogstart, view.fogend, view.haze),
            *(view.shadowclip, view.shadowscale, model.vis.global_.linewidth),
            *(*model.vis.rgba.fog, *model.vis.rgba.haze),
        ]
    )
    return assets


def _equal(first: dict[str, NDArray[Any]], second: dict[str, NDArray[Any]]) -> bool:
    return all(np.array_equal(first[name], second[name]) for name in first)


def _this_process() -> _Process:
    global _process
    if _process is None:
        _process = _start()
        # Registered after the library's own function, so that it runs first: contexts
        # must be freed before the display.
        atexit.register(_stop)
        os.register_at_fork(after_in_child=_abandon)
    elif _process.pid != os.getpid():
        raise RenderingError(
            "This process was forked from one that had rendered already, and OpenGL "
            "does not survive a fork. Start workers with 'spawn' or 'forkserver' "
            "(multiprocessing.get_context('spawn'), or context='spawn' for "
            "AsyncVectorEnv), or fork before the first picture."
        )
    return _process


def _start() -> _Process:
    backend = choose_backend()
    threads = 0 if is_worker() else usable_cores()
    settings = {
        # MuJoCo reads it when it first loads OpenGL's functions.
        "MUJOCO_GL": backend.name,
        # By default Mesa counts all cores, not only those that this process may use.
        "LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS") or str(threads),
        # MuJoCo sets it if it is unset; child processes must not inherit that.
        "PYOPENGL_PLATFORM": os.environ.get("PYOPENGL_PLATFORM", ""),
    }
    messages: list[str] = []
    try:
        with _environment(settings), _silence(messages):
            module = importlib.import_module(f"mujoco.{backend.name}")
            context = module.GLContext(32, 32)
            context.make_current()
            _load_functions()
            _release(backend.name, context)
    except Exception as error:
        forget_backend()
        raise RenderingError(
            f"{backend.name} rendered in a child process, but not in this one: "
            f"{error!r} {' '.join(messages)}\nAnother package may have set up OpenGL "
            "differently in this process: import lemma and render first, or set "
            "MUJOCO_GL to the library that the other package uses."
        ) from error
    logger.debug("OpenGL: %s %s", backend, " ".join(messages))
    return _Process(os.getpid(), backend, context)


def _load_functions() -> None:
    """Make MuJoCo load OpenGL's functions, which it does once per process."""
    spec = mujoco.MjSpec()
    spec.visual.quality.shadowsize = 0
    spec.visual.global_.offwidth = spec.visual.global_.offheight = 32
    mujoco.MjrContext(spec.compile(), 100).free()


def _release(name: str, context: Any) -> None:
    """Release the context in this thread, so that another thread can use it."""
    module = sys.modules[f"mujoco.{name}"]
    if name == "egl":
        egl, nothing = module.EGL, module.EGL.EGL_NO_SURFACE
        egl.eglMakeCurrent(module.EGL_DISPLAY, nothing, nothing, egl.EGL_NO_CONTEXT)
    elif name == "osmesa":
        module.osmesa.OSMesaMakeCurrent(None, None, module.GL.GL_FLOAT, 0, 0)
    elif name == "glfw":
        module.glfw.make_context_current(None)
    elif name == "cgl":
        # MuJoCo's make_current acquires this lock and does not release it.
        module.cgl.CGLUnlockContext(context._context)
        module.cgl.CGLSetCurrentContext(None)


def _stop() -> None:
    """Free all contexts while the library is still loaded."""
    process = _process
    if process is None or process.pid != os.getpid():
        return
    with contextlib.suppress(Exception):
        process.context.make_current()
        for held in process.pool:
            held.drawing.free()
            held.drawing = None
        process.context.free()


def _abandon() -> None:
    """In a forked child: neither use nor free the parent's context."""
    global _lock
    _lock = threading.RLock()
    if _process is not None:
        # Both would wait for OpenGL's threads, which do not exist in the child.
        if _process.backend.name == "egl":
            atexit.unregister(sys.modules["mujoco.egl"].EGL.eglTerminate)
        for held in (_process.context, *(upload.drawing for upload in _process.pool)):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))


@contextlib.contextmanager
def _environment(settings: dict[str, str]) -> Iterator[None]:
    """Set environment variables inside the block; an empty value unsets one."""
    before = {name: os.environ.get(name) for name in settings}
    try:
        for name, value in settings.items():
            if value:
                os.environ[name] = value
            else:
                os.environ.pop(name, None)
        yield
    finally:
        for name, old in before.items():
            if old is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = old


@contextlib.contextmanager
def _silence(messages: list[str]) -> Iterator[None]:
    """Collect the output of C libraries to the error stream inside the block.

    Drivers print messages about every device that they cannot use.
    """
    with contextlib.ExitStack() as opened:
        try:
            saved = os.dup(2)
            opened.callback(os.close, saved)
            collected = opened.enter_context(tempfile.TemporaryFile())
        except OSError:
            # There is no error stream, or no folder for temporary files.
            yield
            return
        os.dup2(collected.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            collected.seek(0)
            messages.append(collected.read().decode(errors="replace").strip())
