"""Set up the checkout on the first start, then become the DeepSeis command.

Standard library only. Everything stays inside the checkout:

    .venv/    the virtual environment of requirements.lock, dressed as a ROS 2 underlay
    .build/   the colcon workspace (build, install, log), set-up log and cached environment

Either is finished when its stamp is, which is written last; what an interruption left is redone.
"""

import fcntl
import hashlib
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "ws" / "src"
LOCK = ROOT / "requirements.lock"
CMAKE_HOOK = ROOT / "tools" / "ros_wheels.cmake"
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
VENV_STAMP = VENV / ".complete"
KERNEL_CACHES = 4
"""Folders of compiled kernels that are kept."""
BUILD = ROOT / ".build"
BUILDING = BUILD / "building"
ENVIRONMENT = BUILD / "environment.json"
LOG = BUILD / "setup.log"

UNDERLAY = """\
# Makes this virtual environment a ROS 2 underlay, as /opt/ros/jazzy/{name} is.
export PATH="{venv}/bin:$PATH"
export AMENT_PREFIX_PATH="{venv}${{AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}}"
export CMAKE_PREFIX_PATH="{venv}${{CMAKE_PREFIX_PATH:+:$CMAKE_PREFIX_PATH}}"
export LD_LIBRARY_PATH="{libraries}${{LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}}"
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
"""


class SetupError(Exception):
    """Something a person has to put right; the message is the one line to read."""


def main() -> NoReturn:
    """Set up what is missing, then run the command in the workspace's environment."""
    try:
        environment = cached_environment() or set_up()
    except SetupError as error:
        sys.exit(f"deepseis: {error}")
    except KeyboardInterrupt:
        sys.stderr.write("\ndeepseis: set-up interrupted; the next start takes it up again\n")
        sys.exit(130)
    become(sys.argv[1:], full_environment(environment))


def become(arguments: list[str], environment: dict[str, str]) -> NoReturn:
    """Replace this process by the command (or, for developers, by `python` or `env`)."""
    if arguments[:1] == ["env"]:
        changed = {k: v for k, v in sorted(environment.items()) if os.environ.get(k) != v}
        sys.stdout.writelines(f"export {k}={shlex.quote(v)}\n" for k, v in changed.items())
        sys.exit(0)
    if arguments[:1] == ["python"]:
        command = [str(PYTHON), *arguments[1:]]
    else:
        command = [str(PYTHON), "-m", "deepseis_bringup.cli", *arguments]
    os.execve(command[0], command, environment)


# --- what is up to date -------------------------------------------------------------------------


def venv_digest() -> str:
    """Identify the virtual environment: place and pins."""
    return hashlib.sha256(f"{ROOT}\n".encode() + LOCK.read_bytes()).hexdigest()


def build_pins() -> str:
    """Return the pins that what is compiled depends on: others may change without a rebuild."""
    names = (
        "ros-",
        "colcon-",
        "catkin",
        "cmake=",
        "empy=",
        "lark",
        "ninja=",
        "numpy=",
        "setuptools=",
    )
    return "\n".join(line for line in LOCK.read_text().splitlines() if line.startswith(names))


def build_place() -> str:
    """Identify what a workspace cannot outlive: its place, the interpreter, those pins."""
    parts = f"{ROOT}\n{read_text(VENV / '.place')}\n{build_pins()}"
    return hashlib.sha256(parts.encode()).hexdigest()


def build_inputs() -> Iterator[tuple[str, bytes]]:
    """List what a build depends on; Python modules are linked and need none."""
    yield "tools", CMAKE_HOOK.read_bytes() + Path(__file__).read_bytes()
    for package in sorted(path.parent for path in SOURCES.glob("*/package.xml")):
        for name in ("package.xml", "CMakeLists.txt", "setup.py", "setup.cfg"):
            path = package / name
            if path.exists():
                yield str(path.relative_to(SOURCES)), path.read_bytes()
        for path in interfaces(package):
            yield str(path.relative_to(SOURCES)), path.read_bytes()
        for folder in ("launch", "config", "scenarios", "resource"):
            for path in sorted((package / folder).rglob("*.*" if folder != "resource" else "*")):
                yield str(path.relative_to(SOURCES)), b""


