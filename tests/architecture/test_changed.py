"""Which unit tests `make quick` runs for a change."""

from pathlib import PurePosixPath

from tests.support.cases import each
from tests.support.changed import folders


@each(("path", "tests"), [
    ("services/core/trust/verdict.py", ["tests/unit/core/trust"]),
    ("services/core/trust/words.toml", ["tests/unit/core/trust"]),
    ("services/core/fusion/aids/gnss/fix.py", ["tests/unit/core/fusion/aids/gnss"]),
    ("shared/maths/kalman.py", ["tests/unit/shared/maths"]),
    ("tests/unit/core/trust/test_verdict.py", ["tests/unit/core/trust/test_verdict.py"]),
    ("tests/integration/test_demo.py", []), ("docs/README.md", []), ("Makefile", []),
])  # fmt: skip
def test_the_tests_of_a_file_are_in_the_nearest_folder(path: str, tests: list[str]) -> None:
    assert [str(folder) for folder in folders([PurePosixPath(path)])] == tests


def test_a_folder_is_named_once_whatever_changed_in_it() -> None:
    paths = ["services/core/trust/verdict.py", "services/core/trust/hypotheses/beliefs.py",
             "tests/unit/core/trust/test_verdict.py", "shared/maths/kalman.py"]  # fmt: skip
    found = [str(folder) for folder in folders(map(PurePosixPath, paths))]
    assert found == ["tests/unit/core/trust", "tests/unit/shared/maths"]
