"""The control object, and who is notified of changes."""


async def test_describing_a_robot_keeps_nothing_of_it(relay, sim1):
    """A fleet page that lists thousands of offline robots costs the relay no memory."""
    relay.relay.fleet_events.describe(sim1)
    assert not relay.relay.registry.robots()


async def test_a_watcher_hears_inside_the_block(relay, guarded, sim1):
    heard = []
    control = relay.relay.control
    with control.watched(sim1.id, lambda: heard.append(1)):
        control.stops.stop(sim1, "ben")
        assert heard
    heard.clear()
    await control.stops.confirmation(sim1.id)
    assert heard == []
    assert not relay.relay.registry.robot(sim1.id).control_watchers