def interfaces(package: Path) -> list[Path]:
    """List the message, service and action files of a package."""
    return sorted(
        path for kind in ("msg", "srv", "action") for path in package.glob(f"{kind}/*.{kind}")
    )


def build_digest() -> str:
    """Identify the built workspace: environment and inputs."""
    digest = hashlib.sha256(build_place().encode())
    for name, content in build_inputs():
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def venv_is_complete() -> bool:
    """Tell whether the virtual environment is that of the lock file."""
    return PYTHON.exists() and read_text(VENV_STAMP) == f"{venv_digest()} {chosen_python()}"


def chosen_python() -> str:
    """Name the interpreter that $DEEPSEIS_PYTHON asks for, or the environment's present one."""
    wanted = os.environ.get("DEEPSEIS_PYTHON")
    present = read_text(VENV_STAMP).partition(" ")[2]
    return os.path.realpath(sys.executable) if wanted or not present else present


def cached_environment() -> dict[str, str] | None:
    """Return the workspace's environment if it is up to date, without locking anything."""
    try:
        cache = json.loads(ENVIRONMENT.read_text())
    except (OSError, ValueError):
        return None
    if not venv_is_complete() or cache["digest"] != build_digest():
        return None
    return cache["environment"]


def full_environment(workspace: dict[str, str]) -> dict[str, str]:
    """Lay the workspace's variables over the caller's; only search paths are joined."""
    environment = {**os.environ, **workspace}
    for name in ("PATH", "LD_LIBRARY_PATH"):
        entries = [*workspace.get(name, "").split(":"), *os.environ.get(name, "").split(":")]
        environment[name] = ":".join(dict.fromkeys(entry for entry in entries if entry))
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault("ROS_LOG_DIR", str(BUILD / "ros_log"))
    environment.setdefault("NUMBA_CACHE_DIR", str(kernel_cache()))
    return environment


def kernel_cache() -> Path:
    """Name the folder of compiled kernels, one for each state of all their sources.

    Numba looks at a kernel's own file only: with one folder for all, a kernel would go on calling
    what another file held when it was compiled.
    """
    digest = hashlib.sha256()
    for path in sorted((ROOT / "ws" / "src").glob("*/deepseis_*/**/*.py")):
        content = path.read_bytes()
        if b"njit" in content or path.name == "constants.py":
            digest.update(f"{path.name} {len(content)}\n".encode() + content)
    folder = VENV / "numba_cache" / digest.hexdigest()[:16]
    if not folder.is_dir():
        known = sorted(folder.parent.glob("*"), key=lambda item: item.stat().st_mtime)
        for old in known[: max(0, len(known) - KERNEL_CACHES + 1)]:
            shutil.rmtree(old, ignore_errors=True) if old.is_dir() else old.unlink()
        folder.mkdir(parents=True, exist_ok=True)
    return folder


# --- set-up -------------------------------------------------------------------------------------


def set_up() -> dict[str, str]:
    """Bring environment and workspace up to date, one process at a time."""
    with exclusively():
        environment = cached_environment()
        if environment is not None:
            return environment
        LOG.write_text("")
        started = time.monotonic()
        if shutil.which("g++") is None:
            raise SetupError("no C++ compiler found: apt-get install g++")
        if not venv_is_complete():
            make_venv()
        environment = build_workspace()
        say(f"ready after {time.monotonic() - started:.0f} s")
        return environment


@contextmanager
def exclusively() -> Iterator[None]:
    """Hold the checkout's set-up lock; freed when this process and its tools have ended."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another start is setting up, waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        os.set_inheritable(file.fileno(), True)  # a killed start may leave pip or colcon running
        yield


def make_venv() -> None:
    """Install the lock file's packages, into the present environment if that is whole."""
    ENVIRONMENT.unlink(missing_ok=True)
    python = chosen_python()
    place_and_python = read_text(VENV / ".place")
    whole = VENV_STAMP.exists() and PYTHON.exists() and place_and_python == f"{ROOT} {python}"
    if not whole:
        say(f"making .venv with Python {sys.version_info.major}.{sys.version_info.minor}")
        shutil.rmtree(VENV, ignore_errors=True)
        call(
            [sys.executable, "-I", "-m", "venv", str(VENV)], "cannot make the virtual environment"
        )
    VENV_STAMP.unlink(missing_ok=True)
    install_packages()
    make_underlay()
    write_text(VENV / ".place", f"{ROOT} {python}")
    write_text(VENV_STAMP, f"{venv_digest()} {python}")


