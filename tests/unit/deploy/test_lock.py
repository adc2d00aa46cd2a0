"""The hashes of the lock files, with an index of the test's own in place of pip's."""

from collections.abc import Mapping

import pytest

from deploy.lock import MACHINES, PYTHONS, Ask, Files, PackageFileMissing, hashes, lock_text

VERSIONS = {"any": "1.0", "compiled": "2.0", "source": "3.0"}


def index(files: Mapping[tuple[str, str, str], str], sources: Mapping[str, str], asked: list[int]) -> Ask:
    """What pip would answer: wheels by name, machine and Python ("*" for all), and source archives by name."""

    def ask(versions: Mapping[str, str], options: list[str]) -> Files:
        asked.append(len(versions))
        if "--no-binary" in options:
            (name,) = versions
            if name not in sources:
                raise PackageFileMissing(name)
            return {name: sources[name]}
        python = options[options.index("--python-version") + 1]
        (machine,) = {machine for machine in MACHINES if f"linux_{machine}" in options}
        found = {}
        for name in versions:
            digest = files.get((name, "*", "*")) or files.get((name, machine, python))
            if digest is None:
                raise PackageFileMissing(name)
            found[name] = digest
        return found

    return ask


WHEELS = {("any", "*", "*"): "a"} | {
    ("compiled", machine, python): f"{machine}-{python}" for machine in MACHINES for python in PYTHONS
}


def test_every_wheel_of_every_python_and_machine_is_pinned() -> None:
    found, said = hashes({"any": "1.0", "compiled": "2.0"}, index(WHEELS, {}, []))
    assert said == []
    assert found == {"any": {"a"}, "compiled": {f"{m}-{p}" for m in MACHINES for p in PYTHONS}}


def test_a_package_without_wheels_is_pinned_by_its_source() -> None:
    asked: list[int] = []
    found, said = hashes(VERSIONS, index(WHEELS, {"source": "s"}, asked))
    assert found["source"] == {"s"}
    assert len(said) == 1
    assert said[0].startswith("source 3.0: no wheel for x86_64 with Python 3.11, ")
    assert asked.count(3) == 1, "what has no wheel once is asked for alone afterwards"


def test_a_missing_wheel_of_one_machine_is_said_and_no_failure() -> None:
    some = {key: digest for key, digest in WHEELS.items() if key[1:] != ("aarch64", "3.14")}
    found, said = hashes({"any": "1.0", "compiled": "2.0"}, index(some, {}, []))
    assert "aarch64-3.13" in found["compiled"]
    assert said == [
        "compiled 2.0: no wheel for aarch64 with Python 3.14; "
        "and there is no source archive: it cannot be installed there"
    ]


def test_an_index_that_cannot_be_asked_is_an_error() -> None:
    def ask(versions: Mapping[str, str], options: list[str]) -> Files:
        raise RuntimeError("no route to host")

    with pytest.raises(RuntimeError, match="no route"):
        hashes(VERSIONS, ask)


def test_a_line_is_one_package_with_its_hashes_in_order() -> None:
    text = lock_text({"b": "2", "a": "1"}, {"a": ["f0", "0f"], "b": ["cc"]})
    assert text == "a==1 --hash=sha256:0f --hash=sha256:f0\nb==2 --hash=sha256:cc\n"
