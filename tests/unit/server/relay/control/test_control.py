"""The control object."""


async def test_describing_a_robot_keeps_nothing_of_it(relay, sim1):
    """A fleet page that lists thousands of offline robots costs the relay no memory."""
    relay.relay.fleet_events.describe(sim1)
    assert not relay.relay.registry.robots()
