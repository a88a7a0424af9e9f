"""Running a node to its end: executor, signals, exit status."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

FOREVER_S = 1e9


def make_executor(context: Context | None = None) -> Executor:
    """The events executor, which costs a third of the others' CPU; where rclpy has none, the single-threaded one."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Executor, future: Future[Any] | None = None, timeout_s: float = FOREVER_S) -> None:
    """Serve callbacks until the future is done, the time is over, or the context is shut down.

    ``EventsExecutor.spin`` itself hangs where it was built for an older C library: its unbounded wait never returns.
    """
    executor.spin_until_future_complete(future or Future(), timeout_sec=timeout_s)


def run_node(create: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT or SIGTERM; 0 after a clean end, 1 (and one clear line) if it cannot start."""
    rclpy.init(args=None if args is None else list(args))
    node: Node | None = None
    executor = None
    try:
        node = create()
        gc.collect()
        gc.freeze()  # modules, kernels, maps: they live as long as the node, and looking at them takes 0.1 s each time
        executor = make_executor()
        executor.add_node(node)
        spin(executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        if type(error).__module__.startswith("fbn_"):  # a parameter, a map: it says what to do
            print(f"ERROR {error}", file=sys.stderr, flush=True)
            return 1
        if rclpy.ok() or type(error).__name__ != "RCLError":  # a wait set made while the context goes down is no fault
            raise
    finally:
        _close(node, executor)
    return 0


def _close(node: Node | None, executor: Executor | None) -> None:
    if node is not None:
        if executor is not None:
            executor.remove_node(node)
            executor.shutdown()
        node.destroy_node()
    rclpy.try_shutdown()
