"""What the nodes' processes inherit: discovery kept to this host, threads, logging, and quick, roomy DDS."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
PROFILE = Path(__file__).with_name("data") / "fastdds.xml"


def node_environment(*, domain_id: int | None = None, network: bool = False) -> dict[str, str]:
    """A copy of this process's environment with what a node needs.

    Without ``network``, discovery stays on this host unless ``ROS_AUTOMATIC_DISCOVERY_RANGE`` says otherwise.
    A Fast DDS profile chosen by the user is left alone.
    """
    environment = dict(os.environ)
    environment |= dict.fromkeys(THREADS, "1")  # small matrices: a second thread only costs
    if network:
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    else:
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(domain_id)
    environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILE))
    environment.setdefault("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{severity} {message}")
    environment.setdefault("RCUTILS_COLORIZED_OUTPUT", "0")  # the supervisor colours by node
    environment["PYTHONUNBUFFERED"] = "1"
    return environment


def adopt(environment: dict[str, str]) -> None:
    """Let this process's own participants have the same; to be called before the first is made."""
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_DOMAIN_ID"):
        if name in environment:
            os.environ[name] = environment[name]


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let what this process starts meanwhile finish its batch of messages before another process gets the core.

    Otherwise every message wakes its takers at once: several thousand changes of process a second, for nothing.
    """
    policy = os.sched_getscheduler(0)
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, os.sched_param(0))


@contextmanager
def private_domain() -> Iterator[int]:
    """A DDS domain that no other replay on this host uses, so that a replay never meets a vehicle's live nodes."""
    try:
        from domain_coordinator import domain_id
    except ImportError:
        yield 1 + os.getpid() % 100
        return
    with domain_id() as chosen:
        yield chosen
