"""Asks the databases of known weaknesses about the locked dependencies: `python deploy/audit.py`, run by `make audit`.

Python packages by pip-audit (PyPI's advisories), which is installed into an environment of its own beside this Python,
and JavaScript packages by npm. Exit status: 0 nothing is known, 1 a weakness is known, 2 a source could not be asked.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DASHBOARD = ROOT / "services" / "monitoring" / "status" / "dashboard"
ENVIRONMENT = Path(sys.prefix) / "audit"
TOOL = "pip-audit==2.10.1"
LOCKS = ("requirements-dev.lock",)  # which holds those of requirements.lock
MAX_DURATION_S = 300
MAX_REASON = 200  # characters
Run = Callable[[Sequence[str], Path], "subprocess.CompletedProcess[str]"]


class SourceUnavailable(Exception):
    """A source could not be asked."""


def run(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program; raises `SourceUnavailable` where it is missing, or takes longer than five minutes."""
    try:
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=MAX_DURATION_S)
    except OSError as error:
        raise SourceUnavailable(f"{command[0]} cannot be started: {error.strerror}") from error
    except subprocess.TimeoutExpired as error:
        raise SourceUnavailable(f"no answer within {MAX_DURATION_S} s") from error


def python_packages(execute: Run, environment: Path = ENVIRONMENT) -> list[str]:
    """One sentence a known weakness of a locked Python package; raises `SourceUnavailable`."""
    tool = environment / "bin" / "pip-audit"
    if not tool.exists():
        made = execute([sys.executable, "-m", "venv", str(environment)], ROOT)
        pip = [str(environment / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        made = made if made.returncode else execute([*pip, TOOL], ROOT)
        if made.returncode:
            raise SourceUnavailable(f"{TOOL} could not be installed: {_last(made.stderr)}")
    found: list[str] = []
    for lock in LOCKS:
        command = [str(tool), "--requirement", lock, "--disable-pip", "--require-hashes", "--format", "json",
                   "--progress-spinner", "off"]  # fmt: skip
        done = execute(command, ROOT)
        try:
            answers = json.loads(done.stdout)["dependencies"]
        except (ValueError, KeyError, TypeError) as error:
            raise SourceUnavailable(_last(done.stderr)) from error
        # pip-audit ends with 0 also where the source knew none of the packages, which is no answer about them.
        if unknown := sorted(answer["name"] for answer in answers if "vulns" not in answer):
            raise SourceUnavailable(f"it does not know {_some(unknown)} of {len(answers)} packages")
        found += [
            f"{answer['name']} {answer['version']}: {weakness['id']}, corrected in {_some(weakness['fix_versions'])}"
            for answer in answers
            for weakness in answer["vulns"]
        ]
    return found


def javascript_packages(execute: Run) -> list[str]:
    """One sentence a known weakness of a locked JavaScript package; raises `SourceUnavailable`."""
    done = execute(["npm", "audit", "--json"], DASHBOARD)
    try:
        answer = json.loads(done.stdout)
        packages = answer["vulnerabilities"]
    except (ValueError, KeyError, TypeError) as error:
        raise SourceUnavailable(_last(done.stderr)) from error
    return [
        f"{name} {package.get('range', '')}: {package.get('severity', 'unknown')}"
        for name, package in sorted(packages.items())
    ]


def _last(text: str) -> str:
    """The last line that says something, shortened."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and "A complete log" not in line]
    return lines[-1][:MAX_REASON] if lines else "it gave no answer"


def _some(names: Sequence[str]) -> str:
    """The first names of a list, and how many follow."""
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return (", ".join(names[:3]) or "no version yet") + more


def main(execute: Run = run) -> int:
    """Ask both sources; return the exit status."""
    status = 0
    for what, ask in (("Python packages", python_packages), ("JavaScript packages", javascript_packages)):
        try:
            found = ask(execute)
        except SourceUnavailable as reason:
            sys.stderr.write(f"{what}: the source could not be asked ({reason}); try again with internet\n")
            status = status or 2
            continue
        sys.stdout.writelines(f"{what}: {sentence}\n" for sentence in found or ["nothing is known"])
        status = 1 if found else status
    return status


if __name__ == "__main__":
    sys.exit(main())
