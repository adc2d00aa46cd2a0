"""Builds KF-GINS and pyins from their own sources, to run beside ours: `python -m benchmarks.navigation.peers.build`.

Each goes into `.obu/peers`, where `make drives` finds it. A source is an address or a folder of git:
`--kf-gins FOLDER`, `--pyins FOLDER`. KF-GINS needs cmake, make and a C++ compiler; pyins gets its own environment.
Nothing of either becomes part of this project.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from .common import BUILT

KF_GINS, KF_GINS_COMMIT = "https://github.com/i2Nav-WHU/KF-GINS", "f39bc2e"
PYINS, PYINS_COMMIT = "https://github.com/nmayorov/pyins", "8377ede"


def main() -> int:
    """Build what was asked for; everything without a choice."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kf-gins", default=KF_GINS, help="address or folder of its sources")
    parser.add_argument("--pyins", default=PYINS, help="address or folder of its sources")
    parser.add_argument("--only", choices=("kf-gins", "pyins"), help="build one of the two")
    chosen = parser.parse_args()
    BUILT.mkdir(parents=True, exist_ok=True)
    try:
        if chosen.only != "pyins":
            build_kf_gins(chosen.kf_gins)
        if chosen.only != "kf-gins":
            build_pyins(chosen.pyins)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"could not be built: {error}; are git, cmake, make and a C++ compiler there?", file=sys.stderr)
        return 1
    return 0


def build_kf_gins(source: str) -> None:
    """Make its executable."""
    folder = checked_out(source, KF_GINS_COMMIT, BUILT / "KF-GINS", without="/dataset")
    build = folder / "build"
    run("cmake", "-S", folder, "-B", build, "-DCMAKE_BUILD_TYPE=Release")
    run("cmake", "--build", build, "--target", "KF-GINS", "--parallel", str(os.cpu_count()))
    print(f"KF-GINS is in {folder / 'bin' / 'KF-GINS'}")


def build_pyins(source: str) -> None:
    """Make an environment with it."""
    folder = checked_out(source, PYINS_COMMIT, BUILT / "pyins-source", without="/examples")
    run(sys.executable, "-m", "venv", BUILT / "pyins")
    run(BUILT / "pyins" / "bin" / "python", "-m", "pip", "install", "--quiet", folder)
    print(f"pyins is in {BUILT / 'pyins' / 'bin' / 'python'}")


def checked_out(source: str, commit: str, folder: Path, without: str) -> Path:
    """Clone a commit, without a folder of data."""
    if not (folder / ".git").is_dir():
        run("git", "clone", "--quiet", "--no-checkout", "--filter=blob:none", source, folder)
    run("git", "-C", folder, "sparse-checkout", "set", "--no-cone", "/*", f"!{without}")
    run("git", "-C", folder, "checkout", "--quiet", "--detach", commit)
    return folder


def run(*command: str | Path) -> None:
    """Run a program that must succeed."""
    subprocess.run([str(part) for part in command], check=True)


if __name__ == "__main__":
    sys.exit(main())