def install_packages() -> None:
    """Install every pin, and remove what is no longer one."""
    pins = {
        normalised(line.partition("==")[0])
        for line in LOCK.read_text().splitlines()
        if "==" in line
    }
    say(f"installing {len(pins)} packages of requirements.lock")
    seen = 0

    def progress(line: str) -> None:
        nonlocal seen
        if line.startswith("Collecting "):
            seen += 1
            if seen % 50 == 0:
                say(f"  {seen} fetched")
        elif line.startswith("Installing collected"):
            say("  unpacking")

    pip = [str(PYTHON), "-m", "pip", "--disable-pip-version-check", "--no-input"]
    install = [
        *pip,
        "install",
        "--no-deps",
        "--no-compile",
        "--progress-bar",
        "off",
        "-r",
        str(LOCK),
    ]
    call(install, "cannot install the packages (is there a network?)", progress)
    installed = site_packages().glob("*.dist-info/RECORD")  # not what ROS wheels merely contain
    names = {normalised(path.parent.name.partition("-")[0]) for path in installed}
    superfluous = sorted(names - pins - {"pip"})
    if superfluous:
        call([*pip, "uninstall", "--yes", *superfluous], "cannot remove old packages")
    call([str(PYTHON), "-I", "-m", "compileall", "-q", "-j", "0", str(site_packages())], None)


def make_underlay() -> None:
    """Give the virtual environment the set-up files that colcon expects of an underlay."""
    # The wheels' own start-up code finds these and starts Python again; the guard spares that.
    libraries = ":".join(
        [str(VENV / "lib"), *sorted(map(str, site_packages().glob("ros_*.libs")))]
    )
    for name in ("setup.sh", "setup.bash", "local_setup.sh", "local_setup.bash"):
        write_text(VENV / name, UNDERLAY.format(name=name, venv=VENV, libraries=libraries))


def build_workspace() -> dict[str, str]:
    """Run colcon over ws/src and cache the environment it gives."""
    digest = build_digest()
    if BUILDING.exists() or read_text(BUILD / "place") != build_place():
        for name in ("build", "install", "log"):
            shutil.rmtree(BUILD / name, ignore_errors=True)
    forget_removed_interfaces()
    write_text(BUILDING, "")
    write_text(BUILD / "place", build_place())
    say("building the workspace")

    def progress(line: str) -> None:
        if line.startswith(("Finished <<<", "Failed   <<<")):
            say("  " + line.replace("Finished <<< ", "").strip())

    failed = not call(colcon(), None, progress, environment=underlay_environment())
    BUILDING.unlink()  # an error leaves a tree that colcon can take up; an interruption may not
    if failed:
        raise SetupError(f"the build failed; all of it in {LOG}\n{tail()}")
    environment = sourced_environment()
    write_text(ENVIRONMENT, json.dumps({"digest": digest, "environment": environment}, indent=1))
    return environment


def colcon() -> list[str]:
    """Compose the build command."""
    definitions = {
        "CMAKE_PROJECT_INCLUDE": CMAKE_HOOK,
        "CMAKE_BUILD_TYPE": "Release",
        "BUILD_TESTING": "OFF",
        "Python3_EXECUTABLE": PYTHON,
    }
    cmake = [
        "-G",
        "Ninja",
        "--no-warn-unused-cli",
        *(f"-D{k}={v}" for k, v in definitions.items()),
    ]
    return [
        *(
            str(PYTHON),
            "-m",
            "colcon",
            "--log-base",
            str(BUILD / "log"),
            "build",
            "--symlink-install",
        ),
        *("--base-paths", str(SOURCES), "--build-base", str(BUILD / "build")),
        *("--install-base", str(BUILD / "install"), "--event-handlers", "console_cohesion+"),
        *("--cmake-args", *cmake),
    ]


