"""Each recipe of `docs/how-to/add`, followed in a copy of the tree, and without one of its steps.

`make quick` passes with the whole recipe, and fails without any one of its steps (`OBU_EVERY_STEP=1`; otherwise without
the first one of a recipe that is slow).
"""

import os
from collections.abc import Iterator
from pathlib import PurePosixPath

import pytest
from _pytest.mark import ParameterSet

from tests.support.changed import folders
from tests.support.recipes.examples import EXAMPLES
from tests.support.recipes.recipe import FOLDER, Step, steps_of
from tests.support.recipes.tree import Edit, Tree

ALWAYS = (PurePosixPath("tests/architecture"), PurePosixPath("tests/unit/shared/words"))  # of `make quick`
EVERY = "OBU_EVERY_STEP"  # environment variable
FAST = ("setting",)  # stands for all of them in `make test`
PRINTED = "test_what_is_printed_is_what_the_code_says"
RECIPES = sorted(EXAMPLES)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    return Tree(tmp_path_factory.mktemp("tree"))


@pytest.fixture
def tree(copy: Tree) -> Iterator[Tree]:
    yield copy
    copy.restore()


def paired(recipe: str) -> list[tuple[Step, tuple[Edit, ...]]]:
    """Steps of a page with what the example does at each."""
    example = iter(EXAMPLES[recipe])
    return [(step, () if step.command else next(example)) for step in steps_of(recipe)]


def cases() -> list[ParameterSet]:
    """Each file of each step, and each step that prints; of slow recipes the first step, unless all are wanted."""
    found = []
    for recipe in RECIPES:
        marks = () if recipe in FAST else pytest.mark.slow
        for step, edits in paired(recipe):
            if recipe not in FAST and step.number > 1 and not os.environ.get(EVERY):
                continue
            for path in sorted({edit.path for edit in edits}) or [""]:
                name = f"{recipe}-{step.number}-{PurePosixPath(path).name}"
                found.append(pytest.param(recipe, step.number, path, marks=marks, id=name))
    return found


def test_every_page_has_an_example_and_every_example_a_page() -> None:
    assert {path.stem for path in FOLDER.glob("*.md")} == set(EXAMPLES)


@pytest.mark.parametrize("recipe", RECIPES)
def test_page_and_example_name_the_same_files(recipe: str) -> None:
    steps = steps_of(recipe)
    assert [step.number for step in steps] == list(range(1, len(steps) + 1))
    assert len([step for step in steps if not step.command]) == len(EXAMPLES[recipe])
    for step, edits in paired(recipe):
        if not step.command:
            others = [edit.path for edit in edits if not step.names(edit.path)]
            assert not others, f"step {step.number} of {recipe} does not name {others}"
        unused = [file for file in step.files if not any(Step(0, "", (file,), ()).names(e.path) for e in edits)]
        assert step.command or not unused, f"the example of {recipe} leaves out {unused} of step {step.number}"


@pytest.mark.parametrize("recipe", RECIPES)
def test_make_quick_runs_the_tests_that_fail_without_a_step(recipe: str) -> None:
    pairs = paired(recipe)
    touched = [PurePosixPath(edit.path) for _, edits in pairs for edit in edits]
    run = (*ALWAYS, *folders(touched))
    for step, edits in pairs:
        assert step.failing, f"step {step.number} of {recipe} names no test"
        for test in step.tests(edit.path for edit in edits):
            path = PurePosixPath(test.partition("::")[0])
            assert step.command or PRINTED not in test, f"step {step.number} is not noticed by what is printed"
            assert any(path.is_relative_to(folder) for folder in run), f"{test} is not run by make quick"


@pytest.mark.parametrize("recipe", [
    pytest.param(recipe, marks=() if recipe in FAST else pytest.mark.slow) for recipe in RECIPES
])  # fmt: skip
def test_the_whole_recipe_passes(recipe: str, tree: Tree) -> None:
    pairs = paired(recipe)
    edits = [edit for _, made in pairs for edit in made]
    tree.edit(edits)
    for step, _ in pairs:
        if step.command:
            printed = tree.printed(step.command)
            assert printed == set(step.files), f"{step.what} prints {sorted(printed)} in recipe {recipe}"
    python = sorted({edit.path for edit in edits if edit.path.endswith(".py")})
    for rule in (("check", "--fix", "--quiet"), ("format", "--quiet"), ("check",)):
        result = tree.run("-m", "ruff", *rule, *python)
        assert result.returncode == 0, result.stdout
    result = tree.test(test for step, made in pairs for test in step.tests(edit.path for edit in made))
    assert result.returncode == 0, result.stdout[-4000:]


@pytest.mark.parametrize(("recipe", "number", "left_out"), cases())
def test_what_is_left_out_fails(recipe: str, number: int, left_out: str, tree: Tree) -> None:
    pairs = paired(recipe)
    ((step, missing),) = [pair for pair in pairs if pair[0].number == number]
    tree.edit(
        edit for other, edits in pairs for edit in edits if not (other.number == number and edit.path == left_out)
    )
    result = tree.test(step.tests(edit.path for edit in missing))
    assert result.returncode in (1, 2, 4), f"no test fails without {left_out or step.what}: {result.stdout[-2000:]}"
