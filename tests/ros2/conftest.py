"""Real nodes in processes of their own, spoken to over DDS on loopback."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import pytest

HAVE_ROS = importlib.util.find_spec("rclpy") is not None
if not HAVE_ROS:
    # Told as skipped by the tests themselves; what they import is not there.
    collect_ignore = [
        "test_documented.py",
        "test_node.py",
        "test_parameters.py",
        "test_hosts.py",
        "test_spinning.py",
        "test_streaming.py",
    ]


@pytest.fixture(autouse=True, scope="session")
def _loopback() -> Iterator[None]:
    if not HAVE_ROS:
        yield
        return
    from peer import domain

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", domain())
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture
def peer() -> Iterator[Any]:
    from peer import Peer

    made = Peer()
    yield made
    made.close()


@pytest.fixture
def launch(tmp_path: Any, capsys: Any) -> Iterator[Callable[..., Any]]:
    """Start nodes that end with the test; what they said shows if it fails."""
    from peer import end, start

    running: list[Any] = []

    def launched(*arguments: str) -> Any:
        running.append(start(*arguments, cwd=tmp_path))
        return running[-1]

    yield launched
    for process in running:
        print(end(process))


@pytest.fixture(scope="module")
def shared_node(tmp_path_factory: Any) -> Iterator[Any]:
    """One active node for tests that leave it as it was."""
    from peer import Peer, end, start

    process = start(
        "default",
        "--autostart",
        "--ros-args",
        "-r",
        "__node:=shared",
        cwd=tmp_path_factory.mktemp("node"),
    )
    made = Peer("/shared")
    try:
        made.wait(lambda: made.state() == "active", "the node")
        yield made
    finally:
        made.close()
        print(end(process))
