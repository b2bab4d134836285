"""The lines between cells, without a network; the tests of feeds show each kind."""

import pytest
from robotether_server.contract.robots import LiveState
from robotether_server.problems import ProtocolError
from robotether_server.relay.cells.messages import PeerHello, PeerRobot, build, parse


def test_cells_of_other_versions_understand_each_other():
    """Members that an older cell does not send have defaults; what a newer one says beside is passed over."""
    text = '{"type":"robot","robot_id":7,"epoch":12,"online":true,"object":{"ros":"ok"}}'
    robot = PeerRobot(7, 12, online=True, object=LiveState(ros="ok"))
    assert parse(text) == robot
    assert parse(build(robot)) == robot
    assert parse('{"type":"weather","robot_id":7}') is None
    assert parse('{"type":"hello","cell":"a","weather":"fine"}') == PeerHello("a")


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        '{"type":7}',
        '{"type":"hello"}',
        '{"type":"stop","robot_id":7,"at":"noon","by":"ben"}',
        "[" * 10_000,
    ],
)
def test_what_breaks_the_contract_is_no_message(text):
    """It must not be taken for one of a newer cell."""
    with pytest.raises(ProtocolError):
        parse(text)
