"""Install system packages: off-screen OpenGL and Python's venv module.

``make setup`` runs it before the installation of packages, so it uses the standard
library only. As root on Debian and Ubuntu it calls apt; elsewhere it prints the names
of the packages. With ``--browser``, for ``make setup-dev``, it does the same for
Chromium.
"""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys

EGL_PACKAGES = ["libegl1", "libgl1", "libgl1-mesa-dri"]
# Installed only if EGL fails, because newer distributions lack it.
OSMESA_PACKAGES = ["libosmesa6"]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
EGL_PLATFORM_DEVICE_EXT = 0x313F
MAX_DEVICES = 16


def main() -> int:
    """Prepare the machine; return the exit status."""
    if not has_venv():
        package = f"python{sys.version_info[0]}.{sys.version_info[1]}-venv"
        install([package])
        if not has_venv():
            say(f"Python's venv module is incomplete. Install it: {advice([package])}")
            return 1
    if sys.platform == "linux" and not has_opengl():
        install(EGL_PACKAGES)
        if not has_opengl():
            install(OSMESA_PACKAGES)
        if not has_opengl():
            say(
                "No library for off-screen OpenGL (EGL or OSMesa) works here, so "
                "images and videos cannot be rendered; the rest works. "
                f"Install one: {advice(EGL_PACKAGES)}"
            )
    return 0


def prepare_browser() -> int:
    """Install Chromium if there is no browser for the tests of pages; return 0."""
    if not has_browser() and sys.platform == "linux":
        install(["chromium"])
        if not has_browser():
            say(
                "There is no Chromium, so tests of pages in a browser are skipped. "
                f"Install it: {advice(['chromium'])}"
            )
    return 0


def has_browser() -> bool:
    """Return whether a supported browser for the tests is on the path."""
    return any(shutil.which(name) for name in BROWSERS)


def has_venv() -> bool:
    """Return whether ``python -m venv`` can install pip."""
    importlib.invalidate_caches()
    return all(importlib.util.find_spec(name) for name in ("venv", "ensurepip"))


def has_opengl() -> bool:
    """Return whether EGL or OSMesa works.

    The test runs in a child process, because a broken driver may crash it.
    """
    return any(
        subprocess.run(
            [sys.executable, __file__, "--probe", name],
            capture_output=True,
            check=False,
        ).returncode
        == 0
        for name in PROBES
    )


def egl_works() -> bool:
    """Return whether EGL starts on one of its devices, with MuJoCo's calls."""
    ctypes.CDLL("libGL.so.1")
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    pointer = ctypes.c_void_p
    query_devices = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, pointer, pointer)(
        egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    )
    get_display = ctypes.CFUNCTYPE(pointer, ctypes.c_int, pointer, pointer)(
        egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    )
    devices = (pointer * MAX_DEVICES)()
    count = ctypes.c_int()
    query_devices(MAX_DEVICES, devices, ctypes.byref(count))
    displays = (
        get_display(EGL_PLATFORM_DEVICE_EXT, device, None)
        for device in devices[: count.value]
    )
    return any(
        display and egl.eglInitialize(display, None, None) for display in displays
    )


def osmesa_works() -> bool:
    """Return whether OSMesa can be loaded."""
    return any(loads(name) for name in ("libOSMesa.so.8", "libOSMesa.so.6"))


def loads(library: str) -> bool:
    """Return whether a shared library can be loaded."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


PROBES = {"egl": egl_works, "osmesa": osmesa_works}


def install(packages: list[str]) -> None:
    """Install packages with apt if possible; otherwise do nothing."""
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        return
    say(f"Installing {' '.join(packages)} with apt ...")
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for arguments in (
        ["update"],
        ["install", "-y", "--no-install-recommends", *packages],
    ):
        done = subprocess.run(
            ["apt-get", "-qq", *arguments],
            env=environment,
            stdout=subprocess.DEVNULL,
            check=False,
        )
        if done.returncode != 0:
            say(f"apt-get {arguments[0]} failed (exit status {done.returncode}).")


def advice(packages: list[str]) -> str:
    """Return the command that installs packages."""
    names = " ".join(packages)
    return f"sudo apt-get install {names} (Debian, Ubuntu), or as your system does it."


def say(text: str) -> None:
    """Print a message to standard error."""
    print(f"setup: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--probe"]:
        sys.exit(not PROBES[sys.argv[2]]())
    sys.exit(prepare_browser() if sys.argv[1:2] == ["--browser"] else main())