def forget_removed_interfaces() -> None:
    """Drop what was built of a package whose list of interfaces has changed."""
    for package in SOURCES.glob("*/CMakeLists.txt"):
        name = package.parent.name
        names = "\n".join(path.name for path in interfaces(package.parent))
        if read_text(BUILD / f"{name}.interfaces") != names:
            shutil.rmtree(BUILD / "build" / name, ignore_errors=True)
            shutil.rmtree(BUILD / "install" / name, ignore_errors=True)
            write_text(BUILD / f"{name}.interfaces", names)


def clean_environment() -> dict[str, str]:
    """Keep of the caller's environment what has nothing to do with ROS or Python."""
    foreign = (
        "AMENT_",
        "CMAKE_PREFIX",
        "COLCON_",
        "ROS_",
        "RMW_",
        "PYTHON",
        "LD_LIBRARY",
        "VIRTUAL_ENV",
        "_ROS_",
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    path = environment.get("PATH", os.defpath).split(":")
    environment["PATH"] = ":".join(p for p in path if not p.startswith(("/opt/ros", str(ROOT))))
    return environment


def underlay_environment() -> dict[str, str]:
    """Return the environment after the underlay's setup.bash."""
    # With MAKEFLAGS set, colcon does not hold compilers back while the machine does other work.
    return source(VENV / "setup.bash") | {"MAKEFLAGS": f"-j{os.cpu_count() or 2}"}


def sourced_environment() -> dict[str, str]:
    """Return the variables that the workspace's setup.bash sets, sources first on PYTHONPATH."""
    before = clean_environment()
    after = source(BUILD / "install" / "setup.bash")
    changed = {
        k: v for k, v in after.items() if before.get(k) != v and k not in ("_", "PWD", "SHLVL")
    }
    changed["PATH"] = changed["PATH"].removesuffix(":" + before["PATH"])
    packages = sorted(str(path.parent) for path in SOURCES.glob("*/setup.py"))
    changed["PYTHONPATH"] = ":".join([*packages, changed["PYTHONPATH"]])
    changed["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    return changed


def source(script: Path) -> dict[str, str]:
    """Return the environment after sourcing a bash script in a clean one."""
    command = ["bash", "--norc", "-c", 'source "$0" >&2 && env -0', str(script)]
    result = subprocess.run(command, env=clean_environment(), capture_output=True, text=True)
    if result.returncode:
        raise SetupError(f"cannot source {script}\n{result.stderr}")
    return dict(entry.partition("=")[::2] for entry in result.stdout.split("\0") if entry)


# --- small things -------------------------------------------------------------------------------


def call(
    command: list[str],
    complaint: str | None,
    progress: Callable[[str], None] | None = None,
    environment: dict[str, str] | None = None,
) -> bool:
    """Run a command with its output in the log; on failure complain, or return false."""
    if environment is None:
        environment = clean_environment()
    with LOG.open("a") as log:
        log.write(f"\n$ {shlex.join(command)}\n")
        process = subprocess.Popen(
            command,
            env=environment,
            cwd=ROOT,
            text=True,
            errors="replace",
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            close_fds=False,
        )
        try:
            for line in process.stdout or ():
                log.write(line)
                if progress is not None:
                    progress(line)
            failed = process.wait() != 0
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if failed and complaint is not None:
        raise SetupError(f"{complaint}; all of it in {LOG}\n{tail()}")
    return not failed


def tail(lines: int = 20) -> str:
    """Return the last lines of the log, indented."""
    text = LOG.read_text(errors="replace").rstrip().splitlines()
    return "\n".join("    " + line for line in text[-lines:])


def say(text: str) -> None:
    """Tell the person at the terminal; standard output belongs to the command."""
    sys.stderr.write(f"[deepseis] {text}\n")
    sys.stderr.flush()


def site_packages() -> Path:
    """Return the virtual environment's package folder."""
    return next((VENV / "lib").glob("python3.*/site-packages"))


def normalised(name: str) -> str:
    """Return a package name as PEP 503 compares them."""
    return name.strip().lower().replace("_", "-").replace(".", "-")


def read_text(path: Path) -> str:
    """Return a small file's text, empty if there is none."""
    try:
        return path.read_text()
    except OSError:
        return ""


def write_text(path: Path, text: str) -> None:
    """Write a small file all or nothing."""
    scratch = path.with_name(path.name + ".new")
    scratch.write_text(text)
    scratch.replace(path)


if __name__ == "__main__":
    main()
