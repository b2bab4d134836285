"""Fixtures that image and end-to-end tests share: one running stack for the whole run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from stack import Stack

# Begun in this order, before all others: of workers that take file after file, none is to run alone at the end
# because of one that takes minutes.
LONGEST_FIRST = (
    "ansible/test_enroll.py",
    "ansible/test_join_line.py",
    "ansible/test_upgrade.py",
    "ansible/test_docker_runtime.py",
    "ansible/test_agent_deb.py",
    "ansible/test_collection.py",
    "e2e/test_cells.py",
    "e2e/test_ros2.py",
    "e2e/test_layout.py",
    "e2e/test_driving.py",
    "images/test_jump_ends.py",
    "e2e/test_admin_pages.py",
    "e2e/test_accessibility.py",
    "images/test_swarm.py",
    "images/test_standby.py",
    "images/test_upgrade.py",
    "images/test_plain_compose.py",
    "e2e/test_direct.py",
    "e2e/test_fleet_page.py",
    "images/test_jump.py",
    "e2e/test_control.py",
    "e2e/test_documents.py",
    "e2e/test_panels.py",
    "e2e/test_attacks_inside.py",
    "images/test_compose.py",
    "images/test_sshd.py",
    "e2e/test_client.py",
    "images/test_secrets.py",
    "e2e/test_video.py",
    "images/test_key_lookup.py",
    "images/test_certificate.py",
    "e2e/test_recovery.py",
    "e2e/test_safety.py",
    "images/test_acme.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put long files first; within a file the tests stay as they are."""
    places = {f"tests/{name}": place for place, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: places.get(item.nodeid.split("::")[0], len(places)))


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The whole stack with three simulated robots, removed at the end."""
    running = Stack(tmp_path_factory.mktemp("stack"))
    try:
        running.up()
        yield running
    finally:
        running.down()
