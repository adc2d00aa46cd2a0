"""A test with many cases fails with all that fail, and takes fixtures as any other."""

import pytest

from tests.support.cases import crossed, each


@each(("number", "factor"), [(1, 2), pytest.param(3, 4, id="odd")])
@each("sign", [1, -1])
def over_products(number: int, factor: int, sign: int, most: int) -> None:
    assert sign * number * factor <= most
    with pytest.raises(ZeroDivisionError):
        raise ZeroDivisionError if number < 4 else ValueError


def test_every_case_is_run_and_all_that_fail_are_named() -> None:
    over_products(most=12)
    with pytest.raises(BaseExceptionGroup) as caught:
        over_products(most=1)
    assert "2 of 2 cases fail, with number = 1, factor = 2; with number = 3, factor = 4" in str(caught.value)
    assert caught.group_contains(AssertionError, depth=2)


def test_a_case_that_raises_nothing_where_it_should_fails() -> None:
    @each("value", [1])
    def never_raises(value: int) -> None:
        with pytest.raises(ValueError, match="x"):
            abs(value)

    with pytest.raises(BaseExceptionGroup, match="1 of 1 cases fail, with value = 1"):
        never_raises()


@each("value", [1, 2])
def test_fixtures_are_given_to_every_case(value: int, request: pytest.FixtureRequest) -> None:
    assert request.fixturenames == ["request"] and value


def test_names_that_the_test_does_not_take_and_no_cases_are_mistakes() -> None:
    with pytest.raises(AssertionError, match="takes no"):
        each("other", [1])(test_every_case_is_run_and_all_that_fail_are_named)
    with pytest.raises(AssertionError, match="there is no case of value"):
        each("value", [])


@pytest.mark.parametrize(("rows", "columns"), [("abc", "xyz"), ("abc", "xy"), ("ab", "wxyz"), ("a", "x")])
def test_every_row_and_every_column_of_a_cross_is_tested_always(rows: str, columns: str) -> None:
    found = [value.values for value in crossed(rows, columns) if not value.marks]  # type: ignore[attr-defined]
    assert {row for row, _ in found} == set(rows) and {column for _, column in found} == set(columns)
    assert len(found) == max(len(rows), len(columns)) and len(crossed(rows, columns)) == len(rows) * len(columns)
