"""The right that each command of the operator needs."""

from services.monitoring.status.web.access.rights import Right
from services.monitoring.status.web.command import right_of
from shared.messages.operation import OperatorCommand


def test_a_position_is_confirmed_by_an_administrator_and_everything_else_asked_for_by_an_operator() -> None:
    needed = {command: right_of(command) for command in OperatorCommand}
    assert needed.pop(OperatorCommand.CONFIRM_POSITION) is Right.ADMIN
    assert set(needed.values()) == {Right.OPERATE}
